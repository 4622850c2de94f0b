"""The report as a picture."""

from io import BytesIO
from pathlib import Path

import msgspec
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure as MatplotlibFigure
from PIL import Image

from recorder.review.report import picture as picture_module
from recorder.review.report.figures import BLUE, GREEN, MARKS, RED
from recorder.review.report.findings import Outage, Report, RobotCharts
from recorder.review.report.picture import picture
from recorder.review.report.spans import Span
from schemas.decisions import EventKind
from tests.support.recorder_fakes import WALL_NS
from tests.support.report_drive import (
    HOSTILE,
    PERIOD_NS,
    arbiter,
    drive,
    event,
    report_of,
    restart,
    write_log,
)


def colours_of(png: bytes) -> tuple[tuple[int, int], dict[tuple[int, ...], int]]:
    """Size, and how many pixels have each colour."""
    with Image.open(BytesIO(png)) as image:
        pixels = image.convert("RGB")
        return pixels.size, {
            colour: count for count, colour in pixels.getcolors(1 << 24) or () if isinstance(colour, tuple)
        }


def rgb(colour: str) -> tuple[int, ...]:
    """Of ``#rrggbb``."""
    return tuple(int(colour[at : at + 2], 16) for at in (1, 3, 5))


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Of a drive in which every kind of event happens, and texts are attacks."""
    events = [event(150 + number, kind, operator=HOSTILE) for number, kind in enumerate(EventKind)]
    holders = [arbiter(200 + number, lease_holder="$\\frac{") for number in range(40)]
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    return report_of(write_log(path, [*drive(200), *events, *holders], robots=["cruiser-1", "cruiser-2"]))


def test_path_bands_and_stops_are_drawn(report: Report) -> None:
    """In the page's colours, one robot below the other; a formula in a text is a text."""
    size, colours = colours_of(picture(report))
    assert size[1] > 1.5 * size[0]
    for colour in (BLUE, GREEN, RED):
        assert colours.get(rgb(colour), 0) > 200, colour


def test_charts_of_nothing_and_of_all_times_are_pictures(report: Report) -> None:
    """A robot that only spoke once, and one whose clock says the end of time."""
    robot = report.robots[0]
    bare = msgspec.structs.replace(robot, charts=RobotCharts({}, {}, [], [], 0, []))
    late_ns = 2**63
    late = msgspec.structs.replace(
        robot,
        summary=msgspec.structs.replace(robot.summary, start_ns=WALL_NS, end_ns=late_ns, drivers=[]),
        charts=RobotCharts(
            {"speed_mps": [(WALL_NS, 1.0), None, (late_ns, 1.0)]}, {"mode": [Span(0, 1, "auto")]}, [], [], 0, []
        ),
    )
    for one in (bare, late):
        assert colours_of(picture(msgspec.structs.replace(report, robots=[one])))[0][0] > 1000


def test_robots_beyond_the_limit_are_counted(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture stays one that viewers open."""
    one = colours_of(picture(msgspec.structs.replace(report, robots=report.robots[:1])))[0]
    monkeypatch.setattr(picture_module, "ROBOTS_SHOWN", 1)
    assert colours_of(picture(report))[0] == one


def axes_of(report: Report, monkeypatch: pytest.MonkeyPatch) -> dict[str, Axes]:
    """What is drawn for the only robot, by its label."""
    drawn: list[MatplotlibFigure] = []

    def keep(figure: MatplotlibFigure, *_args: object, **_kwargs: object) -> None:
        drawn.append(figure)

    monkeypatch.setattr(MatplotlibFigure, "savefig", keep)
    picture(report)
    (figure,) = drawn
    return {str(axes.get_label()): axes for axes in figure.get_axes()}


def test_every_kind_of_event_is_in_the_legend(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    """As what its symbol means; the symbols differ."""
    one = msgspec.structs.replace(report, robots=report.robots[:1])
    legend = axes_of(one, monkeypatch)["bands"].get_legend()
    assert legend is not None
    explained = [entry.get_text() for entry in legend.get_texts()]
    assert sorted(explained) == sorted({moment.kind for moment in one.robots[0].charts.moments})
    assert picture_module._MARKS.keys() == MARKS.keys()
    looks = set(picture_module._MARKS.values())
    assert len(looks) == len(MARKS)


def test_a_gateway_that_died_is_told_and_shaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the first sentence, which does not leave the picture, and across the charts over time."""
    report = report_of(write_log(tmp_path / "a.mcap", restart(100, 60)))
    axes = axes_of(report, monkeypatch)
    said = " ".join(entry.get_text() for entry in axes["summary"].texts).replace("\n", " ")
    assert "Its gateway fell silent while it commanded the robot, and began anew." in said
    assert max(len(line) for entry in axes["summary"].texts for line in entry.get_text().split("\n")) <= 70
    for name in ("speed", "angle", "bands"):
        (shade,) = [patch for patch in axes[name].patches if patch.get_alpha() == pytest.approx(0.15)]
        box = shade.get_window_extent().transformed(axes[name].transData.inverted())
        assert box.width * 86_400 == pytest.approx(61 * PERIOD_NS / 1e9, rel=1e-3)


def test_a_long_story_is_cut_and_takes_nobodys_room(report: Report) -> None:
    """Names without a space and a gateway that dies again and again: the picture keeps its layout."""
    robot = report.robots[0]
    outages = [Outage(WALL_NS + number, WALL_NS + number + 1, is_commanding=True) for number in range(50)]
    summary = msgspec.structs.replace(robot.summary, outages=outages, facts={"recorder_version": "x" * 3000})
    long = msgspec.structs.replace(robot, summary=summary)
    size, colours = colours_of(picture(msgspec.structs.replace(report, robots=[long])))
    assert size == colours_of(picture(msgspec.structs.replace(report, robots=[robot])))[0]
    assert colours.get(rgb(BLUE), 0) > 200

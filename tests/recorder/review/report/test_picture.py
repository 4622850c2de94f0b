"""The report as a picture."""

from io import BytesIO

import msgspec
import pytest
from PIL import Image

from recorder.review.report import picture as picture_module
from recorder.review.report.figures import BLUE, GREEN, RED
from recorder.review.report.findings import Report, RobotCharts
from recorder.review.report.picture import picture
from recorder.review.report.spans import Span
from schemas.decisions import EventKind
from tests.recorder.fakes import WALL_NS
from tests.recorder.review.report.drive import HOSTILE, arbiter, drive, event, report_of, write_log


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
    bare = msgspec.structs.replace(robot, charts=RobotCharts({}, {}, [], [], 0))
    late_ns = 2**63
    late = msgspec.structs.replace(
        robot,
        summary=msgspec.structs.replace(robot.summary, start_ns=WALL_NS, end_ns=late_ns, drivers=[]),
        charts=RobotCharts(
            {"speed_mps": [(WALL_NS, 1.0), None, (late_ns, 1.0)]}, {"mode": [Span(0, 1, "auto")]}, [], [], 0
        ),
    )
    for one in (bare, late):
        assert colours_of(picture(msgspec.structs.replace(report, robots=[one])))[0][0] > 1000


def test_robots_beyond_the_limit_are_counted(report: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    """A picture stays one that viewers open."""
    one = colours_of(picture(msgspec.structs.replace(report, robots=report.robots[:1])))[0]
    monkeypatch.setattr(picture_module, "ROBOTS_SHOWN", 1)
    assert colours_of(picture(report))[0] == one

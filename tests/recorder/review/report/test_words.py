"""The summary of a robot in plain words."""

from pathlib import Path

import msgspec
import pytest

from recorder.completeness import KeyReport
from recorder.review.report.findings import Driver, Refusal, Report
from recorder.review.report.words import duration, headline, metres, reason_words, size, summary_lines
from schemas.reasons import Reason
from tests.recorder.review.report.drive import drive, report_of, write_log


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Of a short drive."""
    return report_of(write_log(tmp_path_factory.mktemp("log") / "a.mcap", drive(201)))


def said(report: Report, **changes: object) -> dict[str, str]:
    """The lines, with some figures changed."""
    summary = msgspec.structs.replace(report.robots[0].summary, **changes)
    return dict(summary_lines(summary, report))


def test_a_drive_in_words(report: Report) -> None:
    """Each line answers its question."""
    lines = said(report)
    assert headline(report.robots[0].summary) == "It went 10.0 m, and was stopped once."
    assert lines["Robot"] == "cruiser-1, under the keys fleet/cruiser-1/"
    assert "10.0 s" in lines["When"]
    assert lines["How far"].startswith("10.0 m by its own speed, moving for 10.0 s of 10.0 s; at most 1.00 m/s")
    assert lines["Stopped"] == "once: 1 x the front bumper was hit"
    assert lines["Refused"] == "1 of 1 requests: 1 x drive of operator-2: this lease is not in force"
    assert lines["Missing"].startswith("Nothing: ")
    assert lines["Versions"].startswith("variant coarse, recorder 0.1.0, cruiser-gateway 0.1.0")


def test_what_is_missing_is_never_called_nothing(report: Report) -> None:
    """Gaps, losses, and what was not kept are told; an account that is not there is no good account."""
    lost = {"fleet/cruiser-1/state": KeyReport(sent=9, received=7, written=7, lost_link=2, lost_bus=3)}
    told = said(report, completeness=lost, gaps=2, gap_s=3.5)["Missing"]
    assert "breaks off twice, for 3.5 s" in told
    assert "3 frames between chassis and gateway, 2 samples on the way to the recorder" in told
    assert "Nothing" not in told
    assert said(report, completeness={})["Missing"] == "the log does not tell"


def test_an_unfinished_file_is_named(report: Report) -> None:
    """Of it the recorder gave no account."""
    file = msgspec.structs.replace(report.files[0], is_accounted=False)
    changed = msgspec.structs.replace(report, files=[file])
    assert "No account" in dict(summary_lines(report.robots[0].summary, changed))["Missing"]


def test_a_standing_robot_and_one_of_which_nothing_is_known(report: Report) -> None:
    """Neither has driven, and only of one that is known."""
    assert said(report, distance_m=0.01)["How far"] == "it stood still for the 10.0 s of which that is known"
    assert said(report, known_s=0.0)["How far"].startswith("not known")
    summary = msgspec.structs.replace(report.robots[0].summary, distance_m=0.0, stops={})
    assert headline(summary) == "It stood still, and was not stopped."


def test_long_lists_end(report: Report) -> None:
    """Tables tell all; a line stays one."""
    drivers = [Driver(f"operator-{number}", 1.0, 1.0) for number in range(30)]
    assert said(report, drivers=drivers)["Driven by"].endswith("; and 22 more kinds")
    refusals = [Refusal("drive", "", "no_lease", 1, 0, 0)]
    assert "drive of nobody" in said(report, refusals=refusals)["Refused"]


def test_every_reason_has_words() -> None:
    """One that is not known here is told as it is."""
    assert all(reason_words(reason.value) != reason.value for reason in Reason)
    assert reason_words("of a later version") == "of a later version"


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.04, "0.0 s"), (119.94, "119.9 s"), (120, "2 min 0 s"), (3599.7, "1 h 0 min")]
)
def test_durations(seconds: float, words: str) -> None:
    """As a person would say them."""
    assert duration(seconds) == words


def test_sizes_and_lengths() -> None:
    """Units that fit."""
    assert (metres(9.96), metres(12_340)) == ("10.0 m", "12.34 km")
    assert (size(12), size(1500), size(10**10)) == ("12 bytes", "1.5 kB", "10.0 GB")


def test_the_words_of_a_real_log(tmp_path: Path) -> None:
    """A robot without events, refusals or lease."""
    lines = said(report_of(write_log(tmp_path / "a.mcap", drive(3)[:1])))
    assert (lines["Stopped"], lines["Driven by"]) == ("never", "nobody, as far as the log tells")
    assert lines["Refused"] == "nothing, of 0 requests"

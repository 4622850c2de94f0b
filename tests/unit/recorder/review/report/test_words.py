"""The summary of a robot in plain words."""

from pathlib import Path

import msgspec
import pytest

from recorder.record.accounting import KeyReport
from recorder.review.report.findings import Driver, Outage, Refusal, Report, Silence
from recorder.review.report.words import (
    duration,
    gateway_lines,
    headline,
    metres,
    moment_words,
    reason_words,
    size,
    summary_lines,
    who,
)
from schemas.reasons import Reason
from tests.support.drives import drive_messages, write_messages
from tests.support.messages import SECOND, WALL_NS
from tests.support.reading import report_of

FIRST_S, SIXTH_S = "2027-01-15 08:00:01.000 UTC", "2027-01-15 08:00:06.000 UTC"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Of a short drive."""
    return report_of(write_messages(tmp_path_factory.mktemp("log") / "a.mcap", drive_messages(201)))


def said(report: Report, **changes: object) -> dict[str, str]:
    """The lines, with some figures changed."""
    summary = msgspec.structs.replace(report.robots[0].summary, **changes)
    return dict(summary_lines(summary, report))


def test_a_drive_in_words(report: Report) -> None:
    """Each line answers its question."""
    lines = said(report)
    assert (
        headline(report.robots[0].summary)
        == "It went 10.0 m, and was stopped once. The log ends while it was commanded."
    )
    assert lines["Robot"] == "cruiser-1, under the keys fleet/cruiser-1/"
    assert "10.0 s" in lines["When"]
    assert lines["How far"].startswith("10.0 m by its own speed, moving for 10.0 s of 10.0 s; at most 1.00 m/s")
    assert lines["Stopped"] == "once: 1 x the front bumper was hit"
    assert lines["Refused"] == "1 of 1 requests: 1 x drive of operator-2: this lease is not in force"
    assert lines["Missing"].startswith("Nothing: ")
    assert lines["Versions"] == (
        "variant coarse, recorder 0.1.0, cruiser-gateway 0.1.0, configuration abababababab, "
        "since 2027-01-15 07:59:59.000 UTC"
    )
    assert lines["Gateway"] == "the log ends while it commanded the robot"


def test_what_is_missing_is_never_called_nothing(report: Report) -> None:
    """Gaps, losses, and what was not kept are told; an account that is not there is no good account."""
    lost = {"fleet/cruiser-1/state": KeyReport(sent=9, received=7, written=7, lost_link=2, lost_bus=3)}
    lines = said(report, completeness=lost, gaps=2, gap_s=3.5)
    assert lines["How far"].startswith("at least 10.0 m by its own speed")
    told = lines["Missing"]
    assert "breaks off twice, for 3.5 s" in told
    assert "3 frames between chassis and gateway, 2 samples on the way to the recorder" in told
    assert "Nothing" not in told
    assert said(report, completeness={})["Missing"] == "the log does not tell"


def test_an_unfinished_file_is_named(report: Report) -> None:
    """Of it the recorder gave no account."""
    file = msgspec.structs.replace(report.files[0], is_accounted=False)
    changed = msgspec.structs.replace(report, files=[file])
    told = dict(summary_lines(report.robots[0].summary, changed))["Missing"]
    assert f"No account, because the recorder did not finish the file: {file.name}." in told
    growing = msgspec.structs.replace(report, files=[msgspec.structs.replace(file, is_being_written=True)])
    told = dict(summary_lines(report.robots[0].summary, growing))["Missing"]
    assert f"No account yet, because the recorder is writing the file: {file.name}." in told
    assert "did not finish" not in told


def test_a_standing_robot_and_one_of_which_nothing_is_known(report: Report) -> None:
    """Neither has driven, and only of one that is known."""
    assert said(report, distance_m=0.01)["How far"] == "it stood still for the 10.0 s of which that is known"
    assert said(report, known_s=0.0)["How far"].startswith("not known")
    summary = msgspec.structs.replace(report.robots[0].summary, distance_m=0.0, stops={}, ends_commanding=False)
    assert headline(summary) == "It stood still, and was not stopped."


def outage(
    heard_s: int, began_s: int | None, *, is_commanding: bool = True, is_between_logs: bool = False
) -> Outage:
    """In seconds since the beginning."""
    began_ns = None if began_s is None else WALL_NS + began_s * SECOND
    return Outage(WALL_NS + heard_s * SECOND, began_ns, is_commanding, is_between_logs)


@pytest.mark.parametrize(
    ("one", "head", "line"),
    [
        (
            outage(1, 6),
            "Its gateway fell silent while it commanded the robot, and began anew.",
            f"it fell silent at {FIRST_S} while it commanded the robot, and began anew 5.0 s later",
        ),
        (
            outage(1, 1, is_commanding=False),
            "Its gateway began anew.",
            "it began anew at 2027-01-15 08:00:01.000 UTC",
        ),
        (
            outage(1, None),
            "Its gateway fell silent while it commanded the robot, and was not heard again until the end.",
            f"it fell silent at {FIRST_S} while it commanded the robot, and was not heard again until the end",
        ),
        (
            outage(1, 6, is_between_logs=True),
            "",
            f"a log ends at {FIRST_S} while it commanded the robot, and the next one, at {SIXTH_S}, is of another",
        ),
    ],
)
def test_a_gateway_that_died_is_in_the_first_sentence(report: Report, one: Outage, head: str, line: str) -> None:
    """And when, in a line of its own; between two logs it is nothing that happened on this drive."""
    summary = msgspec.structs.replace(report.robots[0].summary, outages=[one], ends_commanding=False)
    assert headline(summary) == f"It went 10.0 m, and was stopped once. {head}".rstrip()
    assert gateway_lines(summary) == [line]


def test_a_gateway_that_dies_again_and_again_is_counted(report: Report) -> None:
    """A line stays one; without anything to say there is none."""
    many = [outage(number, number, is_commanding=number < 2) for number in range(30)]
    summary = msgspec.structs.replace(report.robots[0].summary, outages=many, more_outages=7)
    assert "Its gateway began anew or fell silent 37 times, 2 of these while it commanded the robot." in headline(
        summary
    )
    assert "and so on, 7 times more" in gateway_lines(summary)
    assert said(report, outages=many)["Gateway"].endswith("; and 23 more")
    assert "Gateway" not in said(report, ends_commanding=False)


def test_every_configuration_that_was_in_force_is_told(report: Report) -> None:
    """Since when, and what is otherwise; the first sentence says that there was another."""
    first = report.robots[0].summary.in_force[0]
    later = msgspec.structs.replace(
        first,
        since_ns=WALL_NS + 5 * SECOND,
        configuration_sha256="cd" * 32,
        changes=["configuration cdcdcdcdcdcd"],
        settings=["command.speed_limit_mps 0.6, 2.222 before"],
    )
    again = msgspec.structs.replace(later, since_ns=WALL_NS + 7 * SECOND, changes=[], settings=[])
    summary = msgspec.structs.replace(report.robots[0].summary, in_force=[first, later, again])
    assert "Its configuration changed." in headline(summary)
    lines = dict(summary_lines(summary, report))
    for hash_and_since in (
        "configuration abababababab, since 2027-01-15 07:59:59.000 UTC",
        "configuration cdcdcdcdcdcd since 2027-01-15 08:00:05.000 UTC",
        "the same since 2027-01-15 08:00:07.000 UTC",
    ):
        assert hash_and_since in lines["Versions"]
    assert gateway_lines(summary)[0] == (
        "since 2027-01-15 08:00:05.000 UTC it has another configuration: command.speed_limit_mps 0.6, 2.222 before"
    )
    assert said(report, in_force=[])["Versions"] == "recorder 0.1.0"
    assert said(report, in_force=[], facts={})["Versions"] == "the log does not tell"


def test_silences_of_one_gateway_are_missing(report: Report) -> None:
    """The first one in words, and how many more."""
    silences = [Silence(WALL_NS, WALL_NS + SECOND, "3 samples of a are not in the log")] * 2
    told = said(report, silences=silences, more_silences=4)["Missing"]
    assert (
        "Gaps: 3 samples of a are not in the log, from 2027-01-15 08:00:00.000 UTC on; and 5 more such."
    ) in told


def test_a_moment_says_who_and_how_often(report: Report) -> None:
    """Who held the lease stands in parentheses; a gap counts in its own words."""
    (stop, _) = report.robots[0].charts.moments
    assert (who(stop), moment_words(stop)) == ("(operator-1)", stop.text)
    changed = msgspec.structs.replace(stop, operator="operator-3", count=7, last_ns=stop.time_ns + SECOND)
    assert who(changed) == "operator-3"
    assert moment_words(changed) == f"{stop.text} [7 times within 1.0 s]"
    assert moment_words(msgspec.structs.replace(changed, kind="gap")) == stop.text
    assert who(msgspec.structs.replace(stop, holder="")) == ""


def test_long_lists_end(report: Report) -> None:
    """Tables tell all; a line stays one."""
    drivers = [Driver(f"operator-{number}", 1.0, 1.0) for number in range(30)]
    assert said(report, drivers=drivers)["Driven by"].endswith("; and 22 more")
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
    lines = said(report_of(write_messages(tmp_path / "a.mcap", drive_messages(3)[:1])))
    assert (lines["Stopped"], lines["Driven by"]) == ("never", "nobody, as far as the log tells")
    assert lines["Refused"] == "nothing, of 0 requests"

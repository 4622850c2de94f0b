"""A robot's figures in words: the verdict, and the lines below it.

Names and texts come from the log, and may hold anything: who shows them has to make them safe.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from recorder.reading.times import in_words
from recorder.record.accounting import KeyReport, total
from recorder.review.drives import DIED, Outage, RecordedDrive, operators_stops
from recorder.review.entries import EntryKind
from recorder.review.report.findings import Moment, Report, RobotReport, RobotSummary
from schemas.reasons import TEXTS

STANDING_M: Final = 0.05
"""A path that is shorter is the noise of a standing robot."""

SHOWN: Final = 8
"""Kinds that are shown in one line; tables show all."""

ABSENT: Final = "not in the log"

Line = tuple[str, str]
"""A subject, and what is to be said of it."""

_WORDS: Final = {reason.value: text.means for reason, text in TEXTS.items()} | {DIED: "the gateway died"}

_LOSSES: Final = {
    "lost_bus": "frames between chassis and gateway",
    "lost_source": "frames that the gateway dropped",
    "lost_link": "samples on the way to the recorder",
    "lost_queue": "samples that the recorder dropped unread",
    "lost_size": "samples too large to be recorded",
    "lost_full": "messages while the disk was full",
    "lost_disk": "messages that the disk did not store",
}


def verdict(robot: RobotReport) -> str:
    """The robot in a sentence: distance, drives, stops by cause, normal ends."""
    summary = robot.summary
    drives = len(robot.drives) + robot.more_drives
    said = [f"{counted(drives, 'drive') if drives else 'no drive'}, {distance(summary)}", stops_by(summary.stops)]
    ends = sum(summary.ends.values())
    if ends:
        said.append(counted(ends, "normal end"))
    if summary.ends_commanding:
        said.append("recording ends while the robot is commanded")
    return "; ".join(said) + "."


def distance(robot: RobotSummary, *, is_short: bool = False) -> str:
    """The distance; where states are missing it is at least that."""
    if not robot.known_s:
        return ABSENT if is_short else f"distance {ABSENT}"
    said = "0 m" if robot.distance_m < STANDING_M else metres(robot.distance_m)
    if not robot.gaps:
        return said
    return f"at least {said}" if is_short else f"at least {said} ({duration(robot.gap_s)} not recorded)"


def drive_distance(robot: RobotSummary, drive: RecordedDrive) -> str:
    """The distance of one drive."""
    if not robot.known_s:
        return "-"
    return f"{'at least ' if drive.missing_s else ''}{metres(drive.distance_m)}"


def stops_by(stops: Mapping[str, int]) -> str:
    """Stops: how many are faults and how many operators', with the causes."""
    count, by_operators = sum(stops.values()), operators_stops(stops)
    if not count:
        return "no stops"
    if count == 1:
        return f"1 stop{' by an operator' if by_operators else ''}: {''.join(map(reason_words, stops))}"
    kinds = [
        *([counted(count - by_operators, "fault")] if count > by_operators else []),
        *([f"{by_operators} by operators"] if by_operators else []),
    ]
    causes = joined((f"{number} x {reason_words(cause)}" for cause, number in stops.items()), ", ")
    return f"{count} stops ({', '.join(kinds)}): {causes}"


def summary_lines(robot: RobotReport, report: Report) -> list[Line]:
    """The robot, line by line."""
    summary = robot.summary
    return [
        ("Robot", f"{summary.name}, keys {summary.key}/"),
        ("When", f"{_from_to(summary.start_ns, summary.end_ns)}"),
        ("Distance", _distance(summary)),
        ("Stops", stops_by(summary.stops)),
        ("Normal ends", _counts(summary.ends) or "none"),
        ("Worst moment", _worst(summary.worst)),
        ("Gateway", joined(map(_outage, summary.outages)) or "no outage"),
        (
            "Driven by",
            joined(f"{one.name} {duration(one.seconds)}, {metres(one.distance_m)}" for one in summary.drivers)
            or ABSENT,
        ),
        ("Refused", _refused(summary)),
        ("Lost", joined(_missing(summary, report)) or "nothing"),
        ("Bus and gateway", _counts(summary.health) or "no losses, no faults"),
        ("Versions", _versions(summary)),
    ]


def _from_to(start_ns: int, end_ns: int) -> str:
    return f"{in_words(start_ns)} to {in_words(end_ns)}: {duration((end_ns - start_ns) / 1e9)}"


def _distance(robot: RobotSummary) -> str:
    if not robot.known_s:
        return ABSENT
    top = f"{abs(robot.top_mps):.2f} m/s{' in reverse' if robot.top_mps < 0 else ''} at {in_words(robot.top_ns)}"
    return f"{distance(robot)}, moving {duration(robot.moving_s)} of {duration(robot.known_s)}; top speed {top}"


def _worst(moment: Moment | None) -> str:
    return "none" if moment is None else f"{in_words(moment.time_ns)}: {moment_words(moment)}"


def _outage(outage: Outage) -> str:
    commanding = " while commanding" if outage.is_commanding else ""
    if outage.began_ns is None:
        return f"silent from {in_words(outage.heard_ns)} to the end{commanding}"
    if outage.began_ns <= outage.heard_ns:
        return f"restarted at {in_words(outage.heard_ns)}{commanding}"
    silent_s = (outage.began_ns - outage.heard_ns) / 1e9
    return f"silent for {duration(silent_s)} from {in_words(outage.heard_ns)}{commanding}, then restarted"


def _refused(robot: RobotSummary) -> str:
    if not robot.refused:
        return f"none of {counted(robot.accepted, 'request')}"
    told = joined(
        f"{one.count} x {one.request} of {one.operator or 'no operator'}: {reason_words(one.reason)}"
        for one in robot.refusals
    )
    return f"{robot.refused} of {robot.accepted + robot.refused} requests: {told}"


def _missing(robot: RobotSummary, report: Report) -> list[str]:
    said = []
    if robot.gaps:
        said.append(f"{duration(robot.gap_s)} of motion in {counted(robot.gaps, 'gap')}")
    said += [f"{one.text}, from {in_words(one.from_ns)}" for one in robot.silences[:1]]
    if len(robot.silences) > 1:
        said.append(f"{len(robot.silences) - 1} more such gaps")
    sums = total(robot.completeness.values())
    said += [f"{getattr(sums, name)} {what}" for name, what in _LOSSES.items() if getattr(sums, name)]
    if robot.unwritten:
        said.append(f"{sum(one.count for one in robot.unwritten)} messages received and not stored")
    bare = [file.name for file in report.files if not file.is_accounted]
    if bare:
        said.append(f"the recorder's account of {joined(bare, ', ')}")
    elif not robot.completeness:
        said.append("the recorder's account")
    return said


def _versions(robot: RobotSummary) -> str:
    """Versions of the first gateway, and how many others there were."""
    recorder = robot.facts.get("recorder_version")
    said = [f"recorder {recorder}"] if recorder else []
    for first in robot.in_force[:1]:
        packages = (f"{package} {value}" for package, value in sorted(first.versions.items()))
        configuration = f"configuration {first.configuration_sha256[:12] or ABSENT}"
        said = [f"variant {first.variant}", *said, *packages, configuration]
    if len(robot.in_force) > 1:
        said.append(f"{counted(len(robot.in_force) - 1, 'later gateway')}, see below")
    return ", ".join(said) or ABSENT


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason_words(name)}" for name, count in counts.items())


def moment_words(moment: Moment) -> str:
    """The text of an event, and how often it occurred; a gap says itself how much is missing."""
    if moment.count <= 1 or moment.kind == EntryKind.GAP.value:
        return moment.text
    lasted_s = (moment.last_ns - moment.time_ns) / 1e9
    return f"{moment.text} [{moment.count} times{f' within {duration(lasted_s)}' if lasted_s >= 0.05 else ''}]"


def who(moment: Moment) -> str:
    """The operator who did it, or in parentheses the holder of the lease."""
    return moment.operator or (f"({moment.holder})" if moment.holder else "")


def reason_words(reason: str) -> str:
    """A reason, as a person would say it."""
    return _WORDS.get(reason, reason)


def counted(count: int, noun: str) -> str:
    """``1 file``, ``2 files``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def duration(seconds: float) -> str:
    """A time span for people."""
    if seconds < 120:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def metres(length_m: float) -> str:
    """A length for people."""
    return f"{length_m / 1000:.2f} km" if length_m >= 10_000 else f"{length_m:.1f} m"


def size(count: int) -> str:
    """A file's length for people."""
    for factor, unit in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if count >= factor:
            return f"{count / factor:.1f} {unit}"
    return f"{count} bytes"


def is_lossy(report: KeyReport) -> bool:
    """Report whether anything of a topic was lost, before or behind the recorder."""
    return bool(report.lost or report.lost_bus or report.lost_source)


def iso(time_ns: int) -> str:
    """A time in ISO 8601, with the precision that browsers know."""
    return in_words(time_ns).removesuffix(" UTC").replace(" ", "T") + "Z"


def joined(parts: Iterable[str], between: str = "; ") -> str:
    """The first ones, and how many more."""
    found = list(parts)
    more = [f"and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
    return between.join([*found[:SHOWN], *more])

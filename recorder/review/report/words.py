"""The summary of a robot in plain words.

Names and texts come from the log, and may hold anything: who shows them has to make them safe.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import Final

from recorder.reading.times import in_words
from recorder.record.accounting import KeyReport, total
from recorder.review.entries import EntryKind
from recorder.review.report.findings import InForce, Moment, Outage, Report, ReportedFile, RobotSummary
from schemas.reasons import TEXTS

STANDING_M: Final = 0.05
"""A path that is shorter is the noise of a standing robot."""

SHOWN: Final = 8
"""Kinds that are shown in one line; tables show all."""

Line = tuple[str, str]
"""A subject, and what is to be said of it."""

_WORDS: Final = {reason.value: text.means for reason, text in TEXTS.items()}

_LOSSES: Final = {
    "lost_bus": "frames between chassis and gateway",
    "lost_source": "frames that the gateway dropped",
    "lost_link": "samples on the way to the recorder",
    "lost_queue": "samples that the recorder dropped unread",
    "lost_size": "samples too large to be recorded",
    "lost_full": "messages while the disk was full",
    "lost_disk": "messages that the disk did not take or keep",
}


def summary_lines(robot: RobotSummary, report: Report) -> list[Line]:
    """The robot, line by line."""
    span_s = (robot.end_ns - robot.start_ns) / 1e9
    return [
        ("Robot", f"{robot.name}, under the keys {robot.key}/"),
        ("When", f"{in_words(robot.start_ns)} to {in_words(robot.end_ns)}: {duration(span_s)}"),
        ("How far", _how_far(robot)),
        ("Stopped", _stops(robot)),
        *([("Gateway", _list(gateway_lines(robot)))] if gateway_lines(robot) else []),
        ("Driven by", _drivers(robot)),
        ("Refused", _refused(robot)),
        ("Missing", " ".join(_missing(robot, report.files))),
        ("Bus and gateway", _counts(robot.health) or "nothing was lost or faulty, as far as the gateway tells"),
        ("Versions", _versions(robot)),
    ]


def headline(robot: RobotSummary) -> str:
    """The robot in a sentence."""
    stops = sum(robot.stops.values())
    how_far = "stood still" if robot.distance_m < STANDING_M else f"went {way(robot)}"
    said = [f"It {how_far}, and was {f'stopped {times(stops)}' if stops else 'not stopped'}."]
    outages = [one for one in robot.outages if not one.is_between_logs]
    if len(outages) == 1 and not robot.more_outages:
        said.append(f"Its gateway {_outage(outages[0], is_dated=False)}.")
    elif outages:
        worst = sum(one.is_commanding for one in outages)
        said.append(
            f"Its gateway began anew or fell silent {times(len(outages) + robot.more_outages)}"
            f"{f', {worst} of these while it commanded the robot' if worst else ''}."
        )
    configurations = sum(_is_reconfigured(*pair) for pair in pairwise(robot.in_force))
    if configurations:
        said.append(f"Its configuration changed{'' if configurations == 1 else f' {times(configurations)}'}.")
    if robot.ends_commanding:
        said.append("The log ends while it was commanded.")
    return " ".join(said)


def gateway_lines(robot: RobotSummary) -> list[str]:
    """Outages of its gateway, and the differences afterwards; nothing if there is nothing to say."""
    said = [_outage_line(one) for one in robot.outages]
    if robot.more_outages:
        said.append(f"and so on, {robot.more_outages} times more")
    for before, now in pairwise(robot.in_force):
        if _is_reconfigured(before, now):
            settings = f": {_list(now.settings, ', ')}" if now.settings else ""
            said.append(f"since {in_words(now.since_ns)} it has another configuration{settings}")
    if robot.ends_commanding:
        said.append("the log ends while it commanded the robot")
    return said


def moment_words(moment: Moment) -> str:
    """The text of an event, and how often it occurred; a gap says itself how much is missing."""
    if moment.count <= 1 or moment.kind == EntryKind.GAP.value:
        return moment.text
    lasted_s = (moment.last_ns - moment.time_ns) / 1e9
    return f"{moment.text} [{moment.count} times{f' within {duration(lasted_s)}' if lasted_s >= 0.05 else ''}]"


def who(moment: Moment) -> str:
    """The operator who did it, or in parentheses the holder of the lease."""
    return moment.operator or (f"({moment.holder})" if moment.holder else "")


def _outage(outage: Outage, *, is_dated: bool) -> str:
    """An outage in words: for a headline, or with its times."""
    commanding = " while it commanded the robot" if outage.is_commanding else ""
    since = f" at {in_words(outage.heard_ns)}{commanding}" if is_dated else commanding
    if outage.began_ns is None:
        return f"fell silent{since}, and was not heard again until the end"
    if outage.began_ns <= outage.heard_ns:
        return f"began anew{since}"
    later = f" {duration((outage.began_ns - outage.heard_ns) / 1e9)} later" if is_dated else ""
    return f"fell silent{since}, and began anew{later}"


def _outage_line(outage: Outage) -> str:
    if outage.began_ns is None or not outage.is_between_logs:
        return f"it {_outage(outage, is_dated=True)}"
    commanding = " while it commanded the robot" if outage.is_commanding else ""
    return (
        f"a log ends at {in_words(outage.heard_ns)}{commanding}, and the next one, "
        f"at {in_words(outage.began_ns)}, is of another"
    )


def _is_reconfigured(before: InForce, now: InForce) -> bool:
    return before.configuration_sha256 != now.configuration_sha256


def reason_words(reason: str) -> str:
    """A reason, as a person would say it."""
    return _WORDS.get(reason, reason)


def times(count: int) -> str:
    """A number of times in words."""
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


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


def way(robot: RobotSummary) -> str:
    """The distance of a robot for people: nobody knows how far it went where the log has no state."""
    return f"{'at least ' if robot.gaps else ''}{metres(robot.distance_m)}"


def size(count: int) -> str:
    """A file's length for people."""
    for factor, unit in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if count >= factor:
            return f"{count / factor:.1f} {unit}"
    return f"{count} bytes"


def is_lossy(report: KeyReport) -> bool:
    """Report whether anything of a topic was lost, before or behind the recorder."""
    return bool(report.lost or report.lost_bus or report.lost_source)


def _how_far(robot: RobotSummary) -> str:
    if not robot.known_s:
        return "not known: there are no two states with speed and angle one after the other"
    if robot.distance_m < STANDING_M:
        return f"it stood still for the {duration(robot.known_s)} of which that is known"
    top = f"{abs(robot.top_mps):.2f} m/s{' in reverse' if robot.top_mps < 0 else ''}"
    return (
        f"{way(robot)} by its own speed, moving for {duration(robot.moving_s)} "
        f"of {duration(robot.known_s)}; at most {top}, at {in_words(robot.top_ns)}"
    )


def _stops(robot: RobotSummary) -> str:
    if not robot.stops:
        return "never"
    return f"{times(sum(robot.stops.values()))}: " + _list(
        f"{number} x {reason_words(reason)}" for reason, number in robot.stops.items()
    )


def _drivers(robot: RobotSummary) -> str:
    return (
        _list(f"{one.name} for {duration(one.seconds)}, {metres(one.distance_m)}" for one in robot.drivers)
        or "nobody, as far as the log tells"
    )


def _refused(robot: RobotSummary) -> str:
    if not robot.refused:
        return f"nothing, of {robot.accepted} requests"
    told = _list(
        f"{one.count} x {one.request} of {one.operator or 'nobody'}: {reason_words(one.reason)}"
        for one in robot.refusals
    )
    return f"{robot.refused} of {robot.accepted + robot.refused} requests: {told}"


def _missing(robot: RobotSummary, files: Iterable[ReportedFile]) -> list[str]:
    said = []
    if robot.gaps:
        said.append(
            f"The path breaks off {times(robot.gaps)}, for {duration(robot.gap_s)} in all, and goes on from there."
        )
    if robot.silences:
        counted = len(robot.silences) + robot.more_silences
        first = f"{robot.silences[0].text}, from {in_words(robot.silences[0].from_ns)} on"
        said.append(f"Gaps: {first}{f'; and {counted - 1} more such' if counted > 1 else ''}.")
    sums = total(robot.completeness.values())
    losses = [f"{getattr(sums, name)} {what}" for name, what in _LOSSES.items() if getattr(sums, name)]
    if losses:
        said.append(f"Lost: {', '.join(losses)}.")
    elif robot.completeness:
        said.append(
            f"Nothing: the recorder's account of {len(robot.completeness)} topics shows no loss"
            f"{', but for that' if said else ''}."
        )
    if robot.unwritten:
        count = sum(one.count for one in robot.unwritten)
        said.append(f"{count} messages reached the recorder and were not kept.")
    unfinished = [file for file in files if not file.is_accounted]
    growing = [file.name for file in unfinished if file.is_being_written]
    if growing:
        said.append(f"No account yet, because the recorder is writing the file: {_list(growing)}.")
    bare = [file.name for file in unfinished if not file.is_being_written]
    if bare:
        said.append(f"No account, because the recorder did not finish the file: {_list(bare)}.")
    return said or ["the log does not tell"]


def _versions(robot: RobotSummary) -> str:
    """Versions of the first gateway, and the changes in the others."""
    recorder = robot.facts.get("recorder_version")
    said = [f"recorder {recorder}"] if recorder else []
    if not robot.in_force:
        return ", ".join(said) or "the log does not tell"
    first = robot.in_force[0]
    said = [
        f"variant {first.variant}",
        *said,
        *(f"{package} {value}" for package, value in sorted(first.versions.items())),
        *([f"configuration {first.configuration_sha256[:12]}"] if first.configuration_sha256 else []),
    ]
    later = (
        f"{_list(one.changes, ', ') or 'the same'} since {in_words(one.since_ns)}" for one in robot.in_force[1:]
    )
    return _list([f"{', '.join(said)}, since {in_words(first.since_ns)}", *later])


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _list(parts: Iterable[str], between: str = "; ") -> str:
    found = list(parts)
    more = [f"and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
    return between.join([*found[:SHOWN], *more])

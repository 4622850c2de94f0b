"""The summary of a robot in plain words.

Names and texts come from the log, and may hold anything: who shows them has to make them safe.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from recorder.completeness import KeyReport, total
from recorder.review.report.findings import Report, ReportedFile, RobotSummary
from recorder.review.times import in_words
from schemas.reasons import TEXTS

STANDING_M: Final = 0.05
"""A path that is shorter is the noise of a standing robot."""

SHOWN: Final = 8
"""Kinds that are told in one line; tables tell all."""

Line = tuple[str, str]
"""What it is about, and what is to be said."""

_WORDS: Final = {reason.value: text.means for reason, text in TEXTS.items()}

_LOSSES: Final = {
    "lost_bus": "frames between chassis and gateway",
    "lost_source": "frames that the gateway dropped",
    "lost_link": "samples on the way to the recorder",
    "lost_queue": "samples that the recorder dropped unread",
    "lost_size": "samples too large to be recorded",
    "lost_full": "messages while the disk was full",
    "lost_disk": "messages that the disk did not take",
}


def summary_lines(robot: RobotSummary, report: Report) -> list[Line]:
    """The robot, line by line."""
    span_s = (robot.end_ns - robot.start_ns) / 1e9
    return [
        ("Robot", f"{robot.name}, under the keys {robot.key}/"),
        ("When", f"{in_words(robot.start_ns)} to {in_words(robot.end_ns)}: {duration(span_s)}"),
        ("How far", _how_far(robot)),
        ("Stopped", _stops(robot)),
        ("Driven by", _drivers(robot)),
        ("Refused", _refused(robot)),
        ("Missing", " ".join(_missing(robot, report.files))),
        ("Bus and gateway", _counts(robot.health) or "nothing was lost or faulty, as far as the gateway tells"),
        ("Versions", _versions(robot.facts)),
    ]


def headline(robot: RobotSummary) -> str:
    """The robot in a sentence."""
    stops = sum(robot.stops.values())
    how_far = "stood still" if robot.distance_m < STANDING_M else f"went {metres(robot.distance_m)}"
    return f"It {how_far}, and was {f'stopped {times(stops)}' if stops else 'not stopped'}."


def reason_words(reason: str) -> str:
    """A reason, as a person would say it."""
    return _WORDS.get(reason, reason)


def times(count: int) -> str:
    """How often."""
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


def size(count: int) -> str:
    """A file's length for people."""
    for factor, unit in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if count >= factor:
            return f"{count / factor:.1f} {unit}"
    return f"{count} bytes"


def is_lossy(report: KeyReport) -> bool:
    """Whether anything of a topic was lost, before or behind the recorder."""
    return bool(report.lost or report.lost_bus or report.lost_source)


def _how_far(robot: RobotSummary) -> str:
    if not robot.known_s:
        return "not known: there are no two states with speed and angle one after the other"
    if robot.distance_m < STANDING_M:
        return f"it stood still for the {duration(robot.known_s)} of which that is known"
    top = f"{abs(robot.top_mps):.2f} m/s{' in reverse' if robot.top_mps < 0 else ''}"
    return (
        f"{metres(robot.distance_m)} by its own speed, moving for {duration(robot.moving_s)} "
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
    bare = [file.name for file in files if not file.is_accounted]
    if bare:
        said.append(f"No account, because the recorder did not finish the file: {_list(bare)}.")
    return said or ["the log does not tell"]


def _versions(facts: dict[str, str]) -> str:
    packages = [
        f"{name.removeprefix('versions.')} {value}"
        for name, value in facts.items()
        if name.startswith("versions.")
    ]
    said = [
        f"variant {facts.get('variant', 'not told')}",
        *([f"recorder {facts['recorder_version']}"] if "recorder_version" in facts else []),
        *packages,
    ]
    if "configuration_sha256" in facts:
        said.append(f"configuration {facts['configuration_sha256'][:12]}")
    return ", ".join(said)


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _list(parts: Iterable[str]) -> str:
    found = list(parts)
    more = [f"and {len(found) - SHOWN} more kinds"] if len(found) > SHOWN else []
    return "; ".join([*found[:SHOWN], *more])

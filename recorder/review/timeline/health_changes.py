"""What ``gateway/health``, once a second, tells of what went wrong since the one before."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import msgspec

from recorder.review.timeline.entries import EntryKind
from schemas.decisions import Severity
from schemas.messages import ControllerState, GatewayHealth

FAILURES_IN_WORDS: Final = {
    "checksum": "its checksums fail",
    "implausible": "its values are beyond what the chassis can have",
    "alive_counter": "its alive counter fails",
    "period": "its period is wrong",
    "silence": "it is silent",
}

_COUNTS: Final[tuple[tuple[str, str], ...]] = (
    ("bus_losses", "the CAN bus was lost"),
    ("bus_drops", "the kernel dropped frames that were not read in time"),
    ("publish_failures", "Zenoh did not take samples"),
    ("inbox_drops", "requests were dropped unread: too many came"),
)
"""Counters since the start whose rise is told."""

_FRAME_COUNTS: Final[tuple[tuple[str, str, str], ...]] = (
    ("checksum_faults", "checksum", "frames with a wrong checksum"),
    ("implausible", "implausible", "frames with a value that the chassis cannot have"),
    ("lost", "alive_lost", "frames that should have come, and did not"),
)
"""Counters of each frame whose rise is told, and the kind of fault that need not be told besides."""

_HARMLESS: Final = frozenset({"unknown_identifier", "remote_frame", "error_frame", "fd_frame"})
"""Frames of others on the bus, mostly."""


class Risen(msgspec.Struct, frozen=True):
    """Something that went wrong.

    Attributes:
        what: alike ones have the same.
        count: so many since the health before.
    """

    what: str
    kind: EntryKind
    severity: Severity
    text: str
    count: int = 1


def risen(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    """What is new.

    Args:
        before: the one before of the same run; None if the log holds none, and then only what is so now is told.
        now: the newest.
    """
    yield from _bus(before, now)
    yield from _frames(before, now)
    if before is not None:
        yield from _counts(before, now)


def _frames(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    were = {} if before is None else {frame.name: frame.failures for frame in before.feedback}
    for frame in now.feedback:
        for failure in frame.failures:
            if failure not in were.get(frame.name, ()):
                words = FAILURES_IN_WORDS.get(failure, failure)
                yield Risen(f"{frame.name} {failure}", EntryKind.FAULT, Severity.WARNING, f"{frame.name}: {words}")
        for failure in were.get(frame.name, ()):
            if failure not in frame.failures:
                text = f"{frame.name}: no longer at fault ({failure})"
                yield Risen(f"{frame.name} {failure} over", EntryKind.FAULT, Severity.INFO, text)


def _counts(before: GatewayHealth, now: GatewayHealth) -> Iterator[Risen]:
    said = set()
    were = {frame.name: frame for frame in before.feedback}
    for field, kind, words in _FRAME_COUNTS:
        for frame in now.feedback:
            was = were.get(frame.name)
            rise = 0 if was is None else getattr(frame, field) - getattr(was, field)
            if rise > 0:
                said.add(kind)
                what = f"{frame.name} {field}"
                yield Risen(what, EntryKind.FAULT, Severity.WARNING, f"{frame.name}: {words}", rise)
    for kind, count in now.faults.items():
        rise = count - before.faults.get(kind, 0)
        if rise > 0 and kind not in said:
            severity = Severity.INFO if kind in _HARMLESS else Severity.WARNING
            yield Risen(f"fault {kind}", EntryKind.FAULT, severity, f"faults of frames: {kind}", rise)
    for field, words in _COUNTS:
        rise = getattr(now, field) - getattr(before, field)
        if rise > 0:
            yield Risen(field, EntryKind.FAULT, Severity.WARNING, words, rise)


def _bus(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    if not now.bus_up and (before is None or before.bus_up):
        detail = f": {now.bus_detail}" if now.bus_detail else ""
        yield Risen("bus down", EntryKind.FAULT, Severity.ERROR, f"the CAN bus {now.bus} is not there{detail}")
    if before is not None and now.bus_up and not before.bus_up:
        yield Risen("bus up", EntryKind.FAULT, Severity.INFO, f"the CAN bus {now.bus} is back")
    if before is not None and now.variant is not before.variant:
        text = f"the firmware variant: {before.variant.value} before, {now.variant.value} now"
        yield Risen("variant", EntryKind.GATEWAY, Severity.INFO, text)
    was = ControllerState.UNKNOWN if before is None else before.controller
    if now.controller is not was and now.controller is not ControllerState.UNKNOWN:
        text = f"the CAN controller: {was.value} before, {now.controller.value} now"
        yield Risen("controller", EntryKind.FAULT, Severity.WARNING, text)

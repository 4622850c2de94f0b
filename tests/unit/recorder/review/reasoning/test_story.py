"""What the arbiter has told of one robot."""

from recorder.review.reasoning.story import Story
from recorder.review.timeline.entries import Entry, EntryKind, EntrySource
from schemas.decisions import RUN_TICKS, Severity
from schemas.reasons import Reason


def _entry(kind: EntryKind, time_ns: int, text: str, *, tick: int, reason: Reason = Reason.NONE) -> Entry:
    return Entry(
        time_ns=time_ns,
        last_ns=time_ns,
        robot="cruiser-1",
        kind=kind,
        severity=Severity.INFO,
        source=EntrySource.EVENT,
        text=text,
        reason=reason,
        tick=tick,
    )


def test_a_reset_is_of_the_latches_that_it_names_in_its_run() -> None:
    """One of another latch, one of nothing, and one of another gateway are none of it."""
    latch = _entry(EntryKind.LATCH, 1, "latched until a reset", tick=10, reason=Reason.REMOTE_STOP)
    others = [
        _entry(EntryKind.RESET, 2, "reset: front_bumper", tick=20),
        _entry(EntryKind.RESET, 3, "reset: nothing was latched", tick=30),
        _entry(EntryKind.RESET, 4, "reset: remote_stop", tick=10 + RUN_TICKS),
    ]
    own = _entry(EntryKind.RESET, 5, "reset: front_bumper, remote_stop", tick=50)
    assert Story([latch, *others]).reset_of(latch) is None
    assert Story([latch, *others, own]).reset_of(latch) == own

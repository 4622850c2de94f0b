"""How the runs of a robot's gateways ended, over all of a log: one that ends at work has died."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress, Row, Selection, read_rows
from recorder.reading.topics import UNREADABLE
from recorder.review.reasoning.scene import Heard, is_other_run
from recorder.review.timeline.clock import NEAR_NS
from schemas.decisions import ArbiterState, SafetyState


class RunEnding(msgspec.Struct, frozen=True):
    """What a log tells of the ends of runs.

    Attributes:
        died: the last state of the last gateway that did not stand by at its end; None if there is none.
        last: the last state of all; None if the log holds none.
    """

    died: Heard[SafetyState] | None = None
    last: Heard[SafetyState] | None = None


def ending(robot: str, logs: Sequence[LogFile], from_ns: int, faults: Faults, progress: Progress) -> RunEnding:
    """How the runs ended from a time on.

    Args:
        robot: its name.
        logs: in the order of their beginnings.
        from_ns: earlier states are not read.
        faults: takes what cannot be read.
        progress: is told that the reading goes on, and of no bytes: they have been told of.
    """
    died: Heard[SafetyState] | None = None
    last: Heard[SafetyState] | None = None
    selection = Selection(lambda topic: topic.robot == robot and topic.kind is SafetyState, from_ns)
    for row in read_rows(logs, selection, faults, lambda _: progress(0)):
        one = _heard(row, faults)
        if one is None:
            continue
        if died is not None and not is_other_run(died.said, one.said):
            died = None  # It lives: two gateways speak for this robot.
        if last is not None and is_other_run(last.said, one.said) and last.said.state is not ArbiterState.STANDBY:
            died = last
        last = one
    return RunEnding(died, last)


def _heard(row: Row, faults: Faults) -> Heard[SafetyState] | None:
    """A state, at the robot's time, or at that of its receipt where the two clocks differ."""
    try:
        state = row.topic.decode(row.data) if row.topic.decode is not None else None
    except UNREADABLE as error:
        faults.add(f"{row.topic.name}: a message that cannot be read: {error}")
        return None
    is_near = abs(row.log_ns - row.publish_ns) <= NEAR_NS
    return Heard(row.publish_ns if is_near else row.log_ns, state) if isinstance(state, SafetyState) else None

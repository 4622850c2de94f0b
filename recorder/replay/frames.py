"""Selection of the frames of a log that may be sent to a CAN bus. Pure; default deny.

The chassis executes the last command indefinitely. A log holds the commands that drove a robot, so a replay to a
bus that is not virtual could drive one, and nobody would stop it. A bus that is not known to be virtual is real.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.topics import UNREADABLE, Topic
from recorder.replay.rows import ReplayRun
from recorder.replay.samples import Wants
from schemas import keys
from schemas.messages import CanFrame, CanFrames

RECEIVED: Final = "can/{bus}/rx"
SENT: Final = "can/{bus}/tx"

NEVER: Final = frozenset({"udp_multicast"})
"""Interfaces of python-can that reach whoever listens, anywhere on the network."""

COMMAND_MASK: Final = 0x1FFF_00FF
COMMAND_IDENTIFIER: Final = 0x18C4_00D0
"""Identifiers of the commands to a chassis of this family, whatever the function in the second byte is."""

DANGER: Final = (
    "a chassis obeys the last command for ever: a command frame that is replayed drives it, and goes on driving "
    "it when the replay has ended; feedback frames make whoever listens there believe a robot that is not there"
)
"""The danger of a replay to a real bus."""


class Rules(msgspec.Struct, frozen=True):
    """The rules by which frames are sent or withheld.

    Attributes:
        is_virtual: no chassis of flesh and blood is on the bus.
        takes_commands: command frames may go to a real bus too.
        takes_fd: the bus takes CAN FD frames.
    """

    is_virtual: bool
    takes_commands: bool = False
    takes_fd: bool = False


class ReplayedFrame(msgspec.Struct, frozen=True, gc=False):
    """A frame to be sent again.

    Attributes:
        time_ns: when it was on the bus, in the log's time.
    """

    time_ns: int
    frame: CanFrame


def refusal(interface: str, *, is_virtual: bool, is_forced: bool) -> str:
    """Return why nothing may be sent there; empty if something may."""
    if interface in NEVER:
        return f"{interface} reaches whoever listens on the network: a log is never replayed there"
    if is_virtual or is_forced:
        return ""
    return (
        f"this bus is not known to be virtual, and {DANGER}. Replay to --interface virtual, to socketcan on a "
        "vcan interface, or to socketcand on the port of a 'cruiser sim' of this machine; or say --force-real-bus "
        "when no robot is on it"
    )


def is_command(frame: CanFrame) -> bool:
    """Return True if a chassis of this family executes the frame."""
    return frame.is_extended and frame.identifier & COMMAND_MASK == COMMAND_IDENTIFIER


def holds_frames(topic: Topic, wants: Wants, *, with_sent: bool) -> bool:
    """Report whether a topic holds raw frames that are wanted: those received, and with the others those sent."""
    parts = keys.parse(topic.name)
    if parts is None or topic.kind is not CanFrame or parts.subject.type is not CanFrames:
        return False
    return (parts.subject.name == RECEIVED or with_sent) and wants(topic.name)


def buses_of(topics: Iterable[Topic]) -> list[str]:
    """The buses that topics of raw frames are of, each as the beginning of its keys."""
    return sorted({topic.name.rpartition("/")[0] for topic in topics})


class Frames:
    """Makes frames of runs of rows.

    Args:
        rules: the frames that may be sent.
        faults: takes what cannot be decoded.

    Attributes:
        withheld: frames that are not sent, by why.
    """

    def __init__(self, rules: Rules, faults: Faults) -> None:
        self._rules = rules
        self._faults = faults
        self.withheld: Counter[str] = Counter()

    def of(self, runs: Iterable[ReplayRun]) -> Iterator[ReplayedFrame]:
        """The frames, in the order of the runs."""
        for run in runs:
            decode = run.topic.decode
            if decode is None:
                continue
            for row in run.rows:
                try:
                    frame: CanFrame = decode(row.data)
                except UNREADABLE as error:
                    self._faults.add(f"{run.topic.name}: a frame cannot be decoded: {error}")
                    continue
                why = self._why_not(run.topic, frame)
                if why:
                    self.withheld[why] += 1
                else:
                    yield ReplayedFrame(run.time_ns, frame)

    def _why_not(self, topic: Topic, frame: CanFrame) -> str:
        rules = self._rules
        if frame.is_error:
            return "error frames"  # A controller tells of its bus with them; none can be sent.
        if frame.is_fd and not rules.takes_fd:
            return "CAN FD frames, without --fd"
        may_command = rules.is_virtual or rules.takes_commands
        if not may_command and (is_command(frame) or topic.subject != RECEIVED):
            return "command frames, to a bus that is not virtual"
        return ""

"""The chassis's feedback on its way out: which frame is due when, its alive counter, its faults. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import msgspec

from gateway.chassis.decode import Value
from gateway.chassis.encode import Encoder
from gateway.chassis.frame import Frame
from gateway.chassis.layout import ChassisLayout
from gateway.sim.disturbances import Disturbances
from gateway.sim.faults import Disturbance

Values = Mapping[str, Value]

_CHECKSUM_BYTE: Final = 7
_CHECKSUM_ERROR: Final = 0xA5
"""The bits that a bad checksum is wrong by. Any but none would do."""


class _Row(msgspec.Struct):
    """One feedback message.

    Attributes:
        sent: number of times that it was due so far.
        counter: the next alive counter, not yet wrapped.
        frozen: the values that it keeps.
    """

    name: str
    can_id: int
    period_ns: int
    next_ns: int
    sent: int = 0
    counter: int = 0
    frozen: Values | None = None


class FeedbackSender:
    """Makes the feedback frames, in the DBC's order, each at its period."""

    def __init__(self, layout: ChassisLayout, start_ns: int, rate_multiplier: float) -> None:
        self._start_ns = start_ns
        self._rate_multiplier = rate_multiplier
        self._rows = [_Row(message.name, message.can_id, message.period_ns, 0) for message in layout.feedback]
        for row in self._rows:
            self._plan(row)

    @property
    def next_ns(self) -> int:
        """The due time of the next frame."""
        return min(row.next_ns for row in self._rows)

    def due(
        self,
        now_ns: int,
        wall_ns: int,
        encoder: Encoder,
        reports: Mapping[str, Callable[[], Values]],
        disturbances: Disturbances,
    ) -> list[Frame]:
        """The frames that are due at this instant; ``reports`` has the values of each message."""
        frames = []
        for row in self._rows:
            if row.next_ns <= now_ns:
                self._plan(row)
                if disturbances.rebooting:
                    row.counter = 0
                    continue
                data = _data(row, encoder, reports[row.name](), disturbances)
                if data:
                    frames.append(Frame(row.can_id, data, wall_ns))
        return frames

    def _plan(self, row: _Row) -> None:
        # From the start, not from the last time: rounding never adds up, and periods in ratio stay in step.
        row.sent += 1
        row.next_ns = self._start_ns + int(row.sent * row.period_ns / self._rate_multiplier)


def _data(row: _Row, encoder: Encoder, values: Values, disturbances: Disturbances) -> bytes:
    """The frame's bytes; none if it is not on the bus."""
    if not disturbances.quiet and disturbances.strike(Disturbance.SILENCE, row.name):
        return b""
    row.frozen = (row.frozen or values) if disturbances.strike(Disturbance.FREEZE, row.name) else None
    values = row.frozen or values
    data = encoder.encode(row.name, values, row.counter).data
    if disturbances.quiet:
        row.counter += 1
        return data
    if disturbances.strike(Disturbance.CHECKSUM, row.name):
        data = data[:_CHECKSUM_BYTE] + bytes([data[_CHECKSUM_BYTE] ^ _CHECKSUM_ERROR])
    if not disturbances.strike(Disturbance.STUCK, row.name):
        row.counter += disturbances.strike(Disturbance.SKIP, row.name) or 1
    return b"" if disturbances.strike(Disturbance.DROP, row.name) else data

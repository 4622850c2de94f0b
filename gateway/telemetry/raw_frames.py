"""Raw frames, gathered into batches."""

from __future__ import annotations

from collections import deque

from gateway.chassis.frame import Frame
from schemas.messages import SEQUENCE_MAX, CanFrames
from schemas.settings import BATCH_MAX_FRAMES


class FrameBatch:
    """Holds frames until they are taken. Bounded: the oldest go first, and are counted.

    Attributes:
        received: frames held since the start, those that were lost here included.
    """

    def __init__(self, bus: str, capacity: int = BATCH_MAX_FRAMES) -> None:
        self._bus = bus
        self._frames: deque[Frame] = deque(maxlen=capacity)
        self._taken = 0
        self._sequence = 0
        self.received = 0

    def add(self, frame: Frame) -> None:
        """Hold a frame."""
        self.received += 1
        self._frames.append(frame)

    def take(self, wall_ns: int) -> CanFrames | None:
        """The frames held, in their order, as one message; None if there are none."""
        frames = self._frames
        if not frames:
            return None
        self._taken += len(frames)
        batch = CanFrames(
            time_ns=wall_ns,
            sequence=self._sequence,
            bus=self._bus,
            dropped=self.received - self._taken,
            frame_time_ns=[frame.wall_ns for frame in frames],
            can_id=[frame.can_id for frame in frames],
            fd_flags=[frame.fd_flags for frame in frames],
            length=[frame.remote_length or len(frame.data) for frame in frames],
            data=[frame.data for frame in frames],
        )
        frames.clear()
        self._sequence = (self._sequence + 1) & SEQUENCE_MAX
        return batch

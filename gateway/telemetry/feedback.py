"""Feedback of the chassis as samples: decoded messages, and raw frames in batches."""

from __future__ import annotations

from collections import Counter, deque

from gateway.chassis.frame import FaultKind, Frame
from gateway.chassis.layout import MessageDecoder, check
from gateway.chassis.supervision import FrameSupervisor
from schemas.codec import Sample, encode
from schemas.messages import SEQUENCE_MAX, CanFrames, Feedback, FrameHealth
from schemas.settings import BATCH_MAX_FRAMES


class FeedbackStream:
    """Turns one feedback frame into samples.

    Attributes:
        decoder: None while the scale of its speeds is unknown.
        latest: the newest message; None before the first, while the frame is silent, and without a decoder.
        data: the newest valid frame's bytes; None before the first and while the frame is silent.
    """

    def __init__(self, decoder: MessageDecoder, faults: Counter[FaultKind]) -> None:
        self.layout = decoder.layout
        self.decoder: MessageDecoder | None = decoder
        self.latest: Feedback | None = None
        self.data: bytes | None = None
        self.supervisor = FrameSupervisor(self.layout.period_ns)
        self._subject = decoder.subject.name
        self._faults = faults
        self._sequence = 0
        self._rated_valid = 0
        self._withheld = 0

    def receive(self, frame: Frame, now_ns: int) -> Sample | None:
        """Return the sample of a frame of this stream, or None if it is not published."""
        fault = check(frame)
        if fault is not None:
            self._faults[fault] += 1
            if fault is FaultKind.CHECKSUM:
                self.supervisor.checksums.fault(now_ns)
            return None
        data = frame.data
        decoder = self.decoder
        message = None if decoder is None else decoder.build(data, frame.wall_ns, self._sequence)
        if message is None and decoder is not None:
            self._faults[FaultKind.IMPLAUSIBLE] += 1
            self.supervisor.implausible.fault(now_ns)
            return None
        faults = self.supervisor.receive(data[6] >> 4, now_ns)
        if faults:
            self._faults.update(faults)
        self.data = data
        if decoder is None or message is None:
            self._withheld += 1
            return None
        if decoder.undefined is not None and decoder.undefined(data):
            self._faults[FaultKind.UNDEFINED_VALUE] += 1
        self._sequence = (self._sequence + 1) & SEQUENCE_MAX
        self.latest = message
        return Sample(self._subject, encode(message))

    def withhold(self) -> None:
        """Publish nothing until a decoder is set, because the scale is in doubt."""
        self.decoder = None
        self.latest = None

    def forget(self) -> None:
        """Forget the newest message, as after a loss of the bus."""
        self.latest = self.data = None

    def tick(self, now_ns: int) -> None:
        fault = self.supervisor.tick(now_ns)
        if fault is not None:
            self._faults[fault] += 1
            self.latest = self.data = None

    def health(self, elapsed_s: float, now_ns: int) -> FrameHealth:
        """Return the stream's health, with its rate since the last call, ``elapsed_s`` ago."""
        supervisor = self.supervisor
        rate_hz = (supervisor.valid - self._rated_valid) / elapsed_s
        self._rated_valid = supervisor.valid
        return FrameHealth(
            name=self.layout.name,
            rate_hz=round(rate_hz, 2),
            valid=supervisor.valid,
            lost=supervisor.lost,
            withheld=self._withheld,
            checksum_faults=supervisor.checksums.faults,
            implausible=supervisor.implausible.faults,
            silent=supervisor.is_silent,
            alive_faults=supervisor.alive.faults,
            failures=supervisor.failures(now_ns),
        )


class FrameBatch:
    """Collects frames until they are taken. Beyond its capacity the oldest are dropped and counted."""

    def __init__(self, bus: str, capacity: int = BATCH_MAX_FRAMES) -> None:
        self._bus = bus
        self._frames: deque[Frame] = deque(maxlen=capacity)
        self._taken = 0
        self._sequence = 0
        self.received = 0  # frames since the start, including dropped ones

    def add(self, frame: Frame) -> None:
        self.received += 1
        self._frames.append(frame)

    def take(self, wall_ns: int) -> CanFrames | None:
        """Return the collected frames, in order, as one message; None if there are none."""
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

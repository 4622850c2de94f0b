"""Both flows on one page; today the telemetry flow. No I/O, no clock: time is an argument.

    frame > ``receive_frame`` > check, supervise, decode > Sample        at the pace of the bus
    time  > ``tick``          > batches, state, health  > Samples        every 10 ms

Each call returns what is to be published; the loop publishes it.
"""

from __future__ import annotations

from typing import Final

from gateway.chassis.decode import check, compile_message, unknown_frame
from gateway.chassis.faults import FaultKind
from gateway.chassis.frame import Frame
from gateway.chassis.layout import load
from gateway.chassis.variant import WHEEL_SPEED, VariantDetector
from gateway.telemetry.feedback import FeedbackStream
from gateway.telemetry.health import HealthMeter, Links
from gateway.telemetry.raw_frames import FrameBatch
from gateway.telemetry.sample import Sample
from gateway.telemetry.state import LatestMessages, robot_state
from schemas.codec import encode
from schemas.dbc_files import DBC_FILES
from schemas.messages import SEQUENCE_MAX, Variant
from schemas.settings import BATCH_PERIOD_NS, HEALTH_PERIOD_NS, STATE_PERIOD_NS, Settings

CONFIGURED_VARIANT: Final = {"auto": Variant.UNKNOWN, "coarse": Variant.COARSE, "fine": Variant.FINE}

SCALED_BY_VARIANT: Final = ("Auto_DriveFeedBack", WHEEL_SPEED)
"""The feedback frames whose layout depends on the variant; a test holds this against the two DBC files."""


class Core:
    """The gateway without its surroundings."""

    def __init__(self, settings: Settings, gateway_version: str, now_ns: int) -> None:
        self._health = HealthMeter(gateway_version, settings.can.bus, now_ns)
        self._batch = FrameBatch(settings.can.bus)
        self._detector = VariantDetector(CONFIGURED_VARIANT[settings.chassis.variant])
        self._links = Links()
        # Until the variant is known the coarse layout serves for the frames that are the same in both.
        layout = load(Variant.COARSE)
        self._streams = {
            message.can_id: FeedbackStream(compile_message(message), self._health.faults)
            for message in layout.feedback
        }
        self._commands = {message.can_id for message in layout.commands}
        self._known = self._streams.keys() | self._commands
        # Both variants, here and once: to compile a decoder takes a millisecond, too long for the loop.
        self._scaled = [
            (
                self._streams[layout.messages[name].can_id],
                {variant: compile_message(load(variant).messages[name]) for variant in DBC_FILES},
            )
            for name in SCALED_BY_VARIANT
        ]
        self._wheel_speed = layout.messages[WHEEL_SPEED].can_id
        self._apply_variant()
        self._state_due_ns = self._batch_due_ns = now_ns
        self._health_due_ns = now_ns + HEALTH_PERIOD_NS
        self._state_sequence = 0

    @property
    def variant(self) -> Variant:
        """The firmware variant in force; UNKNOWN while there is no evidence, or evidence against it."""
        return Variant.UNKNOWN if self._detector.contradicted else self._detector.variant

    def receive_frame(self, frame: Frame, now_ns: int) -> Sample | None:
        """A frame came from the bus. Returns the decoded sample, if the frame is a valid feedback frame."""
        self._batch.add(frame)
        stream = self._streams.get(frame.can_id)
        if stream is None:
            self._receive_other(frame)
            return None
        if frame.can_id == self._wheel_speed and check(frame) is None:
            self._observe_variant(frame)
        return stream.receive(frame, now_ns)

    def observe_links(self, links: Links) -> None:
        """What the loop sees of the bus and of Zenoh. A bus that returns may have another chassis on it."""
        if links.bus_losses != self._links.bus_losses:
            self._detector.reset()
            self._apply_variant()
        self._links = links

    def tick(self, now_ns: int, wall_ns: int, late_ns: int) -> list[Sample]:
        """Every 10 ms. Returns what is due: raw frames, state, health."""
        due: list[Sample] = []
        self._health.tick_lateness(late_ns)
        for stream in self._streams.values():
            if now_ns > stream.supervisor.overdue_ns:
                stream.tick(now_ns)
        if now_ns >= self._batch_due_ns:
            self._batch_due_ns = _next_due(self._batch_due_ns, BATCH_PERIOD_NS, now_ns)
            batch = self._batch.take(wall_ns)
            if batch is not None:
                due.append(Sample("can/{bus}/rx", encode(batch)))
        if now_ns >= self._state_due_ns:
            self._state_due_ns = _next_due(self._state_due_ns, STATE_PERIOD_NS, now_ns)
            due.append(self._state(wall_ns))
        if now_ns >= self._health_due_ns:
            self._health_due_ns = _next_due(self._health_due_ns, HEALTH_PERIOD_NS, now_ns)
            streams = list(self._streams.values())
            frames = self._batch.received
            health = self._health.report(now_ns, wall_ns, self._links, self.variant, frames, streams)
            due.append(Sample("gateway/health", encode(health)))
        return due

    def _receive_other(self, frame: Frame) -> None:
        """A frame that is no feedback. A command frame of another computer is no fault: it may own the bus."""
        if frame.can_id in self._commands:
            return
        fault = unknown_frame(frame, self._known)
        self._health.faults[fault.kind] += 1
        if fault.kind is FaultKind.UNKNOWN_IDENTIFIER:
            self._health.unknown_identifier(frame.can_id)

    def _observe_variant(self, frame: Frame) -> None:
        before = self.variant
        fault = self._detector.receive_wheel_speed(frame.data)
        if fault is not None:
            self._health.faults[fault] += 1
        if self.variant is not before:
            self._apply_variant()

    def _apply_variant(self) -> None:
        """Give the frames whose scale depends on the variant their decoder, or none while it is in doubt."""
        variant = self.variant
        for stream, decoders in self._scaled:
            stream.withhold()
            stream.decoder = decoders.get(variant)

    def _state(self, wall_ns: int) -> Sample:
        streams = self._streams.values()
        state = robot_state(
            LatestMessages([stream.latest for stream in streams if stream.latest is not None]),
            time_ns=wall_ns,
            sequence=self._state_sequence,
            bus_up=self._links.bus_up,
            variant=self.variant,
            silent=[stream.layout.name for stream in streams if stream.supervisor.is_silent],
        )
        self._state_sequence = (self._state_sequence + 1) & SEQUENCE_MAX
        return Sample("state", encode(state))


def _next_due(due_ns: int, period_ns: int, now_ns: int) -> int:
    """The next multiple of the period after now: a late tick is made up for once, not many times."""
    return due_ns + period_ns * ((now_ns - due_ns) // period_ns + 1)

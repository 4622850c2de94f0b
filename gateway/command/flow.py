"""The command flow on one page: arbiter, frames, gate and reports together. Pure.

requests > ``tick`` > arbiter > frames > gate > ``TickEffects``: frames to send, replies, samples
the bus  > ``sent`` > counters advance, decisions go out
"""

from __future__ import annotations

from typing import Final

import msgspec

from gateway.chassis.frame import Frame
from gateway.chassis.port import Chassis, ChassisState
from gateway.command.arbiter import Arbiter, Reporter, reply
from gateway.command.rulings import RawRequest, TickOutcome
from schemas.codec import Sample, sample_of
from schemas.decisions import COMMANDING, ArbiterState, SafetyEvent
from schemas.reasons import Reason
from schemas.settings import MUTE_FAILURES, Settings
from schemas.subjects import RESET_ODOMETRY_VERB


class PendingReply(msgspec.Struct, frozen=True):
    """A reply that is due. The sender attaches its proof."""

    handle: int
    verb: str
    payload: bytes
    attachment: bytes = b""


class TickEffects(msgspec.Struct):
    """The effects of a tick, in this order: send the frames, report how many were sent, reply, publish, log."""

    frames: list[Frame]
    replies: list[PendingReply]
    samples: list[Sample]
    events: list[SafetyEvent]
    resets_odometry: bool = False


class CommandFlow:
    """Everything between a request and a frame.

    Attributes:
        is_mute: the gate refuses even the stop sequence, or the connection to the bus is lost: the guard must act.
        busy_ns: time of the last request, command or event, monotonic.
        asked_ns: time of the last request or command, monotonic.
    """

    def __init__(self, chassis: Chassis, settings: Settings, run: int) -> None:
        self._design = chassis
        self.arbiter = Arbiter(chassis, settings, run)
        self.is_mute = False
        self.maker = chassis.maker()
        self.gate = chassis.gate(False)  # noqa: FBT003 - a value of the chassis takes no keywords
        self.reporter = Reporter(self.arbiter)
        self.busy_ns = self.asked_ns = 0
        self._tellings = 0
        self._outcome: TickOutcome | None = None
        self._offered: list[Frame] = []

    def tick(
        self,
        chassis: ChassisState,
        requests: list[RawRequest],
        now_ns: int,
        wall_ns: int,
        late_ns: int,
        challenge: bytes,
    ) -> TickEffects:
        """Run the tick, every 10 ms; see ``Arbiter.tick``. The challenge is published if a state is due."""
        outcome = self._outcome = self.arbiter.tick(chassis, requests, now_ns, late_ns)
        self._offered = self._frames(outcome, now_ns)
        if outcome.judged or outcome.actuation is not None:
            self.asked_ns = self.busy_ns = now_ns
        elif outcome.events:
            self.busy_ns = now_ns
        events = [self.reporter.event(event, wall_ns) for event in outcome.events]
        state = self.reporter.state(now_ns, wall_ns, challenge)
        samples = [sample_of(message) for message in (*events, state) if message is not None]
        replies = [
            PendingReply(answer.handle, answer.verb, _ENCODER.encode(reply(answer))) for answer in outcome.answers
        ]
        resets_odometry = any(
            one.request.verb == RESET_ODOMETRY_VERB and one.ruling.reason is Reason.NONE for one in outcome.judged
        )
        return TickEffects(self._offered, replies, samples, events, resets_odometry)

    def sent(self, count: int, now_ns: int, wall_ns: int) -> list[Sample]:
        """Note how many of the tick's frames the bus accepted; the rest are never sent. Returns the decisions."""
        outcome, offered = self._outcome, self._offered
        if outcome is None:
            return []
        self._outcome, self._offered = None, []
        sent = offered[:count]
        self.maker.sent(sent)
        self.gate.sent(sent, now_ns)
        monitor = self.arbiter.monitor
        monitor.send_failures = monitor.send_failures + 1 if len(sent) < len(offered) else 0
        bounds = self.arbiter.output.motion.bounds if self.arbiter.state is ArbiterState.ENGAGED else []
        if len(sent) >= len(self._design.motion_frames):
            self.arbiter.output.told_ns = now_ns
            self.arbiter.note_left()
        elif offered:
            self.arbiter.output.undo_step(is_speed_told=bool(sent))
        if monitor.send_failures >= MUTE_FAILURES and self.arbiter.state is ArbiterState.STOPPING:
            self.is_mute = True
        return [sample_of(self.reporter.decision(judged, bounds, len(sent), wall_ns)) for judged in outcome.judged]

    def _frames(self, outcome: TickOutcome, now_ns: int) -> list[Frame]:
        if outcome.actuation is None:
            self.is_mute = self.arbiter.handover.is_cut_off
            self.gate.pause()
            return []
        if self.arbiter.output.begun != self._tellings:
            # It yielded and began again in one tick: the gate must not compare this burst with the one before.
            self._tellings = self.arbiter.output.begun
            self.gate.pause()
        variant = self.arbiter.output.variant
        frames = self.maker.make(outcome.actuation, outcome.auxiliary, variant)
        is_stop = self.arbiter.state not in COMMANDING
        fault = self.gate.admit(frames, variant, now_ns, stopping=is_stop)
        if fault is None:
            self.is_mute = False
            return frames
        # Send zero speed and the parking brake instead. If the gate refuses these too, only the guard is left.
        instead = self.arbiter.engagement.refuse_output(
            f"{fault.can_id & 0x1FFF_FFFF:08X}: {fault.detail}", now_ns
        )
        frames = self.maker.make(instead, [], variant)
        self.is_mute = self.gate.admit(frames, variant, now_ns, stopping=True) is not None
        return [] if self.is_mute else frames


_ENCODER: Final = msgspec.msgpack.Encoder()

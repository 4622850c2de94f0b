"""A guard beside a simulated gateway and a simulated chassis: one time, one bus, no clocks."""

from collections.abc import Callable
from typing import Any, Union

import msgspec

from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.frames import load
from gateway.chassis.cruiser.gate import Gate
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder, Value
from gateway.chassis.port import Actuation
from gateway.choice.chassis import CHASSIS
from gateway.guard.guardian import Guardian
from gateway.guard.stopper import Beat
from gateway.sim.model import VirtualChassis
from schemas.messages import GearPosition, Mode, Variant
from schemas.settings import GUARD_POLL_NS, TICK_NS, CommandSettings
from tests.support.rigs.chassis import fault_line

MS = 1_000_000
S = 1_000_000_000

DRIVING = Actuation(enabled=True, gear=GearPosition.DRIVE, speed_mps=1.0, parking=False)


BURST = 8  # frames at the beginning of a stop: the five, and those that end lamps, horn and odometer


class GuardRig:
    """Time passes in polls of 5 ms; the loop ticks in every second one, as long as it lives.

    Attributes:
        left: the loop's last command before its silence, if the chassis may follow it again.
    """

    def __init__(self, variant: Variant = Variant.COARSE, settings: CommandSettings | None = None) -> None:
        self.now_ns = S
        self.variant = variant
        self.chassis = VirtualChassis(CHASSIS, variant, self.now_ns)
        self.guardian = Guardian(CHASSIS, settings or CommandSettings())
        self.gate = Gate(may_release=True)
        self.loop_lives = self.parent_lives = self.bus_up = True
        self.mute = False
        self.takes = BURST  # how many frames of a burst the bus takes
        self.see: Callable[[Frame], Frame] = lambda frame: frame  # changes a feedback frame for the guard
        self.told: Actuation | None = None  # the loop's command; None for silence
        self.left: Actuation | None = None
        self.told_ns = 0
        self.told_variant = variant
        self.maker = FrameMaker()
        self.beat: Beat | None = None
        self.sent: list[tuple[int, Frame]] = []
        self.by_loop: list[Frame] = []
        self.lines: list[str] = []
        self.mark = (0, 0)  # number of frames of guard and loop at the last mark
        self.fastest_mps = 0.0  # the robot's highest speed since then
        self._was_told = False
        self._last = DRIVING

    def fault(self, text: str) -> None:
        self.chassis.inject(fault_line(text), self.now_ns)

    def drive(self, told: Actuation = DRIVING, seconds: float = 1.5) -> None:
        """Let the gateway drive until the robot rolls."""
        self.told = Actuation(enabled=True)
        self.run(0.2)
        assert self.chassis.state.mode is Mode.AUTO
        self.told = told
        self.run(seconds)

    def play(self, *steps: "Step") -> None:
        for step in steps:
            match step:
                case float():
                    self.run(step)
                case str():
                    self.fault(step)
                case tuple():
                    self.play(*step)
                case dict():
                    for knob, value in step.items():
                        setattr(self, knob, value)
                case _:
                    step(self)

    def pretend(self, name: str, **values: Value) -> None:
        """Show the guard these values in place of a feedback message's."""
        encoder, can_id = Encoder(load(self.variant)), load(self.variant).messages[name].can_id
        self.see = lambda frame: (
            encoder.encode(name, values, frame.data[6] >> 4) if frame.can_id == can_id else frame
        )

    def set_mark(self) -> None:
        self.mark = (len(self.sent), len(self.by_loop))
        self.fastest_mps = 0.0

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * S / GUARD_POLL_NS)):
            self.now_ns += GUARD_POLL_NS
            self._chassis()
            if self.loop_lives and self.parent_lives and self.now_ns % TICK_NS == 0:
                self.loop()
            self._guard()
            self.fastest_mps = max(self.fastest_mps, abs(self.chassis.state.speed_mps))

    def look_when_due(self, seconds: float) -> None:
        """Let time pass in steps of 1 ms without a loop; the guard looks when it is due."""
        due_ns = self.now_ns + 3 * MS
        for _ in range(round(seconds * S / MS)):
            self.now_ns += MS
            self._chassis()
            if self.now_ns >= due_ns:
                self._guard()
                due_ns = self.guardian.next_look_ns(self.now_ns)

    def close(self) -> None:
        """The gateway announces its end, and falls silent; its process is still there."""
        assert self.beat is not None
        self.loop_lives = False
        self.beat = msgspec.structs.replace(self.beat, is_closing=True)

    def poll(self) -> list[Frame]:
        before = len(self.sent)
        self.run(GUARD_POLL_NS / S)
        return [frame for _, frame in self.sent[before:]]

    def _chassis(self) -> None:
        for frame in self.chassis.advance(self.now_ns):
            self.guardian.receive(self.see(frame), self.now_ns)

    def loop(self) -> None:
        is_told = self.told is not None
        if self.told is not None and not self.mute and not self.guardian.is_sending:
            frames = self.maker.make(self.told, [], self.variant)
            self.maker.sent(frames)
            self.told_ns = self.now_ns
            self.gate = Gate(may_release=True)
            for frame in frames:
                self.by_loop.append(frame)
                self.chassis.receive(frame, self.now_ns)
                self.guardian.receive(frame, self.now_ns)
        if self.told is not None:
            self.left = None
        elif self._was_told and self._last.enabled:
            self.left = self._last
        self.beat = Beat(
            now_ns=self.now_ns,
            told_ns=self.told_ns,
            is_active=is_told or self._was_told,
            is_left=self.left is not None,
            is_mute=self.mute,
            variant=self.told_variant,
            last=self.told or self._last,
            counters=bytes(self.maker.counters.values()),
        )
        self._was_told = is_told
        self._last = self.told or self._last

    def _guard(self) -> None:
        if self.guardian.is_ended:
            return
        offered = self.guardian.tick(self.beat, self.now_ns, parent_lives=self.parent_lives, bus_up=self.bus_up)
        taken = offered[: self.takes]
        for frame in taken:
            self.sent.append((self.now_ns, frame))
            self.chassis.receive(frame, self.now_ns)
        if offered:
            assert self.guardian.is_sending
            # A gate of the test's own, which knows nothing of the guard's.
            assert self.gate.admit(offered, self.told_variant, self.now_ns, stopping=True) is None
            self.gate.sent(taken, self.now_ns)
            self.guardian.sent(len(taken), self.now_ns)
        self.lines += self.guardian.take_lines()


# Seconds; a fault of the chassis; knobs; anything else; several of them.
Step = Union[float, str, dict[str, Any], Callable[[GuardRig], None], tuple["Step", ...]]  # noqa: UP007 - recursive

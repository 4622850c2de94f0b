"""Forty seconds in which everything happens, in simulated time."""

from collections.abc import Callable
from functools import cache
from random import Random

import msgspec
import pytest

from gateway import core
from gateway.journal import inputs_of
from gateway.telemetry.health import Links
from schemas.decisions import Journal
from schemas.journal import Kind
from schemas.messages import Variant
from schemas.settings import CommandSettings
from tests.support.rigs.gateway import GUARDED, Operator
from tests.support.rigs.recorded import RecordedRig

DAY_TICKS = 3500
MINUTE_TICKS = 6000
QUIET_NS = 8_000_000_000  # the end of a day
RUN = 2**53 - 1
STARTED_NS = 123_456_789_012_345
# Not the defaults: a rerun without its configuration differs.
COMMAND = CommandSettings(speed_limit_mps=1.5, deadman_s=0.25, lease_s=1.5)
FAULTS = (
    "silence Auto_GearFeedBack for 300ms",
    "silence all for 500ms",
    "checksum Auto_DriveFeedBack for 3 frames",
    "stuck Auto_SteeringFeedBack for 8 frames",
    "skip Auto_MileageAndBodyFeedback by 5 for 2 frames",
    "drop Auto_WheelSpdFeedback next 3",
    "foreign 18C4D2EF 0000000000000000 every 20ms for 200ms",
    "foreign 18C4D3D0 every 10ms for 100ms",
    "bumper front on for 700ms",
    "bumper both on for 300ms",
    "transmitter remote for 900ms",
    "scale wrong for 800ms",
    "sticks 0.5 5",
)


class Day:
    """Forty seconds with two operators at work, and all that fails around them."""

    def __init__(self, seed: int, variant: Variant, ticks: int = DAY_TICKS) -> None:
        self._ends_ns = STARTED_NS + ticks * 10_000_000
        self.rig = RecordedRig(variant, COMMAND, now_ns=STARTED_NS, run=RUN)
        self._random = Random(seed)  # noqa: S311 - the same day each time
        self._operators = [Operator(self.rig, "first"), Operator(self.rig, "berta")]

    def live(self) -> None:
        """Act it out; its last seconds are quiet, and the gateway ends in them."""
        actions: list[Callable[[], None]] = [
            *[self._drive] * 14,
            self._stop,
            self._garbage,
            self._lights,
            self._fault,
            self._fault,
            self._links,
            self._bad_bus,
            self._late,
            self._clock_steps,
            self._hand_over,
        ]
        self.rig.run(0.6)
        while self.rig.now_ns < self._ends_ns - QUIET_NS:
            self._random.choice(actions)()
        self._heal()
        self.rig.run(1)
        self._drive()
        self.rig.core.shut_down(self.rig.now_ns)
        self.rig.until(lambda: self.rig.core.is_at_rest, 10)
        self.rig.run(1)

    def _drive(self) -> None:
        """Engage, with an override if necessary, then drive at random."""
        operator = self._random.choice(self._operators[:1] * 3 + self._operators)
        if self.rig.core.lease_holder != operator.name:
            operator.take_lease("take", override=True)
        if not self.rig.says.engaged:
            self.rig.run(2.5)
            operator.take_lease("take", override=True)
            operator.reset()
            operator.ask("engage")
            self.rig.run(0.2)
            operator.drive(0.0)
            operator.ask("unpark")
        uniform = self._random.uniform
        operator.drive(uniform(-2.0, 2.0), uniform(-30, 30), uniform(0.3, 1.5))

    def _stop(self) -> None:
        self.rig.put("passer-by", "stop", self._random.randbytes(5))
        self.rig.tick()

    def _garbage(self) -> None:
        for verb in ("drive", "engage", "no-such-verb", "acquire", ""):
            self.rig.query("stranger", verb, self._random.randbytes(self._random.randrange(40)))
            self.rig.put("", verb, self._random.randbytes(3))
        self.rig.tick()

    def _lights(self) -> None:
        operator = self._operators[0]
        operator.ask("light", headlamp=True, left=True)
        operator.ask("horn", on=True)
        operator.ask("clear_odometer")
        self.rig.tick(3)

    def _fault(self) -> None:
        self.rig.fault(self._random.choice(FAULTS))

    def _links(self) -> None:
        lost = self.rig.links.bus_losses + 1
        self.rig.links = self._random.choice(
            [
                Links(bus_up=False, bus_losses=lost),
                Links(bus_up=True, bus_losses=lost - 1, guarded=False),
                Links(bus_up=True, bus_losses=lost - 1, guarded=True, guard_sends=True),
            ]
        )
        self.rig.run(self._random.uniform(0.05, 0.4))
        self.rig.links = msgspec.structs.replace(GUARDED, bus_losses=self.rig.links.bus_losses)

    def _bad_bus(self) -> None:
        for _ in range(self._random.randrange(1, 8)):
            self.rig.takes = self._random.randrange(6)
            self.rig.tick()
        self.rig.takes = None

    def _late(self) -> None:
        self.rig.late_ns = self._random.randrange(200) * 1_000_000
        self.rig.tick()
        self.rig.late_ns = 0

    def _clock_steps(self) -> None:
        self.rig.wall_ns += self._random.choice([-1, 1]) * 3_600_000_000_000

    def _hand_over(self) -> None:
        self._operators[1].take_lease("take", role="supervisor", override=True)
        self._operators[1].ask("release")
        self.rig.tick()

    def _heal(self) -> None:
        self.rig.fault("clear")
        self.rig.run(3)


class RestfulDay(Day):
    """A drive or an incident, then a pause; again and again."""

    rounds = 5

    def live(self) -> None:
        rig, first = self.rig, self._operators[0]
        rig.run(9)
        acts = [self._drive, self._stop, self._fault, self._lights, self._hand_over, self._bad_bus, self._links]
        for number in range(self.rounds):
            self._drive()
            acts[number % len(acts)]()
            self._drive()
            rig.fault("clear")
            rig.links = GUARDED
            rig.run(3)
            if number % 2:
                first.take_lease("take", override=True)
                first.reset()
                first.ask("release")
            else:
                first.take_lease("take", override=True)
                rig.run(0.6)
                first.reset()
            rig.run(9)


@cache
def restful_day(seed: int, rounds: int = 5) -> RestfulDay:
    """Such a day, with a checkpoint at each rest."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core, "REST_PERIOD_NS", 100_000_000)
        day = RestfulDay(seed, Variant.COARSE, ticks=0)
        day.rounds = rounds
        day.live()
    return day


def under_rules_1(journal: Journal) -> Journal:
    """The journal as of rules 1: ticks without a challenge, requests without a fault."""
    kept = {Kind.TICK: 4, Kind.REQUEST: 7}
    inputs = [one[: kept.get(one[0])] for one in inputs_of(journal)]
    return msgspec.structs.replace(journal, rules=0, inputs=msgspec.msgpack.encode(inputs))

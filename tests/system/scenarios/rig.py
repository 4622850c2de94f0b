"""The gateway's core, its guard and an operator beside the plant, in simulated time.

``Gateway`` and ``Guard`` hold all that this suite knows of the gateway's interfaces.
"""

from __future__ import annotations

from collections import deque
from random import Random
from typing import Final

import msgspec

from gateway.chassis.frame import EXTENDED, IDENTIFIER_MASK, Frame
from gateway.chassis.port import AT_REST
from gateway.choice.chassis import CHASSIS
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.guard.guardian import Guardian
from gateway.guard.stopper import Beat, GuardView
from gateway.rerun import rerun
from gateway.telemetry.health import Links
from schemas.codec import Sample
from schemas.decisions import Journal, StopPhase
from schemas.settings import CommandSettings, Settings
from tests.system.scenarios.oracle import Fields, Oracle
from tests.system.scenarios.plant import BODY, STEP_NS, CanFrame, Plant, checksum

TICK_NS: Final = 10_000_000
WALL_NS: Final = 1_700_000_000_000_000_000
NAME: Final = "operator"
PUTS: Final = frozenset({"drive"})
UNLEASED: Final = frozenset({"acquire", "take", "stop"})

LEASE_LOST: Final = frozenset({"no_lease", "lease_expired", "lease_taken", "lease_released"})

CHECKSUM_FAULTS: Final = 5  # damaged frames of one identifier within a second that justify a stop


class Gateway:
    """The core from outside: requests as fields, frames as identifier and bytes.

    Attributes:
        state: the newest safety/state; empty before the first.
        replies: verb and fields of the last tick's replies.
        samples: all that was published, if it is stored.
    """

    def __init__(
        self,
        settings: Settings,
        random: Random,
        *,
        keeps: bool,
        now_ns: int = 0,
        stopped_before: bool = False,
        crashed: bool = False,
    ) -> None:
        self._settings = settings
        self._random = random
        self._run = random.getrandbits(48)
        self._core = Core(CHASSIS, settings, "", now_ns, self._run)
        if crashed:
            self._core.note_crash(now_ns)
        if stopped_before:
            self._core.latch_guard_stop("the guard stopped the robot", now_ns)
        self._requests: list[tuple[str, Fields]] = []
        self._verbs: dict[int, str] = {}
        self._handle = 0
        self._keeps = keeps
        self._was_told = False
        self.samples: list[Sample] = []
        self.state: Fields = {}
        self.replies: list[tuple[str, Fields]] = []

    @staticmethod
    def echo(state: Fields) -> Fields:
        """The part of a state that a request carries."""
        return {name: state[name] for name in ("tick", "challenge") if name in state}

    @staticmethod
    def fields(verb: str, lease: int, echo: Fields, **fields: object) -> Fields:
        carried = {"drive": echo, "engage": {k: v for k, v in echo.items() if k == "challenge"}}.get(verb, {})
        return {**({} if verb in UNLEASED else {"lease": lease}), **carried, **fields}

    def ask(self, verb: str, fields: Fields) -> None:
        self._requests.append((verb, fields))

    def receive(self, frames: list[CanFrame], now_ns: int) -> None:
        for identifier, data in frames:
            sample = self._core.receive_frame(Frame(identifier | EXTENDED, data), now_ns)
            if self._keeps and sample is not None:
                self.samples.append(sample)

    def tick(
        self, now_ns: int, late_ns: int, guard: GuardView, bus: Bus, *, former_sends: bool = False
    ) -> list[CanFrame]:
        """One tick of the loop. Returns its frames: none while a guard has the robot."""
        for verb, fields in self._requests:
            self._handle += 1
            handle = 0 if verb in PUTS else self._handle
            self._verbs[handle] = verb
            payload = msgspec.msgpack.encode(fields)
            self._core.receive_request(RawRequest(handle, verb, NAME, payload, len(payload)), now_ns)
        self._requests = []
        links = Links(
            bus_up=not bus.is_away,
            bus_losses=bus.losses,
            guarded=guard.is_watching,
            guard_sends=guard.is_sending or (former_sends and self._core.hears_commands(now_ns)),
            guard_stops=guard.stops,
            realtime=True,
        )
        self._core.update_links(links, now_ns)
        wall_ns = WALL_NS + now_ns
        due = self._core.tick(now_ns, wall_ns, late_ns, self._random.randbytes(8))
        frames = [] if guard.is_sending else due.frames
        self.replies = [(self._verbs.pop(one.handle), msgspec.msgpack.decode(one.payload)) for one in due.replies]
        samples = [*due.samples, *self._core.sent(bus.takes(len(frames)), now_ns, wall_ns)]
        for sample in samples:
            if sample.subject == "safety/state":
                self.state = msgspec.msgpack.decode(sample.payload)
        if self._keeps:
            self.samples += samples
        return [(frame.can_id & IDENTIFIER_MASK, frame.data) for frame in frames]

    def beat(self, before: Beat, now_ns: int) -> Beat:
        """The heartbeat for the guard after a tick, as the gateway's process writes it."""
        command = self._core.command
        assert command is not None
        arbiter = command.arbiter
        sequence = arbiter.output.sequence
        actuation, left = arbiter.output.actuation, arbiter.handover.left
        is_told = actuation is not None or command.is_mute
        is_active = is_told or (self._was_told and left is None)
        self._was_told = is_told
        return Beat(
            now_ns=now_ns,
            told_ns=arbiter.output.told_ns,
            is_active=is_active,
            is_left=left is not None and left.enabled,
            is_mute=command.is_mute,
            variant=arbiter.output.variant,
            last=actuation or left or (before.last if is_active else AT_REST),
            counters=bytes(command.maker.counters.values()),
            is_released=sequence is not None and sequence.phase is StopPhase.MOTOR,
            returns=0 if sequence is None else sequence.returns,
        )

    def differs_when_run_again(self) -> str:
        """Run the journal again. Returns the first difference, or nothing."""
        lived = [*self.samples, *self._core.last_batches(0)]
        journals = [msgspec.msgpack.decode(s.payload, type=Journal) for s in lived if s.subject == "journal"]
        again = list(rerun(self._settings, journals))
        for kind in ("safety/state", "safety/decision", "safety/event", "chassis/gear", "chassis/drive"):
            was, now = ([s.payload for s in some if s.subject == kind] for some in (lived, again))
            if was != now:
                return f"{kind}: {len(was)} lived, {len(now)} again"
        return "" if _sent(lived) == _sent(again) else "the frames that were sent"


def _sent(samples: list[Sample]) -> list[tuple[int, bytes]]:
    """The frames of the batches; batch borders depend on when the core was made."""
    batches = [msgspec.msgpack.decode(sample.payload) for sample in samples if sample.subject == "can/{bus}/tx"]
    return [frame for batch in batches for frame in zip(batch["can_id"], batch["data"], strict=True)]


class Guard:
    def __init__(self, settings: CommandSettings) -> None:
        self._guardian = Guardian(CHASSIS, settings)
        self._beat: Beat | None = None
        self.lines: list[str] = []

    @property
    def is_sending(self) -> bool:
        return self._guardian.is_sending

    @property
    def has_stopped(self) -> bool:
        return self._guardian.stops > 0

    def view(self, now_ns: int) -> GuardView:
        status = self._guardian.status(now_ns, bus_up=True)
        return GuardView(status.is_ready, status.is_sending, status.stops)

    def hear(self, frames: list[CanFrame], now_ns: int) -> None:
        for identifier, data in frames:
            self._guardian.receive(Frame(identifier | EXTENDED, data), now_ns)

    def told(self, gateway: Gateway, now_ns: int) -> None:
        self._beat = gateway.beat(self._beat or Beat(0), now_ns)

    def tick(self, now_ns: int, bus: Bus, *, parent_lives: bool) -> list[CanFrame]:
        """Every 5 ms. Returns the guard's frames."""
        if self._guardian.is_ended:
            return []
        frames = self._guardian.tick(self._beat, now_ns, parent_lives=parent_lives, bus_up=not bus.is_away)
        if frames:
            self._guardian.sent(bus.takes(len(frames)), now_ns)
        self.lines += self._guardian.take_lines()
        return [(frame.can_id & IDENTIFIER_MASK, frame.data) for frame in frames]


class Leg(msgspec.Struct, frozen=True):
    """A part of the operator's script, with a request at its beginning."""

    lasts_s: float
    speed_mps: float = 0.0
    angle_deg: float = 0.0
    streams: bool = True
    verb: str = ""


class Operator:
    """Drives by a script at 50 Hz. After a stop it goes on sending for a while, and may then engage again."""

    def __init__(self, legs: list[Leg], *, gives_up_s: float, recovers: bool) -> None:
        self._legs = deque(legs)
        self._gives_up_s = gives_up_s
        self._recovers = recovers
        self._lease = 0
        self._sequence = 0
        self._step = "acquire"
        self._due_s = 0.5
        self._leg_ends_s = 0.0
        self._leg: Leg | None = None
        self._lost_s: float | None = None
        self._backs_until_s = 0.0
        self._backs_mps = 0.0
        self.seen: Fields = {}
        self.is_done = False

    def wait_until(self, now_s: float) -> None:
        """Send no request before this time."""
        self._due_s = now_s

    def receive_reply(self, verb: str, reply: Fields, now_s: float) -> None:
        if verb == "acquire" and reply["ok"]:
            self._lease, self._sequence, self._step = reply["lease"], 0, "engage"
        elif reply["reason"] in LEASE_LOST and self._step != "drive":
            self._step = "acquire"
        elif verb == "engage" and reply["ok"]:
            self._step, self._lost_s = "unpark", None
        elif verb == "engage" and self.seen.get("latched"):
            self._step = "reset"
        elif verb == "reset" and reply["ok"]:
            self._step = "engage"
        elif verb == "unpark" and reply["ok"]:
            self._step = "drive"
            self._leg_ends_s = max(self._leg_ends_s, now_s)
        self._due_s = min(self._due_s, now_s + 0.3)

    def act(self, now_s: float) -> list[tuple[str, Fields]]:
        asked: list[tuple[str, Fields]] = []
        if not self.seen:
            return asked
        if self._step != "drive":
            if now_s >= self._due_s:
                self._due_s = now_s + 0.7
                asked.append(self._ask(self._step))
            return [*asked, *self._drive(0.0, 0.0)] if self._lease else asked
        if self._lost_s is None and not self.seen["engaged"] and self._leg is not None:
            self._lost_s = now_s
            latched = self.seen["latched"]
            self._backs_mps = -0.3 * ("front_bumper" in latched) + 0.3 * ("rear_bumper" in latched)
        if self._lost_s is not None and now_s - self._lost_s > self._gives_up_s and self._recovers:
            self._step, self._due_s = ("reset" if self.seen["latched"] else "engage"), now_s
            self._backs_until_s = now_s + 5.0 if self._backs_mps else 0.0
            return self._drive(0.0, 0.0)
        return [*self._next_leg(now_s), *self._follow(now_s)]

    def _next_leg(self, now_s: float) -> list[tuple[str, Fields]]:
        if now_s < self._leg_ends_s:
            return []
        if not self._legs:
            self.is_done = True
            self._leg = Leg(60.0, streams=False)
            self._leg_ends_s = now_s + 60.0
            return []
        self._leg = self._legs.popleft()
        self._leg_ends_s = now_s + self._leg.lasts_s
        return [self._ask(self._leg.verb)] if self._leg.verb else []

    def _follow(self, now_s: float) -> list[tuple[str, Fields]]:
        leg = self._leg
        if leg is None or not leg.streams:
            return []
        backs = self._backs_mps and now_s < self._backs_until_s
        return self._drive(self._backs_mps if backs else leg.speed_mps, 0.0 if backs else leg.angle_deg)

    def _drive(self, speed_mps: float, angle_deg: float) -> list[tuple[str, Fields]]:
        self._sequence += 1
        return [self._ask("drive", seq=self._sequence, speed_mps=speed_mps, angle_deg=angle_deg)]

    def _ask(self, verb: str, **fields: object) -> tuple[str, Fields]:
        return verb, Gateway.fields(verb, self._lease, Gateway.echo(self.seen), **fields)


class Bus:
    """Loses and damages frames, takes a part of a burst, and can be away.

    Attributes:
        loss, corruption: shares of the frames.
        most: frames of a burst that it takes; None for all.
        losses: how often it has gone away.
        failed_ns: when damage was last a cause to stop by the rule on checksum faults.
        passed_ns: when a damaged frame with a right checksum last may have changed bumper or mode.
    """

    def __init__(self, random: Random, loss: float, corruption: float) -> None:
        self.loss = loss
        self.corruption = corruption
        self.most: int | None = None
        self.is_away = False
        self.losses = 0
        self.failed_ns = self.passed_ns = -(10**12)
        self._damaged_ns: dict[int, deque[int]] = {}
        self._random = random

    def go(self, *, away: bool) -> None:
        self.losses += away and not self.is_away
        self.is_away = away

    def takes(self, count: int) -> int:
        return 0 if self.is_away else count if self.most is None else min(count, self.most)

    def carry(self, frames: list[CanFrame], now_ns: int) -> list[CanFrame]:
        """The frames that arrive."""
        if self.is_away:
            return []
        if not self.loss and not self.corruption:
            return frames
        arrived = []
        for identifier, data in frames:
            chance = self._random.random()
            if chance < self.loss:
                continue
            if chance < self.loss + self.corruption:
                arrived.append((identifier, self._damage(identifier, data, now_ns)))
            else:
                arrived.append((identifier, data))
        return arrived

    def _damage(self, identifier: int, data: bytes, now_ns: int) -> bytes:
        flipped = bytearray(data)
        for bit in self._random.sample(range(64), self._random.choice((1, 1, 1, 2))):
            flipped[bit // 8] ^= 1 << bit % 8
        if checksum(bytes(flipped)) != flipped[7]:
            times = self._damaged_ns.setdefault(identifier, deque(maxlen=CHECKSUM_FAULTS))
            times.append(now_ns)
            if len(times) == CHECKSUM_FAULTS and now_ns - times[0] <= 1_000_000_000:
                self.failed_ns = now_ns
        elif identifier == BODY or (identifier & 0xFF == 0xD0 and flipped[0] != data[0]):
            self.passed_ns = now_ns
        return bytes(flipped)


class Rig:
    """All together, tick by tick; ``guards`` has the newest gateway's last, after those of dead gateways."""

    def __init__(
        self, plant: Plant, gateway: Gateway, operator: Operator, bus: Bus, judge: Oracle, guard: Guard | None
    ) -> None:
        self.plant, self.gateway, self.operator, self.bus = plant, gateway, operator, bus
        self.guards = [] if guard is None else [guard]
        self.judge = judge
        self.hangs = self.dead = False
        self.now_ns = 0
        self.link_ns = 0
        self._hung_ns = 0
        self._up: deque[tuple[int, str, Fields]] = deque()
        self._down: deque[tuple[int, str, Fields]] = deque()
        self._waiting: list[CanFrame] = []

    @property
    def now_s(self) -> float:
        return self.now_ns / 1e9

    def tick(self) -> None:
        for _ in range(TICK_NS // STEP_NS):
            self.now_ns += STEP_NS
            frames = self.bus.carry(self.plant.step(), self.now_ns)
            self._waiting += frames
            self.judge.hears(frames, self.now_s)
            self._let_hear(frames)
            if self.now_ns % TICK_NS == 0:
                self.judge.motion(self.plant, self.now_s, gateway_lives=not self.hangs and not self.dead)
                self._operate()
                self._run_gateway()
            for guard in self.guards:
                lives = guard is self.guards[-1] and not self.dead
                self._send(guard.tick(self.now_ns, self.bus, parent_lives=lives), guard)

    def succeed(self, gateway: Gateway, guard: Guard) -> None:
        """Another gateway begins in place of the dead one, whose guard may still be stopping the robot."""
        self.gateway, self.dead, self.hangs = gateway, False, False
        self.guards.append(guard)
        self._hung_ns, self._waiting = 0, []
        self._up.clear()

    def ask(self, verb: str) -> None:
        """Somebody else sends a request that needs no lease."""
        self._up.append((self.now_ns, verb, {}))

    def _operate(self) -> None:
        now_ns = self.now_ns
        while self._down and self._down[0][0] <= now_ns:
            _, verb, fields = self._down.popleft()
            if verb:
                self.operator.receive_reply(verb, fields, self.now_s)
            else:
                self.operator.seen = fields
        if now_ns % (2 * TICK_NS) == 0:
            self._up += ((now_ns + self.link_ns, verb, fields) for verb, fields in self.operator.act(self.now_s))

    def _run_gateway(self) -> None:
        if self.hangs or self.dead:
            self._hung_ns += TICK_NS
            return
        late_ns, self._hung_ns = self._hung_ns, 0
        now_ns, waiting = self.now_ns, self._waiting
        self._waiting = []
        self.gateway.receive(waiting, now_ns)
        while self._up and self._up[0][0] <= now_ns:
            _, verb, fields = self._up.popleft()
            self.gateway.ask(verb, fields)
            self.judge.requests(verb, fields, self.now_s)
        view = self.guards[-1].view(now_ns) if self.guards else GuardView(is_watching=True)
        before = self.gateway.state
        former_sends = any(guard.is_sending for guard in self.guards[:-1])
        frames = self.gateway.tick(now_ns, late_ns, view, self.bus, former_sends=former_sends)
        for verb, reply in self.gateway.replies:
            self._down.append((now_ns + self.link_ns, verb, reply))
            self.judge.reply(verb, reply, self.now_s)
        if self.gateway.state is not before:
            self._down.append((now_ns + self.link_ns, "", self.gateway.state))
            self.judge.state(self.gateway.state, self.now_s)
        self._send(frames)
        if self.guards:
            self.guards[-1].told(self.gateway, now_ns)

    def _let_hear(self, frames: list[CanFrame], sender: Guard | None = None) -> None:
        for guard in self.guards:
            if guard is not sender:
                guard.hear(frames, self.now_ns)

    def _send(self, frames: list[CanFrame], guard: Guard | None = None) -> None:
        taken = self.bus.takes(len(frames))
        if guard is None or frames:
            self.judge.frames(frames, self.now_s, taken=taken, by_guard=guard is not None)
        if not taken:
            return
        arrived = self.bus.carry(frames[:taken], self.now_ns)
        for identifier, data in arrived:
            self.plant.receive(identifier, data)
        if guard is not None:
            self._waiting += arrived
        self._let_hear(arrived, guard)

"""The one thread, with a fake clock, a fake bus and a fake Zenoh: a busy machine makes no tick late."""

import gc
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import cast

import msgspec
import pytest

from gateway import loop as loop_module
from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder
from gateway.choice import CHASSIS
from gateway.command.flow import CommandFlow, PendingReply, TickEffects
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.guard.stopper import GuardView
from gateway.loop import BURST_MAX_FRAMES, SELDOM_TICKS, LoopPorts, run
from gateway.sim.model import VirtualChassis
from schemas import codec
from schemas.codec import Sample
from schemas.decisions import SafetyState
from schemas.messages import GatewayHealth, Message, RobotState, Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import ChassisSettings, CommandSettings, Settings
from schemas.subjects import BY_NAME
from tests.support.frames import MS, Feedback
from tests.support.waiting import DEADLINE_S, StopWhen


class Clock:
    """Time that passes where somebody waits for it. It stands in for the module ``time``."""

    def __init__(self) -> None:
        self.now_ns = 1_000_000_000

    def monotonic_ns(self) -> int:
        return self.now_ns

    def time_ns(self) -> int:
        return self.now_ns + 1_700_000_000_000_000_000

    def process_time_ns(self) -> int:
        return self.now_ns // 10

    def sleep(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)


clock = Clock()


@pytest.fixture(autouse=True)
def _fake_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_module, "time", clock)
    # Each loop collects garbage once: not in what all the other tests hold.
    gc.freeze()


FRAME_S = 20e-6
"""Reading a frame from a busy bus takes so long."""


class FakeBus:
    """A bus that is up or not, and holds frames."""

    def __init__(self, frames: list[Frame]) -> None:
        self.frames = frames
        self.is_up = True
        self.detail = ""
        self.losses = 0
        self.drops = 0
        self.sent: list[Frame] = []

    def receive(self, timeout_s: float) -> Frame | None:
        if self.frames and self.is_up:
            return self.frames.pop(0)
        clock.sleep(timeout_s)
        return None

    def send(self, frames: list[Frame]) -> int:
        self.sent += frames
        return len(frames)


class FakeZenoh:
    """Keeps what is published; fails when told to."""

    def __init__(self) -> None:
        self.failures = 0
        self.samples: list[Sample] = []
        self.answered = 0
        self.connected = 3
        self.asked = 0

    def publish(self, sample: Sample) -> None:
        self.samples.append(sample)

    def outside(self) -> tuple[str, ...]:
        return ()

    def peers(self) -> int:
        self.asked += 1
        return self.connected

    def answer(self, reply: Callable[[], bytes]) -> None:
        if reply() == b"info":
            self.answered += 1

    def of(self, subject: str) -> list[Message | codec.PayloadFault]:
        return [codec.decode(BY_NAME[subject], s.payload) for s in self.samples if s.subject == subject]


def core() -> Core:
    """A core of a known variant."""
    command = CommandSettings(speed_limit_mps=2.222)
    return Core(
        CHASSIS, Settings(chassis=ChassisSettings(variant="coarse"), command=command), "0", clock.monotonic_ns()
    )


def test_frames_come_out_as_samples_and_ticks_go_on() -> None:
    """Every frame is published, state and health come by time, queries are answered each tick."""
    feedback = Feedback(Variant.COARSE)
    bus, zenoh = FakeBus([frame for _ in range(20) for frame in feedback.all()]), FakeZenoh()
    run(LoopPorts(bus, zenoh), core(), lambda: b"info", lambda: bool(zenoh.of("gateway/health")))
    chassis = [sample.subject for sample in zenoh.samples if sample.subject.startswith("chassis/")]
    assert len(chassis) - chassis.count("chassis/odometry") == 200
    health = zenoh.of("gateway/health")[0]
    assert isinstance(health, GatewayHealth)
    assert (health.frames, health.zenoh_peers, health.bus_up) == (200, 3, True)
    assert zenoh.answered > 1
    assert len(zenoh.of("state")) > 1


def test_the_service_manager_is_fed_by_each_tenth_round_that_was_done() -> None:
    """A loop that stands still feeds nothing."""
    fed: list[tuple[int, str]] = []

    class FakeManager:
        def alive(self, status: str) -> None:
            fed.append((clock.now_ns, status))

    class StallingBus(FakeBus):
        """Holds the loop once, for a second."""

        def receive(self, timeout_s: float) -> Frame | None:
            clock.sleep(1.0 if len(fed) == 3 and fed[-1][0] > clock.now_ns - 20 * MS else timeout_s)
            return None

    bus = StallingBus([])
    run(LoopPorts(bus, FakeZenoh(), manager=FakeManager()), core(), lambda: b"", lambda: len(fed) >= 5)
    pauses_ms = [(after[0] - before[0]) / MS for before, after in pairwise(fed[:5])]
    assert pauses_ms[:2] == [100, 100]
    assert pauses_ms[2] > 1000
    assert fed[0][1] == "standby, bus up, not guarded"


def test_a_lost_bus_ends_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """The ticks go on, the state says that the bus is down, the log says so once."""
    bus, zenoh = FakeBus([]), FakeZenoh()

    def stopped() -> bool:
        states = zenoh.of("state")
        if len(states) == 2 and bus.is_up:
            bus.is_up, bus.detail, bus.losses = False, "Network is down", 1
        return len(states) >= 6

    with caplog.at_level(logging.INFO):
        run(LoopPorts(bus, zenoh), core(), lambda: b"", stopped)
    states = [state for state in zenoh.of("state") if isinstance(state, RobotState)]
    assert [state.bus_up for state in states[:2]] == [True, True]
    assert states[-1].bus_up is False
    assert [record.getMessage() for record in caplog.records] == [
        "the bus is up",
        "a Zenoh node is connected",
        "the bus is lost: Network is down; trying again",
        "the gateway ends, as it was told to",
    ]


def test_a_bus_that_is_lost_at_its_first_read_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    """It was never seen to be up."""
    bus = FakeBus([])
    bus.is_up, bus.detail, bus.losses = False, "Input/output error", 1
    zenoh = FakeZenoh()
    with caplog.at_level(logging.INFO):
        run(LoopPorts(bus, zenoh), core(), lambda: b"", lambda: len(zenoh.of("state")) >= 2)
    assert caplog.records[0].getMessage() == "the bus is lost: Input/output error; trying again"


def test_a_lost_zenoh_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    """When the last node goes the log says so, once; the ticks go on."""
    zenoh = FakeZenoh()

    def go() -> None:
        zenoh.connected = 0 if zenoh.samples else 1

    asked_enough = StopWhen(lambda: zenoh.asked >= 4, go)
    with caplog.at_level(logging.INFO):
        run(LoopPorts(FakeBus([]), zenoh), core(), lambda: b"", asked_enough)
    assert [record.getMessage() for record in caplog.records][1:] == [
        "a Zenoh node is connected",
        "no Zenoh node is connected any more",
        "the gateway ends, as it was told to",
    ]


def test_a_loop_that_stood_still_says_so(caplog: pytest.LogCaptureFixture) -> None:
    """A stall is in the log, and stays in health as the worst lateness since the start."""
    zenoh, stalls = FakeZenoh(), [0.12]

    class StallingBus(FakeBus):
        """Holds the loop once."""

        def receive(self, timeout_s: float) -> Frame | None:
            clock.sleep(stalls.pop() if stalls else timeout_s)
            return None

    with caplog.at_level(logging.INFO):
        run(LoopPorts(StallingBus([]), zenoh), core(), lambda: b"", lambda: len(zenoh.of("gateway/health")) == 2)
    assert any("ms late" in record.getMessage() for record in caplog.records)
    first, second = zenoh.of("gateway/health")
    assert isinstance(first, GatewayHealth)
    assert isinstance(second, GatewayHealth)
    assert first.tick_lateness_worst_ms > 100
    assert second.tick_lateness_worst_ms >= first.tick_lateness_worst_ms


def test_a_bus_that_is_never_empty_does_not_keep_the_tick_waiting() -> None:
    """Frames are taken a bounded number at a time, also where there is always one more."""
    frame = next(Feedback(Variant.COARSE).all())
    longest = 0

    class BusyBus(FakeBus):
        """Always has a frame; counts how many are taken one after the other without looking at the time."""

        taken = 0

        def receive(self, timeout_s: float) -> Frame | None:
            nonlocal longest
            self.taken = 1 if timeout_s else self.taken + 1
            longest = max(longest, self.taken)
            assert self.taken <= 100 * BURST_MAX_FRAMES, "the loop forgets its tick"
            clock.sleep(FRAME_S)
            return frame

    zenoh = FakeZenoh()
    run(LoopPorts(BusyBus([]), zenoh), core(), lambda: b"info", StopWhen(lambda: zenoh.answered >= 3))
    assert longest == BURST_MAX_FRAMES


def test_a_bus_that_is_never_read_to_its_end_shows_old_things() -> None:
    """Frames that come faster than they are read are old when they are read: it is a cause to stop."""
    frame = next(Feedback(Variant.COARSE).all())

    class BusyBus(FakeBus):
        """Always has a frame."""

        def receive(self, timeout_s: float) -> Frame | None:
            del timeout_s
            clock.sleep(FRAME_S)
            return frame

    def is_behind(bus: FakeBus) -> bool:
        made, zenoh = core(), FakeZenoh()
        run(LoopPorts(bus, zenoh), made, lambda: b"info", StopWhen(lambda: zenoh.answered >= 40))
        assert made.command is not None
        return made.command.arbiter.monitor.chassis.is_behind

    assert is_behind(BusyBus([]))
    assert not is_behind(FakeBus([]))


def test_after_a_pause_the_bus_is_read_before_anything_is_decided() -> None:
    """What was seen before the pause is old."""
    frames = list(Feedback(Variant.COARSE).all())
    stalls = [0.15]

    class StallingBus(FakeBus):
        """Holds the loop once, and has frames then."""

        def receive(self, timeout_s: float) -> Frame | None:
            if stalls:
                clock.sleep(stalls.pop())
                return None
            return super().receive(timeout_s)

    made, zenoh, seen = core(), FakeZenoh(), list[tuple[int, int]]()
    bus = StallingBus(frames)
    tick = made.tick

    def spied(now_ns: int, wall_ns: int, late_ns: int, challenge: bytes) -> TickEffects:
        seen.append((late_ns, len(bus.frames)))
        return tick(now_ns, wall_ns, late_ns, challenge)

    made.tick = spied  # type: ignore[method-assign]
    run(LoopPorts(bus, zenoh), made, lambda: b"info", StopWhen(lambda: zenoh.answered >= 3))
    late_ns, waiting = seen[0]
    assert late_ns > 100_000_000
    assert waiting == 0


def test_zenoh_is_asked_who_is_there_in_every_tenth_tick() -> None:
    """The answer costs more than it changes; between two questions the last one holds."""
    zenoh = FakeZenoh()
    run(
        LoopPorts(FakeBus([]), zenoh),
        core(),
        lambda: b"info",
        StopWhen(lambda: zenoh.answered == 3 * SELDOM_TICKS - 1),  # One more tick says that it ends.
    )
    assert zenoh.asked == 3


def test_the_garbage_collector_is_given_back() -> None:
    """No collection runs in the loop, and everything is as before after it."""
    seen: list[bool] = []

    def stopped() -> bool:
        seen.append(gc.isenabled())
        return len(seen) > 2

    run(LoopPorts(FakeBus([]), FakeZenoh()), core(), lambda: b"", stopped)
    assert not any(seen)
    assert gc.isenabled()


class Chassis(FakeBus):
    """The simulated chassis at the other end of the bus, in real time; it takes frames as told."""

    def __init__(self, order: list[str]) -> None:
        super().__init__([])
        self.order = order
        self.takes = 100
        self._chassis = VirtualChassis(CHASSIS, Variant.COARSE, clock.monotonic_ns())

    def receive(self, timeout_s: float) -> Frame | None:
        self.frames += self._chassis.advance(clock.monotonic_ns(), clock.time_ns())
        return super().receive(timeout_s)

    def send(self, frames: list[Frame]) -> int:
        self.order.append("frames")
        taken = frames[: self.takes]
        for frame in taken:
            self._chassis.receive(frame, clock.monotonic_ns())
        return super().send(taken)


class FakeInbox:
    """Requests that are put in by hand, and the replies to them."""

    def __init__(self, order: list[str]) -> None:
        self.order = order
        self.drops = 0
        self.waiting: list[RawRequest] = []
        self.replies: dict[int, dict[str, object]] = {}
        self.holders: list[tuple[str, int, int]] = []

    def ask(self, verb: str, **fields: object) -> int:
        handle = len(self.replies) + len(self.waiting) + 1
        payload = msgspec.msgpack.encode(fields)
        self.waiting.append(RawRequest(handle, verb, "first", payload, len(payload)))
        return handle

    def drain(self, holder: str, lease: int, after: int) -> list[RawRequest]:
        self.order.append("tick")
        self.holders.append((holder, lease, after))
        waiting, self.waiting = self.waiting, []
        return waiting

    def statements(self) -> list[RawRequest]:
        return []

    def reply(self, reply: PendingReply) -> None:
        self.order.append("reply")
        self.replies[reply.handle] = msgspec.msgpack.decode(reply.payload)


class FakeGuard:
    """A guard that watches or not, and counts the beats."""

    def __init__(self, order: list[str]) -> None:
        self.order = order
        self.is_watching = True
        self.is_sending = False
        self.stops = 0
        self.says = ""
        self.beats_ns: list[int] = []

    def look(self) -> GuardView:
        return GuardView(self.is_watching, self.is_sending, self.stops, self.says)

    def beat(self, now_ns: int, command: CommandFlow) -> None:
        assert isinstance(command, CommandFlow)
        self.order.append("beat")
        self.beats_ns.append(now_ns)


class FakeNote:
    """Remembers what it was told of the latch."""

    def __init__(self) -> None:
        self.latched: list[bool] = []

    def follow(self, *, is_latched: bool) -> None:
        if [is_latched] != self.latched[-1:]:
            self.latched.append(is_latched)


class FakeMileageNote:
    """Asks once about the first mileage that it gets."""

    def __init__(self) -> None:
        self.asked: list[float] = []

    def follow(self, mileage_km: float | None) -> str:
        if mileage_km is None or self.asked:
            return ""
        self.asked.append(mileage_km)
        return "is this the same chassis?"


class FakeLatchNote:
    """Says when something else is latched than before, and once that it cannot be written, if that is so."""

    def __init__(self, order: list[str]) -> None:
        self.order = order
        self.latched: dict[Reason, str] = {}
        self.fault = ""

    def follow(self, latched: Mapping[Reason, str]) -> str:
        if latched != self.latched:
            self.order.append("note")
            self.latched = dict(latched)
        fault, self.fault = self.fault, ""
        return fault


class OrderedZenoh(FakeZenoh):
    """Zenoh that says when it is used."""

    def __init__(self, order: list[str]) -> None:
        super().__init__()
        self.order = order

    def publish(self, sample: Sample) -> None:
        # Feedback is published as it comes, between the ticks.
        if not sample.subject.startswith("chassis/"):
            self.order.append("decision" if sample.subject == "safety/decision" else "sample")
        super().publish(sample)


class FakeFormerGuard:
    is_stopping = False
    says = ""


class Commanded:
    """A loop with everything around it, and a script: called each tick, it ends the loop by returning."""

    def __init__(self) -> None:
        self.order: list[str] = []
        self.bus = Chassis(self.order)
        self.zenoh = OrderedZenoh(self.order)
        self.inbox = FakeInbox(self.order)
        self.guard = FakeGuard(self.order)
        self.note = FakeNote()
        self.latch_note = FakeLatchNote(self.order)
        self.mileage_note = FakeMileageNote()
        self.former_guard = FakeFormerGuard()
        self.is_realtime = True
        self.core = core()

    def run(self, script: Callable[["Commanded"], Iterator[bool]]) -> None:
        """Each ``yield`` of the script waits until what it says is true."""
        steps = script(self)
        deadline_s = time.monotonic() + DEADLINE_S

        def stopped() -> bool:
            assert time.monotonic() < deadline_s, "the script came no further"
            return next(steps, None) is None

        ports = LoopPorts(
            self.bus,
            self.zenoh,
            self.inbox,
            self.guard,
            self.note,
            self.former_guard,
            has_realtime=lambda: self.is_realtime,
            latch_note=self.latch_note,
            mileage_note=self.mileage_note,
        )
        run(ports, self.core, lambda: b"", stopped)

    def engage(self) -> Iterator[bool]:
        """First takes the lease and engages."""
        while self.core.variant is Variant.UNKNOWN or self.says("blocked_by") != ["no_lease", "not_engaged"]:
            yield False
        handle = self.inbox.ask("acquire")
        while handle not in self.inbox.replies:
            yield False
        lease, challenge = self.inbox.replies[handle]["lease"], self.says("challenge")
        handle = self.inbox.ask("engage", lease=lease, challenge=challenge)
        while handle not in self.inbox.replies:
            yield False
        assert self.inbox.replies[handle]["ok"], self.inbox.replies

    def says(self, field: str) -> object:
        said = [sample for sample in self.zenoh.samples if sample.subject == "safety/state"]
        return msgspec.msgpack.decode(said[-1].payload)[field] if said else None

    def event_texts(self) -> list[str]:
        events = [sample.payload for sample in self.zenoh.samples if sample.subject == "safety/event"]
        return [msgspec.msgpack.decode(event)["text"] for event in events]

    def health(self) -> Iterator[bool]:
        while not self.zenoh.of("gateway/health"):
            yield False

    def ticks(self) -> list[list[str]]:
        """What was done in each tick, in its order."""
        ticks: list[list[str]] = []
        for word in self.order:
            if word == "tick":
                ticks.append([])
            else:
                ticks[-1].append(word)
        return ticks


def test_the_number_of_a_lease_is_in_the_replies_to_its_holder_alone() -> None:
    """Not in what is published, the journal with its requests included; and what is published is no number."""
    commanded = Commanded()
    numbers: list[int] = []
    refused: list[object] = []

    def script(one: Commanded) -> Iterator[bool]:
        yield from one.engage()
        numbers.append(one.core.command.arbiter.leases.held.id)  # type: ignore[union-attr]
        numbers.extend(reply["lease"] for reply in one.inbox.replies.values() if "lease" in reply)  # type: ignore[misc]
        handles = [one.inbox.ask("renew", lease=number) for number in numbers]
        while not set(handles) <= one.inbox.replies.keys():
            yield False
        refused.extend(one.inbox.replies[handle]["reason"] for handle in handles)

    commanded.run(script)
    public, secret = numbers
    assert refused == ["no_lease", "none"]
    assert public != secret
    forms = secret.to_bytes(7, "big"), str(secret).encode()
    assert not [one.subject for one in commanded.zenoh.samples if any(form in one.payload for form in forms)]
    decisions = [one.payload for one in commanded.zenoh.samples if one.subject == "safety/decision"]
    assert {msgspec.msgpack.decode(payload)["lease"] for payload in decisions} == {public, 0}


def test_frames_go_out_before_anything_else_and_decisions_last() -> None:
    """In a tick: the frames, the beat, the replies, the samples, and then what was decided."""
    commanded = Commanded()
    commanded.run(Commanded.engage)
    rank = {"frames": 0, "beat": 1, "reply": 2, "sample": 3, "decision": 4}
    engaging = 0
    for done in commanded.ticks()[:-1]:
        assert done == sorted(done, key=rank.__getitem__)
        engaging += done[:2] == ["frames", "beat"] and "reply" in done
    assert engaging == 1, "the reply to engage comes in a tick with frames"


def test_what_is_latched_is_on_its_way_to_the_disk_before_anybody_is_told() -> None:
    """In the tick of the stop: somebody goes up to the robot on the word of the reply."""
    commanded = Commanded()

    def script(one: Commanded) -> Iterator[bool]:
        yield from one.engage()
        handle = one.inbox.ask("stop")
        while handle not in one.inbox.replies:
            yield False

    commanded.run(script)
    [stopped] = [done for done in commanded.ticks() if "note" in done]
    assert stopped[:4] == ["frames", "beat", "note", "reply"]


def test_a_note_that_cannot_be_written_is_an_event() -> None:
    """Who stops the robot hears that a restart would forget it."""
    commanded = Commanded()
    commanded.latch_note.fault = "a restart would forget what is latched"

    def script(one: Commanded) -> Iterator[bool]:
        while not one.event_texts():
            yield False

    commanded.run(script)
    assert commanded.event_texts()[0] == "a restart would forget what is latched"


def test_the_loop_ends_when_the_robot_is_at_rest_and_not_before() -> None:
    """Told to end while engaged it goes through the whole stop: parked, disabled, silent."""
    commanded = Commanded()
    ended: list[int] = []

    def script(one: Commanded) -> Iterator[bool]:
        yield from one.engage()
        ended.append(len(one.bus.sent))

    commanded.run(script)
    assert commanded.core.is_at_rest
    stop = commanded.bus.sent[ended[0] :]
    parking = load(Variant.COARSE).messages["Auto_ParkingCmd"].can_id
    enabled = [frame.data[0] & 1 for frame in stop if frame.can_id == parking]
    assert enabled == sorted(enabled, reverse=True), "first enabled, then disabled"
    assert enabled.count(1) >= 100, "held for 1 s"
    assert enabled.count(0) >= 45, "disabled for 0.5 s"
    assert commanded.says("stop_reason") == "shutdown"


def test_an_end_that_never_comes_to_rest_is_an_end_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bus that takes nothing any more must not keep the process for ever."""
    monkeypatch.setattr(loop_module, "REST_TIMEOUT_NS", 300 * MS)
    commanded = Commanded()

    def script(one: Commanded) -> Iterator[bool]:
        yield from one.engage()
        one.bus.takes = 0

    commanded.run(script)
    assert not commanded.core.is_at_rest


def test_a_bus_that_takes_nothing_is_a_stop() -> None:
    """After five ticks; the ticks, the beats and the samples go on meanwhile, and the counters do not."""
    commanded = Commanded()

    def script(one: Commanded) -> Iterator[bool]:
        yield from one.engage()
        sent, beats = list(one.bus.sent), len(one.guard.beats_ns)
        one.bus.takes = 0
        while one.says("state") != "stopping":
            yield False
        assert one.says("stop_reason") == "send_failed"
        assert one.bus.sent == sent
        assert len(one.guard.beats_ns) - beats >= 5
        one.bus.takes = 100
        while len(one.bus.sent) < len(sent) + 5:
            yield False
        before, after = sent[-5:], one.bus.sent[len(sent) : len(sent) + 5]
        for old, new in zip(before, after, strict=True):
            assert new.data[6] >> 4 == ((old.data[6] >> 4) + 1) % 16

    commanded.run(script)


def test_a_full_collection_while_driving_is_a_late_loop() -> None:
    """Row 'loop late: over 100 ms: stop'. The loop itself runs none; this one is forced, over a large heap."""
    commanded = Commanded()
    collections: list[str] = []

    def note(phase: str, _info: object) -> None:
        collections.append(phase)

    def script(one: Commanded) -> Iterator[bool]:
        yield from one.engage()
        assert collections.count("start") == 1, "the one before the loop"
        heap = [[number] for number in range(300_000)]
        begun_ns = time.monotonic_ns()
        while time.monotonic_ns() - begun_ns < 120 * MS:
            gc.collect()
        clock.sleep((time.monotonic_ns() - begun_ns) / 1e9)
        assert len(heap) == 300_000
        yield False
        while one.says("state") != "stopping":
            yield False
        assert one.says("stop_reason") == "loop_late"

    gc.callbacks.append(note)
    try:
        commanded.run(script)
    finally:
        gc.callbacks.remove(note)


def test_no_challenge_is_ever_published_twice() -> None:
    """Row 'command age, by echo': each is random, in two runs of the same number too."""

    def published() -> list[bytes]:
        zenoh = FakeZenoh()
        run(LoopPorts(FakeBus([]), zenoh), core(), lambda: b"info", StopWhen(lambda: zenoh.answered >= 30))
        return [state.challenge for state in zenoh.of("safety/state") if isinstance(state, SafetyState)]

    challenges = published() + published()
    assert len(challenges) >= 8
    assert len(set(challenges)) == len(challenges)
    assert len({byte for challenge in challenges for byte in challenge}) > 30, "every byte of them varies"


def test_the_guard_hears_each_tick() -> None:
    """One beat a tick, whether anything is sent or not, in the order of time; and a last one of who is at rest."""
    commanded = Commanded()
    commanded.run(Commanded.engage)
    *ticks, last = commanded.ticks()
    assert all(done.count("beat") == 1 for done in ticks)
    assert last.count("beat") == 2
    assert commanded.guard.beats_ns == sorted(commanded.guard.beats_ns)


def test_what_the_guard_does_reaches_the_arbiter() -> None:
    """It does not watch: nobody engages. It sends: that is latched."""
    commanded = Commanded()

    def script(one: Commanded) -> Iterator[bool]:
        one.guard.is_watching = False
        while "unguarded" not in (one.says("blocked_by") or []):  # type: ignore[operator]
            yield False
        one.guard.is_watching, one.guard.is_sending = True, True
        while one.says("latched") != ["guard"]:
            yield False

    commanded.run(script)


def test_a_stop_by_the_guard_is_noted_until_it_is_reset() -> None:
    """Row 'the guard has stopped the robot: latched, also across a restart': each tick, latched or not."""
    commanded = Commanded()

    def script(one: Commanded) -> Iterator[bool]:
        while one.says("blocked_by") != ["no_lease", "not_engaged"]:
            yield False
        one.guard.stops, one.guard.says = 1, "the gateway is gone; the robot stands"
        while one.says("latched") != ["guard"]:
            yield False
        handle = one.inbox.ask("acquire")
        while handle not in one.inbox.replies:
            yield False
        lease = one.inbox.replies[handle]["lease"]
        while one.says("latched"):
            if not one.inbox.waiting:
                one.inbox.ask("reset", lease=lease)
            yield False

    commanded.run(script)
    assert commanded.note.latched == [False, True, False]
    assert any(text.endswith(commanded.guard.says) for text in commanded.event_texts())


@pytest.mark.parametrize("is_stopping", [True, False])
def test_the_guard_of_a_dead_gateway_is_no_other_computer(*, is_stopping: bool) -> None:
    """Its frames are known for as long as it has not said that it is done; then its words are an event."""
    commanded = Commanded()
    commanded.former_guard.is_stopping = is_stopping
    encoder = Encoder(load(Variant.COARSE))

    def script(one: Commanded) -> Iterator[bool]:
        expected = "guard" if is_stopping else "other_commander"
        counter = 0
        while expected not in blocked(one):
            one.core.receive_frame(encoder.encode("Auto_DriveCmd", {}, counter), clock.now_ns)
            counter = (counter + 1) % 16
            yield False
        assert {"guard", "other_commander"} - blocked(one) == {"guard", "other_commander"} - {expected}
        one.former_guard.is_stopping, one.former_guard.says = False, "the robot stands; 180 frames sent"
        while blocked(one) & {"guard", "other_commander"} - set(cast("list[str]", one.says("latched"))):
            yield False

    commanded.run(script)
    texts = commanded.event_texts()
    assert "the guard's stop has ended: the robot stands; 180 frames sent" in texts
    assert (TEXTS[Reason.OTHER_COMMANDER].means in texts) is not is_stopping


def test_another_mileage_than_before_is_an_event_and_bars_nothing() -> None:
    """Row 'the name and the chassis': the question is asked, once, and the robot can be engaged."""
    commanded = Commanded()
    commanded.run(lambda one: one.engage())
    assert len(commanded.mileage_note.asked) == 1
    assert commanded.event_texts().count("is this the same chassis?") == 1


def blocked(one: Commanded) -> set[str]:
    """Why the robot stands still."""
    return set(cast("list[str]", one.says("blocked_by") or []))


def test_a_former_guard_whose_frames_do_not_come_is_not_waited_for() -> None:
    """It may be dead as well: the gateway looks for itself, and is engaged."""
    commanded = Commanded()
    commanded.former_guard.is_stopping = True
    commanded.run(Commanded.engage)


def test_real_time_priority_is_in_health_and_sets_the_speed_limit() -> None:
    """Row 'a gateway without real-time priority': it is looked at in the run too, for it can be taken away."""
    commanded = Commanded()

    def script(one: Commanded) -> Iterator[bool]:
        yield from one.engage()
        assert one.says("speed_limit_mps") == 2.222
        one.is_realtime = False
        while one.says("speed_limit_mps") != 1.0:
            yield False
        yield from one.health()

    commanded.run(script)
    health = commanded.zenoh.of("gateway/health")[-1]
    assert isinstance(health, GatewayHealth)
    assert not health.realtime


def test_a_guard_that_acted_during_the_tick_is_noticed_before_anything_is_sent() -> None:
    """This process stood still between looking and sending, for longer than a stop of the guard's lasts."""
    commanded = Commanded()

    def script(one: Commanded) -> Iterator[bool]:
        yield from one.engage()
        drain = one.inbox.drain

        def drain_late(holder: str, lease: int, after: int) -> list[RawRequest]:
            one.guard.stops = 1
            return drain(holder, lease, after)

        sent = len(one.bus.sent)
        one.inbox.drain = drain_late  # type: ignore[method-assign]
        yield False
        assert len(one.bus.sent) == sent
        while one.says("latched") != ["guard"]:
            yield False

    commanded.run(script)


def test_the_inbox_is_told_who_holds_the_lease_and_its_drops_are_in_health() -> None:
    """So that the holder's requests go before others'."""
    commanded = Commanded()

    def script(one: Commanded) -> Iterator[bool]:
        one.inbox.drops = 17
        yield from one.engage()
        yield from one.health()

    commanded.run(script)
    holders = commanded.inbox.holders
    assert holders[0] == ("", 0, -1)
    lease = commanded.inbox.replies[1]["lease"]
    assert ("first", lease, -1) in holders
    health = commanded.zenoh.of("gateway/health")[0]
    assert isinstance(health, GatewayHealth)
    assert health.inbox_drops == 17

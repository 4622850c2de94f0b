"""The loop with a fake clock, a fake bus and a fake Zenoh, so that a busy machine makes no tick late."""

import gc
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from gateway import loop as loop_module
from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder
from gateway.choice.chassis import CHASSIS
from gateway.command.flow import CommandFlow, PendingReply, TickEffects
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.guard.stopper import GuardView
from gateway.loop import BURST_MAX_FRAMES, SELDOM_TICKS, LoopPorts, run
from gateway.sim.model import VirtualChassis
from schemas.codec import Sample
from schemas.messages import Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import ChassisSettings, CommandSettings, Settings
from tests.support.frames import MS, Feedback
from tests.support.waiting import DEADLINE_S, StopWhen


class Clock:
    """Replaces the module ``time``: time passes only in ``sleep``."""

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
"""Time to read a frame from a busy bus."""


class FakeBus:
    """A bus with frames, up or down; its first reads take as long as ``stalls`` says."""

    def __init__(self, frames: list[Frame], stalls: tuple[float, ...] = ()) -> None:
        self.frames = frames
        self.stalls = [*stalls]
        self.is_up = True
        self.detail = ""
        self.losses = 0
        self.drops = 0
        self.sent: list[Frame] = []

    def receive(self, timeout_s: float) -> Frame | None:
        if self.stalls:
            clock.sleep(self.stalls.pop())
        elif self.frames and self.is_up:
            return self.frames.pop(0)
        else:
            clock.sleep(timeout_s)
        return None

    def send(self, frames: list[Frame]) -> int:
        self.sent += frames
        return len(frames)


class BusyBus(FakeBus):
    """Always has a frame; counts the frames read without a look at the time."""

    taken = longest = 0

    def receive(self, timeout_s: float) -> Frame | None:
        self.taken = 1 if timeout_s else self.taken + 1
        self.longest = max(self.longest, self.taken)
        assert self.taken <= 100 * BURST_MAX_FRAMES, "the loop forgets its tick"
        clock.sleep(FRAME_S)
        return self.frames[0]


class FakeZenoh:
    """Stores the published samples, and records the order of calls."""

    def __init__(self, order: list[str] | None = None) -> None:
        self.order = [] if order is None else order
        self.failures = 0
        self.samples: list[Sample] = []
        self.answered = 0
        self.connected = 3
        self.asked = 0

    def publish(self, sample: Sample) -> None:
        # Feedback is published as it comes, between the ticks.
        if not sample.subject.startswith("chassis/"):
            self.order.append("decision" if sample.subject == "safety/decision" else "sample")
        self.samples.append(sample)

    def outside(self) -> tuple[str, ...]:
        return ()

    def peers(self) -> int:
        self.asked += 1
        return self.connected

    def answer(self, reply: Callable[[], bytes]) -> None:
        assert reply() == b"info"
        self.answered += 1

    def of(self, subject: str) -> list[dict[str, Any]]:
        return [msgspec.msgpack.decode(one.payload) for one in self.samples if one.subject == subject]


def core() -> Core:
    command = CommandSettings(speed_limit_mps=2.222)
    settings = Settings(chassis=ChassisSettings(variant="coarse"), command=command)
    return Core(CHASSIS, settings, "0", clock.monotonic_ns())


def loop(
    bus: FakeBus,
    zenoh: FakeZenoh,
    stopped: Callable[[], bool],
    made: Core | None = None,
    **ports: Any,  # noqa: ANN401 - any port
) -> None:
    run(LoopPorts(bus, zenoh, **ports), made or core(), lambda: b"info", stopped)


def test_frames_come_out_as_samples_and_ticks_go_on() -> None:
    """Every frame is published, state and health come by time, queries are answered each tick."""
    feedback = Feedback(Variant.COARSE)
    bus, zenoh = FakeBus([frame for _ in range(20) for frame in feedback.all()]), FakeZenoh()
    loop(bus, zenoh, lambda: bool(zenoh.of("gateway/health")))
    chassis = [sample.subject for sample in zenoh.samples if sample.subject.startswith("chassis/")]
    assert len(chassis) - chassis.count("chassis/odometry") == 200
    health = zenoh.of("gateway/health")[0]
    assert (health["frames"], health["zenoh_peers"], health["bus_up"]) == (200, 3, True)
    assert zenoh.answered > 1
    assert len(zenoh.of("state")) > 1


def test_the_service_manager_is_fed_by_each_tenth_round_that_was_done() -> None:
    fed: list[tuple[int, str]] = []
    bus = FakeBus([])

    def feed(status: str) -> None:
        fed.append((clock.now_ns, status))
        bus.stalls = [1.0] * (len(fed) == 3)

    loop(bus, FakeZenoh(), lambda: len(fed) >= 5, manager=feed)
    pauses_ms = [(after[0] - before[0]) / MS for before, after in pairwise(fed[:5])]
    assert pauses_ms[:2] == [100, 100]
    assert pauses_ms[2] > 1000
    assert fed[0][1] == "standby, bus up, not guarded"


def test_a_lost_bus_a_lost_zenoh_and_a_pause_end_nothing(caplog: pytest.LogCaptureFixture) -> None:
    """The ticks continue; the state shows the bus as down, and each is logged once."""
    bus, zenoh = FakeBus([]), FakeZenoh()

    def stopped() -> bool:
        states = len(zenoh.of("state"))
        if states == 2 and bus.is_up:
            bus.is_up, bus.detail, bus.losses = False, "Network is down", 1
            zenoh.connected, bus.stalls = 0, [0.12]
        return states >= 10

    with caplog.at_level(logging.INFO):
        loop(bus, zenoh, stopped)
    assert [state["bus_up"] for state in zenoh.of("state")][::9] == [True, False]
    said = sorted(record.getMessage().partition(":")[0] for record in caplog.records)
    assert said == [
        "a Zenoh node is connected",
        "no Zenoh node is connected any more",
        "shutting down",
        "the bus is lost",
        "the bus is up",
        "the loop was 110 ms late",
    ]


def test_a_bus_that_is_never_empty_does_not_keep_the_tick_waiting() -> None:
    """A bounded number is read at a time; an overload is a cause to stop."""
    for kind in (BusyBus, FakeBus):
        made, zenoh, bus = core(), FakeZenoh(), kind(list(Feedback(Variant.COARSE).all())[:1])
        loop(bus, zenoh, StopWhen(lambda zenoh=zenoh: zenoh.answered >= 40), made)  # type: ignore[misc]
        assert made.command is not None
        assert made.command.arbiter.monitor.chassis.is_behind is (kind is BusyBus)
        assert not isinstance(bus, BusyBus) or bus.longest == BURST_MAX_FRAMES


def test_after_a_pause_the_bus_is_read_before_anything_is_decided() -> None:
    made, zenoh, seen = core(), FakeZenoh(), list[tuple[int, int]]()
    bus, tick = FakeBus(list(Feedback(Variant.COARSE).all()), stalls=(0.15,)), made.tick

    def spied(now_ns: int, wall_ns: int, late_ns: int, challenge: bytes) -> TickEffects:
        seen.append((late_ns, len(bus.frames)))
        return tick(now_ns, wall_ns, late_ns, challenge)

    made.tick = spied  # type: ignore[method-assign]
    loop(bus, zenoh, StopWhen(lambda: zenoh.answered >= 3), made)
    late_ns, waiting = seen[0]
    assert late_ns > 100_000_000
    assert waiting == 0


def test_zenoh_is_asked_who_is_there_in_every_tenth_tick() -> None:
    """Between two questions the last answer holds. No garbage is collected."""
    zenoh, enabled = FakeZenoh(), set[bool]()

    def stopped() -> bool:
        enabled.add(gc.isenabled())
        return zenoh.answered == 3 * SELDOM_TICKS - 1  # One more tick says that it ends.

    loop(FakeBus([]), zenoh, stopped)
    assert (zenoh.asked, enabled, gc.isenabled()) == (3, {False}, True)


def test_no_challenge_is_ever_published_twice() -> None:
    """Row 'command age, by echo': each is random, in two runs of the same number too."""
    challenges: list[bytes] = []
    for _ in range(2):
        zenoh = FakeZenoh()
        loop(FakeBus([]), zenoh, StopWhen(lambda zenoh=zenoh: zenoh.answered >= 30))  # type: ignore[misc]
        challenges += [state["challenge"] for state in zenoh.of("safety/state")]
    assert len(challenges) >= 8
    assert len(set(challenges)) == len(challenges)
    assert len({byte for challenge in challenges for byte in challenge}) > 30, "every byte of them varies"


# With everything around it.


class Chassis(FakeBus):
    """The simulated chassis at the other end of the bus; ``takes``: frames that it accepts."""

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
        for frame in frames[: self.takes]:
            self._chassis.receive(frame, clock.monotonic_ns())
        return super().send(frames[: self.takes])


class FakeInbox:
    def __init__(self, order: list[str]) -> None:
        self.order = order
        self.drops = 0
        self.waiting: list[RawRequest] = []
        self.replies: dict[int, dict[str, Any]] = {}
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
    """A guard, present or of the previous gateway, that counts the beats."""

    def __init__(self, order: list[str]) -> None:
        self.order = order
        self.is_watching = True
        self.is_sending = self.is_stopping = False
        self.stops = 0
        self.says = ""
        self.beats_ns: list[int] = []

    def look(self) -> GuardView:
        return GuardView(self.is_watching, self.is_sending, self.stops, self.says)

    def beat(self, now_ns: int, command: CommandFlow) -> None:
        assert isinstance(command, CommandFlow)
        self.order.append("beat")
        self.beats_ns.append(now_ns)


class FakeNotes:
    """The notes of the guard's stop, of the latches, with a fault, and of the mileage."""

    def __init__(self, order: list[str]) -> None:
        self.order = order
        self.guard_latched: list[bool] = []
        self.latched: dict[Reason, str] = {}
        self.fault = ""
        self.mileages_km: list[float] = []

    def of_guard(self, *, is_latched: bool) -> None:
        if [is_latched] != self.guard_latched[-1:]:
            self.guard_latched.append(is_latched)

    def follow(self, latched: Mapping[Reason, str]) -> str:
        if latched != self.latched:
            self.order.append("note")
            self.latched = dict(latched)
        fault, self.fault = self.fault, ""
        return fault

    def of_mileage(self, mileage_km: float | None) -> str:
        if mileage_km is None or self.mileages_km:
            return ""
        self.mileages_km.append(mileage_km)
        return "is this the same chassis?"


Steps = Iterator[bool]


class Commanded:
    """A loop with everything around it, and a script: called each tick, it ends the loop by returning."""

    def __init__(self) -> None:
        self.order: list[str] = []
        self.bus = Chassis(self.order)
        self.zenoh = FakeZenoh(self.order)
        self.inbox = FakeInbox(self.order)
        self.guard = FakeGuard(self.order)
        self.notes = FakeNotes(self.order)
        self.former_guard = FakeGuard(self.order)
        self.is_realtime = True
        self.core = core()

    def run(self, script: Callable[["Commanded"], Steps]) -> "Commanded":
        """Each ``yield`` of the script waits one tick."""
        steps = script(self)
        deadline_s = time.monotonic() + DEADLINE_S

        def stopped() -> bool:
            assert time.monotonic() < deadline_s, "the script came no further"
            return next(steps, None) is None

        loop(
            self.bus,
            self.zenoh,
            stopped,
            self.core,
            inbox=self.inbox,
            guard=self.guard,
            note=SimpleNamespace(follow=self.notes.of_guard),
            former_guard=self.former_guard,
            has_realtime=lambda: self.is_realtime,
            latch_note=self.notes.follow,
            mileage_note=self.notes.of_mileage,
        )
        return self

    def until(self, holds: Callable[[], bool]) -> Steps:
        while not holds():
            yield False

    def asked(self, verb: str, **fields: object) -> Steps:
        handle = self.inbox.ask(verb, **fields)
        yield from self.until(lambda: handle in self.inbox.replies)

    def engage(self) -> Steps:
        yield from self.until(lambda: self.says("blocked_by") == ["no_lease", "not_engaged"])
        yield from self.asked("acquire")
        yield from self.asked("engage", lease=self.inbox.replies[1]["lease"], challenge=self.says("challenge"))
        assert self.inbox.replies[2]["ok"], self.inbox.replies

    def says(self, field: str) -> Any:  # noqa: ANN401 - of any field
        said = self.zenoh.of("safety/state")
        return said[-1][field] if said and self.core.variant is not Variant.UNKNOWN else ""

    def event_texts(self) -> list[str]:
        return [event["text"] for event in self.zenoh.of("safety/event")]

    def health(self) -> Steps:
        yield from self.until(lambda: bool(self.zenoh.of("gateway/health")))

    def ticks(self) -> list[list[str]]:
        """The calls of each tick, in order."""
        ticks: list[list[str]] = []
        for word in self.order:
            if word == "tick":
                ticks.append([])
            else:
                ticks[-1].append(word)
        return ticks


def test_the_number_of_a_lease_is_in_the_replies_to_its_holder_alone() -> None:
    """Not in published samples, the journal included; the published identifier is no number."""
    numbers: list[int] = []

    def script(one: Commanded) -> Steps:
        yield from one.engage()
        numbers.extend((one.core.lease_id, one.inbox.replies[1]["lease"]))
        for number in numbers:
            yield from one.asked("renew", lease=number)

    commanded = Commanded().run(script)
    public, secret = numbers
    assert [commanded.inbox.replies[handle]["reason"] for handle in (3, 4)] == ["no_lease", "none"]
    assert public != secret
    forms = secret.to_bytes(7, "big"), str(secret).encode()
    assert not [one.subject for one in commanded.zenoh.samples if any(form in one.payload for form in forms)]
    assert {decision["lease"] for decision in commanded.zenoh.of("safety/decision")} == {public, 0}
    # The inbox knows the holder, whose requests go first.
    assert commanded.inbox.holders[0] == ("", 0, -1)
    assert ("first", secret, -1) in commanded.inbox.holders


def test_frames_go_out_before_anything_else_and_decisions_last() -> None:
    """In a tick: frames, beat, replies, samples, decisions. One beat in every tick, and a last one at rest."""
    commanded = Commanded().run(Commanded.engage)
    rank = {"frames": 0, "beat": 1, "reply": 2, "sample": 3, "decision": 4}
    *ticks, last = commanded.ticks()
    engaging = 0
    for done in ticks:
        assert done == sorted(done, key=rank.__getitem__)
        assert done.count("beat") == 1
        engaging += done[:2] == ["frames", "beat"] and "reply" in done
    assert engaging == 1, "the reply to engage comes in a tick with frames"
    assert last.count("beat") == 2
    assert commanded.guard.beats_ns == sorted(commanded.guard.beats_ns)


def test_what_is_latched_is_on_its_way_to_the_disk_before_anybody_is_told() -> None:
    """In the tick of the stop, because a person may walk up to the robot after the reply."""

    def script(one: Commanded) -> Steps:
        yield from one.engage()
        yield from one.asked("stop")

    [stopped] = [done for done in Commanded().run(script).ticks() if "note" in done]
    assert stopped[:4] == ["frames", "beat", "note", "reply"]


def test_a_note_that_cannot_be_written_is_an_event() -> None:
    commanded = Commanded()
    commanded.notes.fault = "a restart would forget what is latched"
    commanded.run(lambda one: one.until(lambda: bool(one.event_texts())))
    assert commanded.event_texts()[0] == "a restart would forget what is latched"


def test_the_loop_ends_when_the_robot_is_at_rest_and_not_before() -> None:
    """A shutdown while engaged goes through the whole stop: parked, disabled, silent."""
    ended: list[int] = []

    def script(one: Commanded) -> Steps:
        yield from one.engage()
        ended.append(len(one.bus.sent))

    commanded = Commanded().run(script)
    assert commanded.core.is_at_rest
    parking = load(Variant.COARSE).messages["Auto_ParkingCmd"].can_id
    enabled = [frame.data[0] & 1 for frame in commanded.bus.sent[ended[0] :] if frame.can_id == parking]
    assert enabled == sorted(enabled, reverse=True), "first enabled, then disabled"
    assert enabled.count(1) >= 100, "held for 1 s"
    assert enabled.count(0) >= 45, "disabled for 0.5 s"
    assert commanded.says("stop_reason") == "shutdown"


def test_an_end_that_never_comes_to_rest_is_an_end_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bus that accepts nothing must not block the process forever; ticks and beats go on."""
    monkeypatch.setattr(loop_module, "REST_TIMEOUT_NS", 300 * MS)

    def script(one: Commanded) -> Steps:
        yield from one.engage()
        one.bus.takes, sent, beats = 0, len(one.bus.sent), len(one.guard.beats_ns)
        yield from one.until(lambda: one.says("state") == "stopping")
        assert one.says("stop_reason") == "send_failed"
        assert (len(one.bus.sent), len(one.guard.beats_ns) >= beats + 5) == (sent, True)

    assert not Commanded().run(script).core.is_at_rest


def test_what_the_guard_does_reaches_the_arbiter_and_is_noted_until_it_is_reset() -> None:
    """Row 'the guard has stopped the robot: latched, also across a restart': each tick, latched or not."""

    def script(one: Commanded) -> Steps:
        one.guard.is_watching = False
        yield from one.until(lambda: "unguarded" in one.says("blocked_by"))
        one.guard.is_watching, one.guard.is_sending = True, True
        yield from one.until(lambda: one.says("latched") == ["guard"])
        one.guard.is_sending, one.guard.stops, one.guard.says = False, 1, "it was late; the robot stands"
        yield from one.asked("acquire")
        while one.says("latched"):
            yield from one.asked("reset", lease=one.inbox.replies[1]["lease"])

    commanded = Commanded().run(script)
    assert commanded.notes.guard_latched == [False, True, False]
    assert any(text.endswith(commanded.guard.says) for text in commanded.event_texts())


@pytest.mark.parametrize("is_stopping", [True, False])
def test_the_guard_of_a_dead_gateway_is_no_other_computer(*, is_stopping: bool) -> None:
    """Until it reports its end the frames are its own; then its words are an event."""
    commanded = Commanded()
    commanded.former_guard.is_stopping = is_stopping
    encoder = Encoder(load(Variant.COARSE))
    expected = "guard" if is_stopping else "other_commander"

    def barred() -> set[str]:
        return set(commanded.says("blocked_by")) & {"guard", "other_commander"}

    def script(one: Commanded) -> Steps:
        counter = 0
        while expected not in barred():
            one.core.receive_frame(encoder.encode("Auto_DriveCmd", {}, counter), clock.now_ns)
            counter = (counter + 1) % 16
            yield False
        assert barred() == {expected}
        one.former_guard.is_stopping, one.former_guard.says = False, "the robot stands; 180 frames sent"
        yield from one.until(lambda: barred() <= set(one.says("latched")))

    texts = commanded.run(script).event_texts()
    assert "the guard's stop has ended: the robot stands; 180 frames sent" in texts
    assert (TEXTS[Reason.OTHER_COMMANDER].means in texts) is not is_stopping


def test_another_mileage_than_before_is_an_event_and_bars_nothing() -> None:
    """Row 'the name and the chassis': the question is asked, once, and the robot can be engaged."""
    commanded = Commanded().run(Commanded.engage)
    assert len(commanded.notes.mileages_km) == 1
    assert commanded.event_texts().count("is this the same chassis?") == 1


def test_a_former_guard_whose_frames_do_not_come_is_not_waited_for() -> None:
    commanded = Commanded()
    commanded.former_guard.is_stopping = True
    commanded.run(Commanded.engage)


def test_real_time_priority_is_in_health_and_sets_the_speed_limit() -> None:
    """Row 'a gateway without real-time priority': it is looked at in the run too; so are the inbox's drops."""

    def script(one: Commanded) -> Steps:
        one.inbox.drops = 17
        yield from one.engage()
        assert one.says("speed_limit_mps") == 2.222
        one.is_realtime = False
        yield from one.until(lambda: one.says("speed_limit_mps") == 1.0)
        yield from one.health()

    health = Commanded().run(script).zenoh.of("gateway/health")[-1]
    assert (health["realtime"], health["inbox_drops"]) == (False, 17)


def test_a_guard_that_acted_during_the_tick_is_noticed_before_anything_is_sent() -> None:
    """This process was paused between looking and sending, for longer than a stop of the guard lasts."""

    def script(one: Commanded) -> Steps:
        yield from one.engage()
        drain = one.inbox.drain

        def drain_late(holder: str, lease: int, after: int) -> list[RawRequest]:
            one.guard.stops = 1
            return drain(holder, lease, after)

        sent = len(one.bus.sent)
        one.inbox.drain = drain_late  # type: ignore[method-assign]
        yield False
        assert len(one.bus.sent) == sent
        yield from one.until(lambda: one.says("latched") == ["guard"])

    Commanded().run(script)

"""The stream of drive commands, and its link."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from math import inf, nan
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.client import link
from gateway.client.link import BEGAN_ANEW, HOLD_MAX_S, STALE_NS, DriveEnd, DriveStream, RobotLink, SetPoint
from gateway.client.refusal import Refused, Unreachable
from gateway.telemetry.samples import Missed, Received
from schemas.codec import PayloadFault
from schemas.decisions import RUN_TICKS, ArbiterState, LeaseReply, SafetyState, StopPhase
from schemas.messages import RobotState
from schemas.reasons import TEXTS, Reason
from schemas.requests import Acquire, Drive, Park, Request
from schemas.subjects import BY_VERB
from tests.support.messages import STANDBY, STATE
from tests.support.metrics import received
from tests.support.waiting import wait_until

START_NS = 10**12
MS = 1_000_000

ENGAGING = msgspec.structs.replace(STANDBY, tick=101, state=ArbiterState.ENGAGING)
ENGAGED = msgspec.structs.replace(STANDBY, tick=102, state=ArbiterState.ENGAGED, engaged=True)
STOPPED = msgspec.structs.replace(
    STANDBY, tick=103, state=ArbiterState.STOPPING, stop_reason=Reason.FRONT_BUMPER, stop_phase=StopPhase.RAMP
)


def stream_that_saw(*states: SafetyState, expects: bool = True) -> DriveStream:
    """Make a stream of first's that expects to be engaged and then saw these states."""
    stream = DriveStream(7, "first")
    if expects:
        stream.expect_engaged()
    for state in states:
        stream.see(state, START_NS)
    return stream


def goes_on_to_see(stream: DriveStream, state: SafetyState) -> None:
    """Show a state for 150 ms, at the slowest pace."""
    for before_ms in (150, 100, 50, 0):
        stream.see(state, START_NS - before_ms * MS)


def commanded(stream: DriveStream, now_ns: int = START_NS) -> Drive:
    command = stream.command(now_ns)
    assert command is not None
    return command


def driven(speed_mps: float = 1.0, angle_deg: float = 0.0, hold_s: float = 0.5) -> DriveStream:
    stream = stream_that_saw(ENGAGED)
    stream.aim(SetPoint(speed_mps, angle_deg=angle_deg), hold_s, START_NS)
    return stream


def test_nothing_is_sent_before_engage_was_asked_for() -> None:
    for state in (STANDBY, ENGAGING, ENGAGED):
        assert stream_that_saw(state, expects=False).command(START_NS) is None


def test_the_stream_begins_when_engage_is_asked_for() -> None:
    """Over a slow link the deadman would end before the robot was seen engaged."""
    stream = stream_that_saw(STANDBY)
    assert commanded(stream).speed_mps == 0.0
    assert stream.is_wanted, "each drive command renews the lease"
    stream.give_up()
    assert stream.command(START_NS) is None
    assert not stream.is_wanted


def test_while_nothing_is_driven_the_stream_asks_for_zero_speed_and_leaves_the_wheels() -> None:
    for state in (ENGAGING, ENGAGED):
        command = commanded(stream_that_saw(state))
        assert (command.lease, command.speed_mps, command.angle_deg) == (7, 0.0, 7.0)


def test_an_old_challenge_is_not_echoed() -> None:
    stream = stream_that_saw(ENGAGED)
    assert stream.command(START_NS + STALE_NS) is not None
    assert stream.command(START_NS + STALE_NS + 1) is None


@given(hold_ms=st.integers(1, 2000), late_ms=st.integers(-2000, 2000))
def test_a_set_point_that_is_not_renewed_falls_back_to_zero_speed(hold_ms: int, late_ms: int) -> None:
    stream = driven(1.0, 5.0, hold_ms / 1e3)
    now_ns = START_NS + max(0, hold_ms + late_ms) * MS
    stream.see(ENGAGED, now_ns)
    command = commanded(stream, now_ns)
    lapsed = now_ns >= START_NS + hold_ms * MS
    assert (command.speed_mps, command.angle_deg) == (0.0 if lapsed else 1.0, 5.0)
    assert bool(stream.take_note()) is lapsed
    assert stream.take_note() == ""


def test_a_turn_falls_back_to_its_angle() -> None:
    stream = stream_that_saw(ENGAGED)
    stream.aim(SetPoint(1.0, yaw_rate_radps=0.5), 0.1, START_NS)
    stream.see(ENGAGED, START_NS + 100 * MS)
    command = commanded(stream, START_NS + 100 * MS)
    assert command.yaw_rate_radps is None
    assert command.angle_deg == pytest.approx(18.26, abs=0.01)


def test_zero_speed_needs_no_renewal() -> None:
    stream = driven(0.0, 5.0, 0.1)
    stream.see(ENGAGED, START_NS + 200 * MS)
    assert stream.command(START_NS + 200 * MS) is not None
    assert stream.take_note() == ""


@pytest.mark.parametrize(
    ("set_point", "hold_s"),
    [
        (SetPoint(1.0, angle_deg=1.0), 0.0),
        (SetPoint(1.0, angle_deg=1.0), HOLD_MAX_S + 0.01),
        (SetPoint(1.0, angle_deg=1.0), float("nan")),
        (SetPoint(1.0), 0.5),
        (SetPoint(1.0, angle_deg=1.0, curvature_1pm=0.1), 0.5),
        (SetPoint(0.0, yaw_rate_radps=0.1), 0.5),
        (SetPoint(nan, angle_deg=1.0), 0.5),
        (SetPoint(-inf, angle_deg=1.0), 0.5),
        (SetPoint(1.0, angle_deg=nan), 0.5),
        (SetPoint(1.0, curvature_1pm=inf), 0.5),
        (SetPoint(1.0, yaw_rate_radps=nan), 0.5),
    ],
)
def test_a_set_point_that_cannot_be_changes_nothing(set_point: SetPoint, hold_s: float) -> None:
    stream = driven(0.5, 2.0, 0.5)
    with pytest.raises(ValueError):  # noqa: PT011 - the texts are for people
        stream.aim(set_point, hold_s, START_NS)
    assert commanded(stream).speed_mps == 0.5


@pytest.mark.parametrize("value", ["0.3", b"0.3", None, True, [0.3], np.True_])
def test_what_is_no_number_is_named_and_changes_nothing(value: object) -> None:
    stream = stream_that_saw(ENGAGED)
    wanted = SetPoint(0.5, angle_deg=2.0)
    stream.aim(wanted, 0.5, START_NS)
    for field in ("speed_mps",) if value is None else ("speed_mps", "angle_deg"):
        with pytest.raises(TypeError, match=f"{field} must be a number, and is"):
            stream.aim(msgspec.structs.replace(wanted, **{field: value}), 0.5, START_NS)
    command = commanded(stream)
    assert (command.speed_mps, command.angle_deg) == (0.5, 2.0)


@pytest.mark.parametrize("one", [1, np.float64(1), np.float32(1), np.int16(1)])
def test_a_number_of_any_library_is_sent_as_a_float(one: float) -> None:
    stream = stream_that_saw(ENGAGED)
    stream.aim(SetPoint(one, curvature_1pm=one), 0.5, START_NS)
    command = commanded(stream)
    assert [type(command.speed_mps), type(command.curvature_1pm)] == [float, float]
    assert (command.speed_mps, command.curvature_1pm) == (1.0, 1.0)


def held_by(state: SafetyState, holder: str, **changes: object) -> SafetyState:
    return msgspec.structs.replace(state, lease_holder=holder, **changes)


REFUSED = "none for 310 ms; 12 commands refused as too old, 1470 ms"
LATE = msgspec.structs.replace(STOPPED, stop_reason=Reason.DEADMAN, stop_detail=REFUSED)
ANEW = held_by(STANDBY, "", tick=102 + RUN_TICKS)
SHOWN = TEXTS[Reason.DEADMAN].means
ENDINGS: dict[str, tuple[list[SafetyState], list[SafetyState], DriveEnd | None]] = {
    "a stop": ([ENGAGED], [STOPPED], DriveEnd(Reason.FRONT_BUMPER, TEXTS[Reason.FRONT_BUMPER].means)),
    "a stop after refused commands says so": ([ENGAGED], [LATE], DriveEnd(Reason.DEADMAN, f"{SHOWN}; {REFUSED}")),
    "standby": ([ENGAGED], [STANDBY], DriveEnd(Reason.NOT_ENGAGED, TEXTS[Reason.NOT_ENGAGED].means)),
    "engaging": ([ENGAGED], [ENGAGING], DriveEnd(Reason.NOT_ENGAGED, TEXTS[Reason.NOT_ENGAGED].means)),
    "states from before it was engaged, on their way yet": ([STANDBY], [STOPPED, STANDBY], None),
    "somebody has the lease, and then another": (
        [ENGAGED],
        [held_by(ENGAGED, "second"), held_by(STANDBY, "third")],
        DriveEnd(Reason.LEASE_TAKEN, "by second", lease_lost=True),
    ),
    "nobody has it": ([ENGAGED], [held_by(ENGAGED, "")], DriveEnd(Reason.LEASE_EXPIRED, lease_lost=True)),
    "it was never seen to be ours: the reply to acquire came first": ([], [held_by(STANDBY, "second")], None),
    "another run of the gateway": ([ENGAGED], [ANEW], DriveEnd(Reason.NO_LEASE, BEGAN_ANEW, lease_lost=True)),
    "a run that goes on": (
        [ENGAGED],
        [held_by(STANDBY, "", tick=300)],
        DriveEnd(Reason.LEASE_EXPIRED, lease_lost=True),
    ),
}


@pytest.mark.parametrize("name", ENDINGS)
def test_what_the_robot_goes_on_saying_ends_the_stream(name: str) -> None:
    before, then, ending = ENDINGS[name]
    stream = stream_that_saw()
    for state in before:
        stream.see(state, START_NS - 200 * MS)
    for state in then:
        goes_on_to_see(stream, state)
    stream.see(ENGAGED, START_NS)
    assert stream.ending == ending
    assert (stream.command(START_NS) is None) is (ending is not None)
    if stream.is_lost:
        stream.lose(Reason.NO_LEASE)
        stream.expect_engaged()
        assert stream.ending == ending


FORGED = [
    msgspec.structs.replace(ENGAGED, lease_holder=""),
    msgspec.structs.replace(STANDBY, lease_holder="second", tick=10**6),
    STOPPED,
    msgspec.structs.replace(ENGAGED, accepted_seq=10**9),
]


def seen_between(stream: DriveStream, forged: SafetyState, each: int) -> None:
    """Show the robot's states for ten seconds, with a forged one between so many of them."""
    for number in range(500):
        now_ns = START_NS + number * 20 * MS
        stream.see(msgspec.structs.replace(ENGAGED, accepted_seq=None), now_ns)
        assert stream.command(now_ns) is not None
        if number % each == 0:
            stream.see(forged, now_ns + 10 * MS)
        assert stream.ending is None, number


@pytest.mark.parametrize("forged", FORGED)
def test_one_forged_state_ends_nothing(forged: SafetyState) -> None:
    seen_between(stream_that_saw(ENGAGED), forged, 50)


@pytest.mark.parametrize("forged", FORGED[:3])
def test_forged_states_between_the_robots_own_end_nothing(forged: SafetyState) -> None:
    seen_between(stream_that_saw(ENGAGED), forged, 1)


@pytest.mark.parametrize("period_ms", [10, 20, 50])
@pytest.mark.parametrize("true", FORGED)
def test_what_the_robot_goes_on_saying_is_believed_within_a_quarter_of_a_second(
    true: SafetyState, period_ms: int
) -> None:
    stream = stream_that_saw(ENGAGED)
    ended_ms = 0
    while True:
        stream.see(true, START_NS + ended_ms * MS)
        if stream.ending is not None:
            break
        ended_ms += period_ms
    assert 150 <= ended_ms <= 250


@pytest.mark.parametrize(
    ("accepted_seq", "target"),
    [(9, (0.5, 3.0)), (4, (1.0, 3.0)), (4, (0.5, -20.0))],
    ids=["never sent", "faster", "turned"],
)
def test_commands_of_somebody_else_under_the_lease_end_it(accepted_seq: int, target: tuple[float, float]) -> None:
    """Even if every second accepted command is ours. The lease is to be released."""
    stream = driven(0.5, 3.0, 2.0)
    for _ in range(5):
        assert stream.command(START_NS) is not None
    ours = msgspec.structs.replace(ENGAGED, accepted_seq=5, target_speed_mps=0.5, target_angle_deg=3.0)
    theirs = msgspec.structs.replace(
        ENGAGED, accepted_seq=accepted_seq, target_speed_mps=target[0], target_angle_deg=target[1]
    )
    for number in range(10):
        assert not stream.is_lost
        stream.see(ours, START_NS + number * 40 * MS)
        stream.see(theirs, START_NS + (number * 40 + 20) * MS)
        if stream.is_lost:
            break
    assert stream.ending is not None
    assert stream.ending.reason is Reason.LEASE_TAKEN
    assert stream.is_shared
    assert stream.command(START_NS) is None


def test_the_robot_obeys_a_command_of_before_for_a_while() -> None:
    """Over a slow link: its own target is compared, not that of the newest command."""
    stream = stream_that_saw(ENGAGED)
    for number in range(200):
        now_ns = START_NS + number * 20 * MS
        stream.aim(SetPoint(number / 200, angle_deg=0.0), 2.0, now_ns)
        stream.command(now_ns)
        then = max(number - 60, 0)
        stream.see(
            msgspec.structs.replace(
                ENGAGED, accepted_seq=then + 1, target_speed_mps=then / 200, target_angle_deg=0.0
            ),
            now_ns,
        )
    assert stream.ending is None


def test_the_target_of_a_new_engagement_is_no_command_of_the_last_one() -> None:
    stream = driven(0.5, 3.0, 2.0)
    stream.command(START_NS)
    accepted = msgspec.structs.replace(ENGAGED, accepted_seq=1, target_speed_mps=0.5, target_angle_deg=3.0)
    goes_on_to_see(stream, accepted)
    stream.give_up()
    stream.expect_engaged()
    goes_on_to_see(stream, msgspec.structs.replace(accepted, target_speed_mps=0.0, target_angle_deg=0.0))
    assert stream.ending is None


def test_a_lease_whose_renewal_another_run_refused_was_not_renewed_too_late() -> None:
    stream = stream_that_saw(ENGAGED, ANEW)
    stream.lose(Reason.NO_LEASE)
    assert stream.ending == DriveEnd(Reason.NO_LEASE, BEGAN_ANEW, lease_lost=True)


MOVES = msgspec.structs.replace(STATE, speed_mps=0.5)
FORGED_STATE = msgspec.structs.replace(STATE, speed_mps=0.0)


class FakePort:
    def __init__(self, batch: Sequence[Received | Missed]) -> None:
        self.batch = batch

    def drain(self) -> Iterator[Received | Missed]:
        yield from self.batch
        self.batch = []

    def close(self) -> None: ...


def looked_at(batch: Sequence[Received | Missed]) -> list[SafetyState | RobotState | PayloadFault | Missed]:
    """Return what a look shows after one batch."""
    port: Any = FakePort(batch)
    with closing(RobotLink(port, port, "cruiser-1")) as opened:
        wait_until(lambda: not port.batch)
        with opened.heard:
            seen = opened.look()
            assert opened.look() == []
    return [one if isinstance(one, Missed) else one[2] for one in seen]


def test_a_forged_state_hides_none_of_the_robots_own() -> None:
    states = [STANDBY, MOVES, FORGED_STATE]
    assert looked_at([*map(received, states)]) == states


def test_a_look_says_where_samples_are_missing() -> None:
    assert looked_at([received(MOVES), Missed(), received(FORGED_STATE)]) == [Missed(), FORGED_STATE]
    flood = looked_at([received(MOVES), *[received(FORGED_STATE)] * link.SEEN_KEPT])
    assert flood[0] == Missed()
    assert len(flood) <= link.SEEN_KEPT


class FakeDoor(FakePort):
    """A robot with a state, which gives these answers, the last one repeatedly."""

    def __init__(self, *answers: Reason | None) -> None:
        super().__init__([])
        self.prover: Any = None
        self.operator = "ann"
        self.answers = list(answers)
        self.asked = 0

    def drain(self) -> Iterator[Received | Missed]:
        yield received(STANDBY)

    def ask(self, verb: str, _payload: bytes, _timeout_s: float) -> list[Received]:
        self.asked += 1
        reason = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if reason is None:
            return []
        said = LeaseReply(ok=reason is Reason.NONE, reason=reason, detail="", cure="", lease=7, expires_s=2.0)
        return [
            Received(
                f"fleet/cruiser-1/@cmd/ann/{verb}", BY_VERB[verb].reply_encoding, msgspec.msgpack.encode(said)
            )
        ]


class FakeProof:
    """Accepts everything."""

    def with_key(self, request: Request) -> Request:
        return request

    def begin_lease(self, *_: object) -> bool:
        return True

    def __getattr__(self, _name: str) -> Callable[..., Any]:
        return lambda *_: True


def asked(door: Any, request: Request, timeout_s: float = 5.0) -> Any:  # noqa: ANN401 - a fake, a reply
    proof: Any = FakeProof()
    with closing(RobotLink(door, door, "cruiser-1", proof)) as opened:
        wait_until(lambda: opened.is_heard)
        return opened.ask(request, timeout_s)


def test_a_robot_that_is_asked_too_much_is_asked_for_its_lease_again() -> None:
    """Its inbox judges a bounded number of requests in a tick, and leaves others unanswered."""
    door = FakeDoor(Reason.BUSY, None, Reason.BUSY, Reason.NONE)
    assert asked(door, Acquire()).lease == 7
    assert door.asked == 4


def test_a_refusal_is_no_reason_to_ask_again() -> None:
    for door, request in ((FakeDoor(Reason.LEASE_HELD), Acquire()), (FakeDoor(Reason.BUSY), Park(lease=7))):
        with pytest.raises(Refused):
            asked(door, request)
        assert door.asked == 1
    silent = FakeDoor(None)
    with pytest.raises(Unreachable, match="did not answer park"):
        asked(silent, Park(lease=7))
    assert silent.asked == 1


def test_a_robot_that_stays_busy_is_asked_as_long_as_one_wants_to_wait() -> None:
    door = FakeDoor(Reason.BUSY)
    began_s = time.monotonic()
    with pytest.raises(Refused) as refused:
        asked(door, Acquire(), 0.3)
    assert refused.value.reason is Reason.BUSY
    assert door.asked > 2
    assert time.monotonic() - began_s >= 0.2

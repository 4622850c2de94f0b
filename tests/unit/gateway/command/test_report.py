"""What the arbiter says."""

import pytest

from gateway.chassis.port import AT_REST
from gateway.command.arbiter import Reporter, reply
from gateway.command.rulings import Judged, RawRequest, Ruling, VerbAnswer
from schemas.decisions import ArbiterState, Bound, EventKind, LeaseReply, Reply, SafetyState, Verdict
from schemas.messages import SEQUENCE_MAX, GearPosition, Mode
from schemas.reasons import TEXTS, Reason
from schemas.requests import Role
from tests.support.rigs.arbiter import MS, ArbiterRig

WALL_NS = 1_700_000_000_000_000_000


class Told:
    def __init__(self) -> None:
        self.bench = ArbiterRig()
        self.reporter = Reporter(self.bench.arbiter)

    def state(self) -> SafetyState | None:
        return self.reporter.state(self.bench.now_ns, WALL_NS, self.bench.challenge())

    def now(self) -> SafetyState:
        """The state, due or not."""
        self.reporter.state_due_ns = 0
        state = self.state()
        assert state is not None
        return state


def test_the_state_goes_out_at_20_hz_and_on_change() -> None:
    """And its challenge counts as published from then on, and only then."""
    told = Told()
    due = []
    for _ in range(20):
        told.bench.outcome = told.bench.arbiter.tick(told.bench.chassis, [], told.bench.now_ns, 0)
        challenge, state = told.bench.challenge(), told.state()
        age_ns = told.bench.arbiter.link.challenges.age_ns(challenge, told.bench.now_ns)
        assert isinstance(age_ns, int) is (state is not None)
        assert state is None or state.challenge == challenge
        due.append(state is not None)
        told.bench.now_ns += 10 * MS
    assert due == [True, False, False, False, False] * 4
    told.state()
    told.bench.ask("acquire")
    state = told.state()
    assert state is not None
    assert state.lease_holder == "first"
    assert (state.sequence, state.time_ns) == (5, WALL_NS)


def test_what_the_state_says() -> None:
    """Of an engaged robot on its way, backward and to the right."""
    told = Told()
    bench = told.bench
    bench.engage()
    for _ in range(80):
        bench.drive(-0.4, angle_deg=-6.0)
    said = told.now()
    assert (said.state, said.engaged, said.stop_phase.value, said.stop_reason) == (
        ArbiterState.ENGAGED,
        True,
        "idle",
        Reason.NONE,
    )
    assert (said.lease_holder, said.lease_role, said.lease_expires_s) == ("first", Role.OPERATOR, 2.0)
    assert (said.latched, said.blocked_by, said.guarded, said.tick) == ([], [], True, bench.arbiter.tick_number)
    assert (said.target_speed_mps, said.target_angle_deg) == (-0.4, -6.0)
    assert (said.output_speed_mps, said.output_angle_deg, said.output_gear) == (-0.4, -6.0, GearPosition.REVERSE)
    assert not said.parking
    assert (said.speed_limit_mps, said.acceleration_limit_mps2, said.deceleration_limit_mps2) == (2.222, 0.8, 1.2)
    assert (said.emergency_deceleration_mps2, said.steering_limit_deg) == (2.0, 24.0)
    assert (said.steering_rate_limit_degps, said.lateral_acceleration_limit_mps2) == (60.0, 1.5)


def test_the_state_is_published_at_50_hz_while_engaged() -> None:
    """Each half of the period between two challenges is age."""
    told = Told()
    told.bench.engage()
    told.now()
    due = []
    for _ in range(20):
        told.bench.drive()
        due.append(told.state() is not None)
    assert due == [False, True] * 10


def test_what_the_state_says_of_the_link() -> None:
    """Row 'travel delay': the ages, the metres until it can react, the limit from them, the deadman, the echo."""
    told = Told()
    bench = told.bench
    said = told.now()
    assert (said.link_age_s, said.link_age_last_s, said.link_age_p50_s, said.link_age_p99_s) == (None,) * 4
    assert (said.travel_delay_m, said.travel_speed_limit_mps, said.accepted_seq) == (0.0, None, None)
    assert (said.deadman_s, said.stop_detail) == (0.3, "")
    bench.ask("acquire")
    bench.ask("engage", deadman_s=0.8)
    bench.tick(count=2)
    bench.drive()
    bench.ask("unpark")
    for _ in range(150):
        bench.drive(1.0, challenge=bench.challenge(20))
    said = told.now()
    assert (said.link_age_s, said.link_age_last_s, said.link_age_p50_s, said.link_age_p99_s) == (0.2,) * 4
    assert (said.travel_speed_limit_mps, said.output_speed_mps) == (1.0, 1.0)
    assert (said.travel_delay_m, said.deadman_s, said.accepted_seq) == (1.0, 0.8, bench.sequence)
    bench.tick(count=90)
    said = told.now()
    assert (said.stop_reason, said.stop_detail) == (Reason.DEADMAN, "none for 810 ms")
    assert (said.travel_delay_m, said.deadman_s) == (0.0, 0.8)
    bench.ask("release")
    said = told.now()
    assert (said.link_age_s, said.link_age_p50_s, said.accepted_seq, said.deadman_s) == (None, None, None, 0.3)


def test_a_lower_limit_is_told_while_it_is_in_force() -> None:
    """Then the configured one again."""
    told = Told()
    told.bench.ask("acquire")
    told.bench.ask("engage", speed_limit_mps=0.5)
    assert told.now().speed_limit_mps == 0.5
    told.bench.ask("disengage")
    assert told.now().speed_limit_mps == 2.222


def test_nobody_holds_it() -> None:
    """And nothing is sent."""
    said = Told().now()
    assert (said.lease_holder, said.lease_role, said.lease_expires_s) == ("", Role.PROGRAM, 0.0)
    assert (said.output_gear, said.parking, said.output_speed_mps) == (GearPosition.UNDEFINED, True, 0.0)
    assert said.blocked_by == [Reason.NO_LEASE, Reason.NOT_ENGAGED]


def test_why_it_stands_still() -> None:
    """In every state."""
    told = Told()
    bench = told.bench
    bench.ask("acquire")
    bench.changes = {"mode": Mode.REMOTE}
    bench.tick()
    assert told.now().blocked_by == [Reason.HAND_TRANSMITTER, Reason.NOT_ENGAGED]
    bench.changes = {"mode": Mode.STOP}
    bench.ask("engage")
    assert told.now().blocked_by == [Reason.ENGAGING]
    bench.changes = {}
    bench.tick(count=2)
    assert told.now().blocked_by == [Reason.PARKED]
    bench.drive()
    bench.ask("unpark")
    assert told.now().blocked_by == []
    bench.changes = {"gear": GearPosition.NEUTRAL}
    bench.drive(0.5)
    assert told.now().blocked_by == [Reason.GEAR_SHIFTING]
    bench.changes = {}
    bench.drive_for(30, 0.5)
    assert told.now().blocked_by == []
    bench.drive(-0.5)
    assert told.now().blocked_by == [Reason.GEAR_SHIFTING]
    bench.ask("stop", "second")
    assert told.now().blocked_by == [Reason.REMOTE_STOP, Reason.STOPPING]
    assert told.now().latched == [Reason.REMOTE_STOP]
    assert told.now().stop_reason is Reason.REMOTE_STOP


def test_a_pressed_bumper_is_told_while_it_is_engaged() -> None:
    """It forbids a direction."""
    told = Told()
    bench = told.bench
    bench.changes = {"front_bumper": True}
    bench.ask("acquire")
    bench.tick(count=60)
    bench.ask("reset")
    bench.ask("engage")
    bench.tick(count=2)
    assert told.now().blocked_by == [Reason.FRONT_BUMPER, Reason.PARKED]


def test_a_decision_says_all_that_became_of_a_request() -> None:
    """Request, operator, lease, age, verdict, reason, limits, speed and angle before and after, frames sent."""
    told = Told()
    bench = told.bench
    bench.engage()
    bench.tick(count=3)
    bench.drive(1.0, challenge=bench.challenge(2), angle_deg=2.0)
    assert bench.outcome is not None
    decision = told.reporter.decision(bench.outcome.judged[0], [Bound.ACCELERATION], 5, WALL_NS)
    assert (decision.request, decision.operator, decision.lease) == ("drive", "first", bench.lease)
    assert (decision.request_sequence, decision.age_ms) == (bench.sequence, 20.0)
    assert (decision.verdict, decision.reason, decision.detail) == (Verdict.ACCEPTED, Reason.NONE, "")
    assert decision.bound_by == [Bound.ACCELERATION]
    assert (decision.requested_speed_mps, decision.requested_angle_deg) == (1.0, 2.0)
    assert (decision.output_speed_mps, decision.output_angle_deg, decision.frames_sent) == (0.0, 0.6, 5)
    assert (decision.tick, decision.time_ns, decision.sequence) == (bench.arbiter.tick_number, WALL_NS, 0)


def test_a_refusal_is_bound_by_nothing() -> None:
    """It has a reason in words, with the figures; a verb asks for no speed."""
    told = Told()
    raw = RawRequest(1, "x" * 99, "second", b"", 0)
    judged = Judged(raw, Ruling(Reason.TOO_OLD, "410 ms"))
    decision = told.reporter.decision(judged, [Bound.SPEED], 0, WALL_NS)
    assert (decision.verdict, decision.reason, decision.bound_by) == (Verdict.REFUSED, Reason.TOO_OLD, [])
    assert decision.detail == f"{TEXTS[Reason.TOO_OLD].means}; 410 ms"
    assert (decision.requested_speed_mps, decision.requested_angle_deg, decision.age_ms) == (None, None, None)
    assert (decision.request, decision.output_speed_mps) == ("x" * 32, AT_REST.speed_mps)
    accepted = told.reporter.decision(Judged(raw, Ruling()), [Bound.SPEED], 0, WALL_NS)
    assert accepted.bound_by == []
    assert accepted.sequence == 1


def test_an_event_keeps_what_it_is_made_of() -> None:
    """Each subject has a sequence of its own, which wraps."""
    told = Told()
    told.bench.ask("acquire")
    told.reporter.sequences[type(told.reporter.event(told.bench.events[0], 0)).__name__] = SEQUENCE_MAX
    event = told.reporter.event(told.bench.events[0], WALL_NS)
    assert (event.kind, event.operator, event.reason) == (EventKind.LEASE, "first", Reason.NONE)
    assert (event.text, event.time_ns, event.tick) == (
        "first has acquired the lease as operator",
        WALL_NS,
        told.bench.arbiter.tick_number,
    )
    assert event.sequence == SEQUENCE_MAX
    assert told.reporter.event(told.bench.events[0], WALL_NS).sequence == 0


@pytest.mark.parametrize(
    ("verb", "ruling", "expected"),
    [
        ("acquire", Ruling(lease=7, expires_ns=2 * 10**9), LeaseReply(True, Reason.NONE, "", "", 7, 2.0)),  # noqa: FBT003
        ("renew", Ruling(lease=7, expires_ns=10**9), LeaseReply(True, Reason.NONE, "", "", 7, 1.0)),  # noqa: FBT003
        ("engage", Ruling(lease=7), Reply(True, Reason.NONE, "", "")),  # noqa: FBT003
        ("nonsense", Ruling(), Reply(True, Reason.NONE, "", "")),  # noqa: FBT003
    ],
)
def test_a_reply_has_its_verbs_own_fields(verb: str, ruling: Ruling, expected: Reply) -> None:
    """The lease and how long it lasts, for those that give one."""
    made = reply(VerbAnswer(1, verb, ruling))
    assert (type(made), made) == (type(expected), expected)


@pytest.mark.parametrize("verb", ["acquire", "engage", "nonsense"])
@pytest.mark.parametrize("reason", [reason for reason in Reason if reason is not Reason.NONE])
def test_every_refusal_has_words_and_a_cure(verb: str, reason: Reason) -> None:
    """Every refusal has a reason from one enumeration, and what would cure it."""
    made = reply(VerbAnswer(1, verb, Ruling(reason, "42", lease=7)))
    assert (made.ok, made.reason, made.cure) == (False, reason, TEXTS[reason].cure)
    assert made.detail == f"{TEXTS[reason].means}; 42"
    assert made.cure
    assert not isinstance(made, LeaseReply) or made.lease == 0

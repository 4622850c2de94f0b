"""What is ruled on each verb."""

from itertools import pairwise

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.command.rulings import RawRequest
from schemas.decisions import ArbiterState, Bound, EventKind
from schemas.messages import GearPosition, Mode, Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import CommandSettings
from schemas.subjects import COMMANDS, Asking, Command
from tests.support.requests import LEASED, REQUESTS
from tests.support.rigs.arbiter import MS, ArbiterRig, engaged


def stopped(bench: ArbiterRig) -> None:
    """Let a stop that is under way end; the lease is kept."""
    for _ in range(6):
        bench.ask("renew")
        bench.tick(count=100)


# The request itself.


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_a_verb_is_asked_for_in_its_own_way(command: Command) -> None:
    """A query where it is one, a put where it is one; stop either way."""
    bench = ArbiterRig()
    wrong = 0 if command.asking is Asking.QUERY else 1
    ruling = bench.send(command.verb, b"\x80", handle=wrong)
    if command.verb == "stop":
        assert ruling.reason is Reason.NONE
    else:
        assert ruling.reason is Reason.UNKNOWN_VERB
        assert ruling.detail == f"'{command.verb}' as a {'query' if wrong else 'put'}"


def test_what_is_no_verb_is_refused() -> None:
    """And repeated in no more than 32 plain characters."""
    ruling = ArbiterRig().send("ä" * 99, b"")
    assert ruling.reason is Reason.UNKNOWN_VERB
    assert len(ruling.detail) < 32 * 4 + 14


@pytest.mark.parametrize(
    ("size", "reason"), [(1024, Reason.NONE), (1025, Reason.TOO_LARGE), (10**7, Reason.TOO_LARGE)]
)
def test_no_request_is_larger_than_a_kilobyte(size: int, reason: Reason) -> None:
    """It is not even read."""
    assert ArbiterRig().send("acquire", b"\x80", size=size).reason is reason


@pytest.mark.parametrize(
    "payload",
    [
        b"\xc1",
        b"\x81",
        msgspec.msgpack.encode([1, 2]),
        msgspec.msgpack.encode({"role": "king"}),
        msgspec.msgpack.encode({"more": 1}),
        b"\x91" * 1000,
    ],
)
def test_bytes_that_are_no_request_are_refused(payload: bytes) -> None:
    """With why, in no more than 200 characters; and nothing is changed."""
    bench = ArbiterRig()
    ruling = bench.send("acquire", payload)
    assert ruling.reason is Reason.MALFORMED
    assert 0 < len(ruling.detail) <= 200
    assert bench.arbiter.leases.held is None


@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")])
def test_numbers_that_are_none_are_refused(number: float) -> None:
    """NaN and the infinities, in each field of drive."""
    bench = engaged()
    for name in ("speed_mps", "angle_deg"):
        assert bench.drive(**{name: number}).reason is Reason.MALFORMED
    assert bench.arbiter.setpoint.target.speed_mps == 0


def test_an_operator_without_a_name_may_only_stop() -> None:
    """The router binds the chunk to a certificate; one that is not of its form is nobody."""
    bench = ArbiterRig()
    assert bench.send("acquire", b"\x80", "").reason is Reason.MALFORMED
    assert bench.send("stop", b"", "").reason is Reason.NONE
    assert bench.told(EventKind.LATCH)[0].text.endswith("by an unnamed operator")


@pytest.mark.parametrize("command", LEASED, ids=lambda command: command.verb)
def test_every_other_verb_wants_the_lease_in_force(command: Command) -> None:
    """Row 'lease: exclusive'."""
    bench = engaged()
    fields = REQUESTS[command.verb] | {"lease": bench.lease + 1}
    payload = msgspec.msgpack.encode(fields)
    handle = int(command.asking is Asking.QUERY)
    ruling = bench.send(command.verb, payload, handle=handle)
    assert (ruling.reason, ruling.lease) == (Reason.NO_LEASE, bench.lease + 1)
    own = msgspec.msgpack.encode(fields | {"lease": bench.lease})
    assert bench.send(command.verb, own, "second", handle=handle).reason is Reason.NO_LEASE
    assert bench.arbiter.state is ArbiterState.ENGAGED


@pytest.mark.parametrize("command", [one for one in LEASED if one.engaged_only], ids=lambda command: command.verb)
def test_what_only_an_engaged_robot_does_is_refused_before(command: Command) -> None:
    """Frames go out only together with the five."""
    bench = ArbiterRig()
    bench.ask("acquire")
    ruling = bench.send(command.verb, msgspec.msgpack.encode(REQUESTS[command.verb] | {"lease": bench.lease}))
    assert ruling.reason is Reason.NOT_ENGAGED
    assert bench.tick().auxiliary == []


@given(
    verb=st.sampled_from([command.verb for command in COMMANDS]), payload=st.binary(max_size=60), put=st.booleans()
)
def test_no_bytes_raise_or_move(verb: str, payload: bytes, put: bool) -> None:  # noqa: FBT001
    """Any bytes on any command key get a typed refusal, and change nothing."""
    bench = ArbiterRig()
    ruling = bench.send(verb, payload, handle=0 if put else 1)
    assert isinstance(ruling.reason, Reason)
    assert bench.arbiter.state is ArbiterState.STANDBY


# The lease.


def test_acquire_gives_a_lease_of_two_seconds() -> None:
    """Row 'lease: 2 s'; who comes second is told who holds it and for how long."""
    bench = ArbiterRig()
    ruling = bench.ask("acquire")
    assert (ruling.reason, ruling.expires_ns) == (Reason.NONE, 2_000 * MS)
    assert bench.told(EventKind.LEASE)[0].text == "first has acquired the lease as operator"
    bench.tick(count=49)
    other = bench.ask("acquire", "second")
    assert other.reason is Reason.LEASE_HELD
    assert other.detail == "by first, expires in 1.5 s"


def test_renew_and_drive_keep_it() -> None:
    """Row 'lease: renewed by drive or renew'; drive in any state, if it is fresh."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.tick(count=150)
    assert bench.ask("renew").expires_ns == 2_000 * MS
    bench.tick(count=150)
    assert bench.drive().reason is Reason.NOT_ENGAGED
    bench.tick(count=199)
    assert bench.arbiter.leases.held is not None
    bench.tick()
    assert bench.arbiter.leases.held is None
    assert bench.drive().reason is Reason.LEASE_EXPIRED


def test_a_lease_that_expires_stops_the_robot() -> None:
    """Row 'lease: expires'; the event names who lost it."""
    bench = engaged(lease_s=0.5, deadman_s=0.5)
    bench.tick(count=52)
    assert bench.arbiter.state is ArbiterState.STOPPING
    assert bench.arbiter.engagement.stop_reason is Reason.LEASE_EXPIRED
    assert (bench.told(EventKind.LEASE)[-1].operator, bench.told(EventKind.STOP)[-1].operator) == (
        "first",
        "first",
    )


def test_release_stops_the_robot() -> None:
    """And gives the lease back."""
    bench = engaged()
    assert bench.ask("release").reason is Reason.NONE
    assert bench.told(EventKind.LEASE)[-1].text == "first gave the lease back"
    assert bench.arbiter.engagement.stop_reason is Reason.LEASE_RELEASED
    assert bench.drive().reason is Reason.LEASE_RELEASED
    bench.ask("acquire", "second")
    assert bench.ask("release", "second").reason is Reason.NONE
    assert bench.arbiter.engagement.stop_reason is Reason.LEASE_RELEASED


def test_take_wants_a_standing_robot_or_an_override() -> None:
    """Row 'take': a robot that moves, or is not seen to stand; the cure names the override."""
    bench = engaged()
    bench.drive_for(30, 1.0)
    refused = bench.ask("take", "second")
    assert refused.reason is Reason.MOVING
    assert "--take --override" in TEXTS[refused.reason].cure
    low = bench.ask("take", "second", override=True, role="program")
    assert (low.reason, low.detail) == (Reason.ROLE_TOO_LOW, "first holds it as operator")
    taken = bench.ask("take", "second", override=True)
    assert taken.reason is Reason.NONE
    assert bench.arbiter.engagement.stop_reason is Reason.LEASE_TAKEN
    lost, won = bench.told(EventKind.LEASE)[-2:]
    assert (lost.operator, lost.text) == ("first", "second took the lease from first")
    assert (won.operator, won.text) == ("second", "second has taken the lease as operator")


def test_take_of_a_standing_robot_in_standby() -> None:
    """Nothing is stopped that is not told anything; what nobody holds is acquired."""
    bench = ArbiterRig()
    assert bench.ask("take", "second", role="program").reason is Reason.NONE
    assert bench.told(EventKind.LEASE)[-1].text == "second has acquired the lease as program"
    assert bench.ask("take", "first").reason is Reason.NONE
    assert bench.arbiter.state is ArbiterState.STANDBY


@pytest.mark.parametrize(("verb", "reason"), [("take", Reason.LEASE_TAKEN), ("release", Reason.LEASE_RELEASED)])
def test_a_lease_that_ends_while_it_is_being_engaged_stops_that(verb: str, reason: Reason) -> None:
    """Nobody would drive it."""
    bench = ArbiterRig()
    bench.changes = {"mode": Mode.STOP}
    bench.ask("acquire")
    bench.ask("engage")
    bench.ask(verb)
    assert bench.arbiter.engagement.stop_reason is reason
    assert bench.arbiter.state is ArbiterState.STOPPING


# Engage.


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"bus_up": False}, Reason.BUS_DOWN),
        ({"guarded": False}, Reason.UNGUARDED),
        ({"mode": Mode.REMOTE}, Reason.HAND_TRANSMITTER),
        ({"commander_ns": 80 * MS}, Reason.OTHER_COMMANDER),
        ({"missing": ("Auto_GearFeedBack", "Auto_LightFeedback")}, Reason.FEEDBACK_MISSING),
        ({"faulty": ("Auto_GearFeedBack",)}, Reason.FEEDBACK_FAULTY),
        ({"variant": Variant.UNKNOWN}, Reason.VARIANT_UNKNOWN),
        ({"confirmed": False}, Reason.VARIANT_UNKNOWN),
        ({"speed_mps": 0.1}, Reason.MOVING),
        ({"fastest_wheel_mps": 0.1}, Reason.MOVING),
        ({"front_bumper": True}, Reason.FRONT_BUMPER),
        ({"guard_sends": True}, Reason.GUARD),
    ],
)
def test_engage_wants_all_of_the_table(changes: dict[str, object], reason: Reason) -> None:
    """Row 'engage: lease held, every feedback seen and fresh, variant confirmed, mode not remote, no latch'."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.changes = changes
    bench.tick()
    ruling = bench.ask("engage")
    assert ruling.reason is reason
    assert bench.arbiter.state is ArbiterState.STANDBY
    if reason is Reason.FEEDBACK_MISSING:
        assert ruling.detail == "Auto_GearFeedBack, Auto_LightFeedback"


def test_engage_tells_every_blocker() -> None:
    """The gravest first."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.ask("stop", "second")
    bench.changes = {"mode": Mode.REMOTE, "faulty": ("Auto_GearFeedBack",), "speed_mps": 1.0}
    ruling = bench.ask("engage")
    assert ruling.reason is Reason.REMOTE_STOP
    assert ruling.detail == "and hand_transmitter, feedback_faulty"


@pytest.mark.parametrize(
    ("ticks_ago", "reason", "detail"),
    [
        (100, Reason.NONE, ""),
        (101, Reason.LINK_TOO_SLOW, "1010 ms, at most 1000 ms"),
        (500, Reason.CHALLENGE_UNKNOWN, ""),
        (-5, Reason.CHALLENGE_UNKNOWN, ""),
    ],
)
def test_engage_is_refused_over_a_link_that_is_too_slow(ticks_ago: int, reason: Reason, detail: str) -> None:
    """Row 'command age, by echo', before anything moves: with the age; and a forged challenge has none."""
    bench = ArbiterRig(CommandSettings(lease_s=10.0))
    bench.tick(count=200)
    bench.ask("acquire")
    ruling = bench.ask("engage", challenge=bench.challenge(ticks_ago))
    assert (ruling.reason, ruling.detail) == (reason, detail)
    assert (bench.arbiter.state is ArbiterState.ENGAGING) is (reason is Reason.NONE)
    known = reason is not Reason.CHALLENGE_UNKNOWN
    assert ruling.age_ns == (ticks_ago * 10 * MS if known else None)


@pytest.mark.parametrize(
    ("speed_mps", "ticks", "reason"),
    [
        (0.1, 28, Reason.COMMAND_NOT_ZERO),
        (0.1, 29, Reason.COMMAND_NOT_ZERO),
        (0.1, 31, Reason.NONE),
        (0.0, 1, Reason.NONE),
    ],
)
def test_engage_wants_the_command_to_be_zero(speed_mps: float, ticks: int, reason: Reason) -> None:
    """Row 'engage: command zero': what was asked in the last 300 ms. The stream may run before."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.drive(speed_mps)
    bench.tick(count=ticks)
    assert bench.ask("engage").reason is reason


@pytest.mark.parametrize(("limit_mps", "in_force_mps"), [(0.5, 0.5), (9.0, 2.222), (None, 2.222)])
def test_engage_may_lower_the_speed_limit(limit_mps: float | None, in_force_mps: float) -> None:
    """Limits scale down, never up, at run time."""
    bench = ArbiterRig()
    bench.ask("acquire")
    assert bench.ask("engage", speed_limit_mps=limit_mps).is_pending
    assert bench.arbiter.setpoint.limits.speed_mps == in_force_mps


@pytest.mark.parametrize("limit_mps", [0.0, -1.0])
def test_a_speed_limit_is_above_zero(limit_mps: float) -> None:
    """Or the request means something else."""
    bench = ArbiterRig()
    bench.ask("acquire")
    assert bench.ask("engage", speed_limit_mps=limit_mps).reason is Reason.MALFORMED


def test_engage_in_every_other_state_is_refused() -> None:
    """With its own reason."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.changes = {"mode": Mode.STOP}
    bench.ask("engage")
    assert bench.ask("engage").reason is Reason.ENGAGING
    bench.changes = {}
    bench.tick()
    assert bench.ask("engage").reason is Reason.ALREADY_ENGAGED
    bench.ask("disengage")
    assert bench.ask("engage").reason is Reason.STOPPING


def test_disengage() -> None:
    """Row 'disengage: controlled stop, no latch'; where nothing is engaged, it says so."""
    bench = engaged()
    bench.drive_for(100, 0.5)
    assert bench.ask("disengage").reason is Reason.NONE
    assert bench.arbiter.state is ArbiterState.STOPPING
    assert bench.ask("disengage").reason is Reason.NONE
    assert bench.arbiter.output.actuation is not None
    assert bench.arbiter.output.actuation.speed_mps == pytest.approx(0.5 - 0.024)
    assert bench.arbiter.latches.details == {}
    stopped(bench)
    assert bench.ask("disengage").reason is Reason.NOT_ENGAGED


# Reset.


def test_reset_clears_what_is_latched() -> None:
    """Row 'stop: latched; reset needs the lease, a standing robot, zero command, the cause gone'."""
    bench = engaged()
    bench.ask("stop", "second")
    assert bench.ask("reset").reason is Reason.STOPPING
    stopped(bench)
    assert bench.arbiter.latches.details
    assert bench.ask("engage").reason is Reason.REMOTE_STOP
    ruling = bench.ask("reset", of="second")
    assert (ruling.reason, ruling.detail) == (Reason.NONE, "remote_stop")
    assert bench.arbiter.latches.details == {}
    assert bench.told(EventKind.RESET)[-1].text == "reset: remote_stop"
    assert bench.arbiter.state is ArbiterState.STANDBY, "nothing ever resumes by itself"
    bench.ask("reset")
    assert bench.told(EventKind.RESET)[-1].text == "reset: nothing was latched"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"speed_mps": 0.1}, Reason.MOVING),
        ({"guard_sends": True}, Reason.GUARD),
        ({"missing": ("Auto_GearFeedBack",)}, Reason.FEEDBACK_MISSING),
        ({"variant": Variant.UNKNOWN}, Reason.VARIANT_UNKNOWN),
    ],
)
def test_reset_wants_the_cause_gone(changes: dict[str, object], reason: Reason) -> None:
    """And a robot that is seen to stand."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.ask("stop")
    bench.tick(count=60)
    bench.changes = changes
    bench.tick()
    assert bench.ask("reset").reason is reason
    assert Reason.REMOTE_STOP in bench.arbiter.latches.details


@pytest.mark.parametrize(
    ("stops", "of", "refused_for"),
    [
        (("first",), "", None),
        (("second",), "", "second"),
        (("second",), "third", "second"),
        (("second",), "second", None),
        (("second", "first"), "", "second"),
        (("second", "third"), "second", "third"),
        (("second", "third"), "third", None),
        (("third", "second", "third"), "third", None),
        ((*"abcdef", "first"), "f", None),
        (("",), "", "an unnamed operator"),
        (("",), "an unnamed operator", None),
    ],
)
def test_a_reset_says_whose_stop_it_clears(stops: tuple[str, ...], of: str, refused_for: str | None) -> None:
    """Row 'reset of a stop by somebody else': the newest of them, else refused with that name."""
    bench = ArbiterRig()
    bench.ask("acquire")
    for operator in stops:
        bench.ask("stop", operator)
    bench.tick(count=60)
    ruling = bench.ask("reset", of=of)
    refused = (Reason.STOPPED_BY_OTHER, refused_for)
    assert (ruling.reason, ruling.detail) == (refused if refused_for else (Reason.NONE, "remote_stop"))
    assert bool(bench.arbiter.latches.details) is (refused_for is not None)


def test_the_last_four_who_stopped_it_are_named() -> None:
    """Then "others"; whoever stops it again is the newest. So says the detail, which outlives a restart, too."""
    bench = ArbiterRig()
    for operator in "abcdeb":
        bench.ask("stop", operator)
    assert bench.arbiter.latches.stopped_by == ["b", "e", "d", "c", "others"]
    assert bench.arbiter.latches.details == {Reason.REMOTE_STOP: "by b, e, d, c, others"}
    assert len(bench.told(EventKind.LATCH)) == 1


def test_reset_wants_the_command_to_be_zero() -> None:
    """Nobody may ask it to move meanwhile."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.ask("stop")
    bench.tick(count=60)
    bench.drive(1.0)
    assert bench.ask("reset").reason is Reason.COMMAND_NOT_ZERO
    bench.drive(0.0)
    assert bench.ask("reset").reason is Reason.NONE


@pytest.mark.parametrize(("ticks", "reason"), [(48, Reason.REMOTE_STOP), (49, Reason.NONE)])
def test_a_reset_that_comes_at_once_was_not_meant_for_this_latch(ticks: int, reason: Reason) -> None:
    """It may have been on its way when the stop came: half a second."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.ask("stop")
    bench.tick(count=ticks)
    assert bench.ask("reset").reason is reason


@pytest.mark.parametrize(
    ("seen_ticks_ago", "reason"),
    [(0, Reason.NONE), (100, Reason.NONE), (101, Reason.TOO_OLD), (500, Reason.CHALLENGE_UNKNOWN)],
)
def test_a_reset_is_as_old_as_the_challenge_that_it_echoes(seen_ticks_ago: int, reason: Reason) -> None:
    """Row 'command age, by echo' for it too: 1 s."""
    bench = ArbiterRig(CommandSettings(lease_s=10.0))
    bench.ask("acquire")
    bench.ask("stop")
    bench.tick(count=200)
    ruling = bench.ask("reset", challenge=bench.challenge(seen_ticks_ago))
    assert ruling.reason is reason
    assert (ruling.lease, bool(bench.arbiter.latches.details)) == (bench.lease, reason is not Reason.NONE)
    if reason is not Reason.NONE:
        assert ruling.detail == "it was made before this was to be seen"


@pytest.mark.parametrize(("more_ticks", "reason"), [(1, Reason.NONE), (2, Reason.REMOTE_STOP)])
def test_a_reset_with_a_challenge_clears_nothing_that_was_latched_after_it(
    more_ticks: int, reason: Reason
) -> None:
    """Though it is young enough: the newest cause is named. The bench publishes a challenge one tick later."""
    bench = ArbiterRig(CommandSettings(max_age_s=1.0))
    bench.ask("acquire")
    bench.ask("stop")
    bench.tick(count=60)
    assert bench.ask("reset", challenge=bench.challenge(60 + more_ticks)).reason is reason


def test_a_reset_with_a_challenge_and_nothing_latched_is_served() -> None:
    """There is nothing that it has not seen."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.tick(count=60)
    assert bench.ask("reset", challenge=bench.challenge(20)).reason is Reason.NONE


def test_a_second_hit_of_a_latched_bumper_counts_anew() -> None:
    """A reset right after it is refused; while it is only held down it ages."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.changes = {"front_bumper": True}
    bench.tick(count=60)
    bench.changes = {}
    bench.tick(count=30)
    bench.changes = {"front_bumper": True}
    bench.tick()
    assert bench.ask("reset").reason is Reason.FRONT_BUMPER
    bench.tick(count=60)
    assert bench.ask("reset").reason is Reason.NONE


def test_a_second_stop_is_not_wiped_by_a_reset_of_its_tick() -> None:
    """Whoever resets has not seen it: stop always wins."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.ask("stop")
    bench.tick(count=60)
    reset = msgspec.msgpack.encode({"lease": bench.lease})
    engage = msgspec.msgpack.encode({"lease": bench.lease, "challenge": bench.challenge()})
    requests = [
        RawRequest(0, "stop", "second", b"", 0),
        RawRequest(1, "reset", "first", reset, len(reset)),
        RawRequest(2, "engage", "first", engage, len(engage)),
    ]
    rulings = [judged.ruling.reason for judged in bench.tick(requests).judged]
    assert rulings == [Reason.NONE, Reason.REMOTE_STOP, Reason.REMOTE_STOP]
    assert bench.arbiter.state is ArbiterState.STANDBY


def test_a_reset_keeps_the_lease() -> None:
    """Its holder is there."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.tick(count=150)
    assert bench.ask("reset").reason is Reason.NONE
    bench.tick(count=100)
    assert bench.arbiter.leases.held is not None


# The rest.


def test_park_and_unpark() -> None:
    """Row 'rolling: park is accepted at any speed while the command is zero'; unpark at zero command too."""
    bench = ArbiterRig()
    bench.ask("acquire")
    assert bench.ask("park").reason is bench.ask("unpark").reason is Reason.NOT_ENGAGED
    bench.ask("engage")
    bench.tick(count=2)
    bench.drive(1.0)
    assert bench.ask("unpark").reason is Reason.COMMAND_NOT_ZERO
    bench.drive(0.0)
    assert bench.ask("unpark").reason is Reason.NONE
    assert not bench.arbiter.setpoint.parked
    bench.drive_for(100, 1.0)
    assert bench.ask("park").reason is Reason.COMMAND_NOT_ZERO
    bench.drive(0.0)
    assert bench.arbiter.output.motion.speed_mps > 0.5
    assert bench.ask("park").reason is Reason.NONE
    told = bench.arbiter.output.actuation
    assert told is not None
    assert (told.parking, told.speed_mps, told.gear) == (True, 0.0, GearPosition.DRIVE)


def test_lamps_and_horn_are_the_engaged_robots() -> None:
    """Frames go out only together with the five."""
    bench = ArbiterRig()
    bench.ask("acquire")
    assert bench.ask("light", left=True).reason is bench.ask("horn", on=True).reason is Reason.NOT_ENGAGED
    bench.ask("engage")
    bench.tick(count=2)
    assert bench.ask("light", left=True).reason is bench.ask("horn", on=True).reason is Reason.NONE
    assert [frame.name for frame in bench.tick().auxiliary] == ["Auto_LightCmd", "Auto_SpeakerCmd"]


def test_the_odometer_is_cleared_at_standstill_and_told_when_it_is() -> None:
    """The reply comes later; a second request meanwhile is refused."""
    bench = ArbiterRig()
    bench.ask("acquire")
    assert bench.ask("clear_odometer").reason is Reason.NOT_ENGAGED
    bench.ask("engage")
    bench.tick(count=2)
    assert bench.ask("clear_odometer").is_pending
    assert bench.ask("clear_odometer").reason is Reason.BUSY
    bench.drive_for(8, 0.0)
    bench.changes = {"total_mileage_km": 0.0}
    answers = [answer for _ in range(5) for answer in bench.tick().answers]
    assert [(answer.verb, answer.ruling.reason) for answer in answers] == [("clear_odometer", Reason.NONE)]
    bench.ask("unpark")
    bench.drive_for(30, 1.0)
    assert bench.ask("clear_odometer").reason is Reason.MOVING


def test_an_odometer_that_is_not_cleared_is_told() -> None:
    """Within two seconds."""
    bench = engaged()
    bench.drive_for(6, 0.0)
    assert bench.ask("clear_odometer").is_pending
    answers = []
    for _ in range(205):
        bench.drive()
        answers += bench.outcome.answers if bench.outcome is not None else []
    assert [(a.ruling.reason, a.ruling.detail) for a in answers] == [
        (Reason.NOT_CONFIRMED, "the mileage does not read zero")
    ]


# Drive.


def test_a_fresh_command_is_obeyed() -> None:
    """And told with its sequence, its age and what it asks for."""
    bench = engaged()
    ruling = bench.drive(1.0, angle_deg=3.0)
    assert (ruling.reason, ruling.sequence, ruling.age_ns) == (Reason.NONE, bench.sequence, 0)
    assert ruling.asked == bench.arbiter.setpoint.target
    assert (bench.arbiter.setpoint.target.speed_mps, bench.arbiter.setpoint.target.angle_deg) == (1.0, 3.0)


@pytest.mark.parametrize("step", [0, -1])
def test_the_sequence_rises(step: int) -> None:
    """Row 'sequence: strictly rising within a lease; repeated or older: refused'."""
    bench = engaged()
    bench.drive(0.5, seq=50)
    ruling = bench.drive(1.0, seq=50 + step)
    assert (ruling.reason, ruling.detail) == (Reason.SEQUENCE, f"{50 + step} after 50")
    assert bench.arbiter.setpoint.target.speed_mps == 0.5
    assert bench.drive(1.0, seq=51).reason is Reason.NONE


def test_a_sequence_cannot_be_used_up() -> None:
    """Row 'sequence': it rises by 1 to 1,000. Nobody lifts it to where the holder's own numbers are refused."""
    bench = engaged()
    last = bench.sequence
    for seq in (2**53 - 1, last + 1001):
        ruling = bench.drive(1.0, seq=seq)
        assert (ruling.reason, ruling.detail) == (Reason.SEQUENCE, f"{seq} after {last}, at most 1000 more")
    assert bench.drive(1.0, seq=last + 1000).reason is Reason.NONE
    assert bench.drive(1.0, seq=last + 1001).reason is Reason.NONE
    bench.ask("release")
    bench.ask("acquire")
    assert bench.drive(seq=1000).reason is Reason.SEQUENCE, "a new lease begins at the bottom"
    assert bench.drive(seq=999).reason is not Reason.SEQUENCE


def test_zero_is_a_sequence_number_and_each_lease_begins_anew() -> None:
    """'Within a lease'."""
    bench = ArbiterRig()
    bench.ask("acquire")
    assert bench.drive(seq=0).reason is Reason.NOT_ENGAGED
    assert bench.drive(seq=0).reason is Reason.SEQUENCE
    bench.ask("release")
    bench.ask("acquire")
    assert bench.drive(seq=0).reason is Reason.NOT_ENGAGED


@pytest.mark.parametrize(("ticks", "reason"), [(40, Reason.NONE), (41, Reason.TOO_OLD)])
def test_the_age_is_bounded_by_the_echo(ticks: int, reason: Reason) -> None:
    """Row 'command age, by echo': at the limit it is not refused. What is refused does not renew."""
    bench = engaged(deadman_s=0.5, max_age_s=0.4)
    echo = bench.challenge()
    bench.tick(count=ticks)
    before_ns = bench.arbiter.link.fresh_ns
    ruling = bench.drive(1.0, challenge=echo)
    assert (ruling.reason, ruling.age_ns) == (reason, ticks * 10 * MS)
    assert (bench.arbiter.link.fresh_ns > before_ns) is (reason is Reason.NONE)
    if reason is Reason.TOO_OLD:
        assert ruling.detail == "410 ms, at most 400 ms"
        assert bench.drive(1.0, seq=bench.sequence).reason is Reason.NONE, "its sequence does not count either"


def test_the_deadman_tells_what_was_refused_before_it() -> None:
    """Row 'deadman': a stream that comes too late is told from one that has ended."""
    bench = engaged(max_age_s=0.4)
    bench.drive_for(60, 0.5)
    while bench.arbiter.state is ArbiterState.ENGAGED:
        bench.drive(0.5, challenge=bench.challenge(47))
    [stop] = bench.told(EventKind.STOP)
    assert stop.reason is Reason.DEADMAN
    assert stop.text.endswith("none for 310 ms; 31 commands refused as too old, 470 ms")
    assert bench.arbiter.engagement.stop_detail == "none for 310 ms; 31 commands refused as too old, 470 ms"


@pytest.mark.parametrize(("asked_s", "ticks"), [(None, 31), (0.1, 31), (0.8, 81), (1.0, 101)])
def test_an_engagement_has_the_deadman_that_it_asked_for(asked_s: float | None, ticks: int) -> None:
    """Row 'deadman: engage may ask for up to 1 s'; the configured one is the least."""
    bench = ArbiterRig()
    bench.ask("acquire")
    bench.ask("engage", deadman_s=asked_s)
    bench.tick(count=2)
    bench.drive()
    bench.tick(count=ticks - 1)
    assert bench.arbiter.state is ArbiterState.ENGAGED
    bench.tick()
    assert bench.arbiter.engagement.stop_reason is Reason.DEADMAN


@pytest.mark.parametrize("deadman_s", [0.0, 0.04, 1.01, -1.0])
def test_a_deadman_beyond_its_bounds_is_malformed(deadman_s: float) -> None:
    """Longer than 1 s is none."""
    bench = ArbiterRig()
    bench.ask("acquire")
    assert bench.ask("engage", deadman_s=deadman_s).reason is Reason.MALFORMED


def test_old_commands_drive_slowly() -> None:
    """Row 'travel delay': down by the normal deceleration, up by the acceleration, and recorded as what bound."""
    bench = engaged()
    bench.drive_for(300, 2.0)
    assert bench.arbiter.output.motion.speed_mps == 2.0
    assert Bound.TRAVEL_DELAY not in bench.arbiter.output.motion.bounds
    speeds_mps = [2.0]
    for ticks_ago in [70] * 300 + [0] * 300:
        bench.drive(2.0, challenge=bench.challenge(ticks_ago))
        limit_mps = bench.arbiter.link.age.speed_limit_mps(bench.now_ns)
        assert limit_mps is not None
        assert (Bound.TRAVEL_DELAY in bench.arbiter.output.motion.bounds) is (limit_mps < 2.0)
        speeds_mps.append(bench.arbiter.output.motion.speed_mps)
    assert speeds_mps[300] == pytest.approx(1.0 / (0.7 + 0.3))
    assert speeds_mps[-1] == 2.0
    steps_mps = [after - before for before, after in pairwise(speeds_mps)]
    assert min(steps_mps) == pytest.approx(-0.012)
    assert max(steps_mps) == pytest.approx(0.008)


def test_an_unknown_challenge_is_refused() -> None:
    """It was not published: of another run, of none, or one that nobody can have seen yet."""
    bench = engaged()
    for challenge in (bytes(8), bench.challenge(-5)):
        ruling = bench.drive(1.0, challenge=challenge, tick=bench.arbiter.tick_number)
        assert (ruling.reason, ruling.age_ns) == (Reason.CHALLENGE_UNKNOWN, None)
    assert bench.arbiter.setpoint.target.speed_mps == 0


def test_what_is_no_bend_is_malformed() -> None:
    """Two at once."""
    ruling = engaged().drive(1.0, curvature_1pm=0.1)
    assert (ruling.reason, ruling.asked) == (Reason.MALFORMED, None)
    assert "exactly one" in ruling.detail


def test_drive_while_it_is_not_engaged() -> None:
    """Each state has its reason; zero is welcome while it is being engaged."""
    bench = ArbiterRig()
    bench.ask("acquire")
    assert bench.drive(1.0).reason is Reason.NOT_ENGAGED
    bench.tick(count=31)
    bench.changes = {"mode": Mode.STOP, "gear": GearPosition.NEUTRAL}
    bench.ask("engage")
    assert bench.drive(0.0).reason is Reason.NONE
    assert bench.drive(1.0).reason is Reason.ENGAGING
    bench.ask("disengage")
    assert bench.drive(0.0).reason is Reason.STOPPING
    assert bench.arbiter.setpoint.target.speed_mps == 0

"""What is ruled on each verb.

The rows of the tables are steps (see ``ArbiterRig.play``), of which the last one is ruled on; the ruling's reason;
and what else the ruling holds. What is refused changes nothing.
"""

from itertools import pairwise
from math import inf, nan
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.command.rulings import RawRequest, Ruling
from schemas.cruiser import SPEED_TOP_MPS
from schemas.decisions import ArbiterState, Bound, EventKind
from schemas.messages import GearPosition, Mode, Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import CommandSettings
from schemas.subjects import COMMANDS, Asking, Command
from tests.support.requests import LEASED, REQUESTS
from tests.support.rigs.arbiter import MS, ArbiterRig, Step, engaged

Row = tuple[tuple[Step, ...], Reason] | tuple[tuple[Step, ...], Reason, dict[str, Any]]
Table = dict[str, Row]
ENGAGED: tuple[Step, ...] = ("acquire", "engage", 2, 0.0, "unpark")
LATCHED: tuple[Step, ...] = ("acquire", "stop", 60)
ENGAGING: tuple[Step, ...] = ("acquire", {"mode": Mode.STOP, "gear": GearPosition.NEUTRAL}, "engage")


def rows(table: Table) -> pytest.MarkDecorator:
    """The table's rows, under their names."""
    whole = [(row[0], row[1], row[2] if len(row) > 2 else {}) for row in table.values()]
    return pytest.mark.parametrize(("steps", "reason", "said"), whole, ids=table)


def rule(steps: tuple[Step, ...], reason: Reason, said: dict[str, Any]) -> tuple[ArbiterRig, Ruling]:
    """Take the steps; the last one is ruled so, and changes nothing if it is refused."""
    bench = ArbiterRig(CommandSettings(speed_limit_mps=SPEED_TOP_MPS, lease_s=10.0))
    bench.play(*steps[:-1])
    before = (bench.arbiter.state, bench.arbiter.setpoint.target, dict(bench.arbiter.latches.details))
    ruling = bench.play(steps[-1])
    assert ruling is not None
    assert ruling.reason is reason, ruling
    assert {name: getattr(ruling, name) for name in said} == said
    after = (bench.arbiter.state, bench.arbiter.setpoint.target, dict(bench.arbiter.latches.details))
    assert reason is Reason.NONE or after == before
    return bench, ruling


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


LEASES: Table = {
    "held by another": (
        ("acquire", 49, "acquire by second"),
        Reason.LEASE_HELD,
        {"detail": "by first, expires in 9.5 s"},
    ),
    "taken from a robot that moves": ((*ENGAGED, *[1.0] * 30, "take by second"), Reason.MOVING),
    "taken with a lower role": (
        (*ENGAGED, *[1.0] * 30, ("take by second", {"override": True, "role": "program"})),
        Reason.ROLE_TOO_LOW,
        {"detail": "first holds it as operator"},
    ),
    "given back and used": ((*ENGAGED, "release", 0.0), Reason.LEASE_RELEASED),
    "a reset keeps it": (("acquire", 800, "reset", 400, 0.0), Reason.NOT_ENGAGED),
    "a drive that is not engaged keeps it": (("acquire", 800, 0.0, 400, "renew"), Reason.NONE),
    "renewed": (("acquire", 800, "renew", 400, "renew"), Reason.NONE, {"expires_ns": 10_000 * MS}),
    "about to expire": (("acquire", 998, 0.0), Reason.NOT_ENGAGED),
    "expired": (("acquire", 999, 0.0), Reason.LEASE_EXPIRED),
}


@rows(LEASES)
def test_who_has_the_lease(steps: tuple[Step, ...], reason: Reason, said: dict[str, Any]) -> None:
    """Rows 'lease' and 'take': exclusive, renewed by what its holder sends, and taken from a robot that stands."""
    rule(steps, reason, said)
    assert reason is not Reason.MOVING or "--take --override" in TEXTS[reason].cure


def test_a_lease_is_of_two_seconds() -> None:
    """Row 'lease: 2 s'."""
    assert ArbiterRig().ask("acquire").expires_ns == 2_000 * MS


TAKEN = ("take by second", {"override": True})
LOST = ("second took the lease from first", "second has taken the lease as operator")


@pytest.mark.parametrize(
    ("steps", "reason", "told"),
    [
        ((*ENGAGED, "release"), Reason.LEASE_RELEASED, ("first gave the lease back",)),
        ((*ENGAGED, *[1.0] * 30, TAKEN), Reason.LEASE_TAKEN, LOST),
        ((*ENGAGING, "take"), Reason.LEASE_TAKEN, ()),
        ((*ENGAGING, "release"), Reason.LEASE_RELEASED, ("first gave the lease back",)),
    ],
)
def test_the_end_of_a_lease_stops_the_robot(
    steps: tuple[Step, ...], reason: Reason, told: tuple[str, ...]
) -> None:
    """Also of one that is being engaged; the events name who lost it and who has it."""
    bench, _ = rule(steps, Reason.NONE, {})
    assert (bench.arbiter.state, bench.arbiter.engagement.stop_reason) == (ArbiterState.STOPPING, reason)
    events = bench.told(EventKind.LEASE)
    assert events[0].text == "first has acquired the lease as operator"
    assert not told or [event.text for event in events[-len(told) :]] == [*told]
    assert not told or events[-len(told)].operator == "first"
    assert events[-1].operator == ("second" if told == LOST else "first")


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


def test_take_of_a_standing_robot_in_standby() -> None:
    """Nothing is stopped that is not told anything; what nobody holds is acquired."""
    bench = ArbiterRig()
    assert bench.ask("take", "second", role="program").reason is Reason.NONE
    assert bench.told(EventKind.LEASE)[-1].text == "second has acquired the lease as program"
    assert bench.ask("take", "first").reason is Reason.NONE
    assert bench.arbiter.state is ArbiterState.STANDBY


# Engage.


def seen(**changes: object) -> tuple[Step, ...]:
    """It is asked to engage a tick after the chassis shows this."""
    return ("acquire", changes, 1, "engage")


ENGAGE: Table = {
    "no bus": (seen(bus_up=False), Reason.BUS_DOWN),
    "no guard": (seen(guarded=False), Reason.UNGUARDED),
    "remote control": (seen(mode=Mode.REMOTE), Reason.HAND_TRANSMITTER),
    "another computer": (seen(commander_ns=80 * MS), Reason.OTHER_COMMANDER),
    "silent feedback": (
        seen(missing=("Auto_GearFeedBack", "Auto_LightFeedback")),
        Reason.FEEDBACK_MISSING,
        {"detail": "Auto_GearFeedBack, Auto_LightFeedback"},
    ),
    "faulty feedback": (seen(faulty=("Auto_GearFeedBack",)), Reason.FEEDBACK_FAULTY),
    "unknown scale": (seen(variant=Variant.UNKNOWN), Reason.VARIANT_UNKNOWN),
    "unconfirmed scale": (seen(confirmed=False), Reason.VARIANT_UNKNOWN),
    "moving": (seen(speed_mps=0.1), Reason.MOVING),
    "moving by a wheel": (seen(fastest_wheel_mps=0.1), Reason.MOVING),
    "bumper": (seen(front_bumper=True), Reason.FRONT_BUMPER),
    "the guard sends": (seen(guard_sends=True), Reason.GUARD),
    "several, the gravest first": (
        ("acquire", "stop by second", *seen(mode=Mode.REMOTE, faulty=("Auto_GearFeedBack",), speed_mps=1.0)[1:]),
        Reason.REMOTE_STOP,
        {"detail": "and hand_transmitter, feedback_faulty"},
    ),
    "a link at the limit": (
        (200, "acquire", ("engage", {"challenge": 100})),
        Reason.NONE,
        {"detail": "", "age_ns": 1_000 * MS},
    ),
    "a link too slow": (
        (200, "acquire", ("engage", {"challenge": 101})),
        Reason.LINK_TOO_SLOW,
        {"detail": "1010 ms, at most 1000 ms", "age_ns": 1_010 * MS},
    ),
    "a challenge forgotten": (
        (200, "acquire", ("engage", {"challenge": 500})),
        Reason.CHALLENGE_UNKNOWN,
        {"detail": "", "age_ns": None},
    ),
    "a challenge to come": (
        (200, "acquire", ("engage", {"challenge": -5})),
        Reason.CHALLENGE_UNKNOWN,
        {"detail": "", "age_ns": None},
    ),
    "a command of 280 ms ago": (("acquire", 0.1, 28, "engage"), Reason.COMMAND_NOT_ZERO),
    "a command of 290 ms ago": (("acquire", 0.1, 29, "engage"), Reason.COMMAND_NOT_ZERO),
    "a command of 310 ms ago": (("acquire", 0.1, 31, "engage"), Reason.NONE),
    "a command of zero": (("acquire", 0.0, 1, "engage"), Reason.NONE),
    "a limit of 0": (("acquire", ("engage", {"speed_limit_mps": 0.0})), Reason.MALFORMED),
    "a limit below 0": (("acquire", ("engage", {"speed_limit_mps": -1.0})), Reason.MALFORMED),
    "no deadman": (("acquire", ("engage", {"deadman_s": 0.0})), Reason.MALFORMED),
    "a short deadman": (("acquire", ("engage", {"deadman_s": 0.04})), Reason.MALFORMED),
    "a long deadman": (("acquire", ("engage", {"deadman_s": 1.01})), Reason.MALFORMED),
    "a deadman below 0": (("acquire", ("engage", {"deadman_s": -1.0})), Reason.MALFORMED),
    "engaging": ((*ENGAGING, "engage"), Reason.ENGAGING),
    "engaged": ((*ENGAGED, "engage"), Reason.ALREADY_ENGAGED),
    "stopping": ((*ENGAGED, "disengage", "engage"), Reason.STOPPING),
}


@rows(ENGAGE)
def test_engage_wants_all_of_the_table(steps: tuple[Step, ...], reason: Reason, said: dict[str, Any]) -> None:
    """Row 'engage: lease held, every feedback seen and fresh, variant confirmed, mode not remote, no latch'.

    And a command of zero in the last 300 ms, a link that is fast enough, and limits that are some.
    """
    bench, ruling = rule(steps, reason, said)
    if reason is Reason.NONE:
        assert ruling.is_pending
        assert bench.arbiter.state is ArbiterState.ENGAGING


@pytest.mark.parametrize(("limit_mps", "in_force_mps"), [(0.5, 0.5), (9.0, 2.222), (None, 2.222)])
def test_engage_may_lower_the_speed_limit(limit_mps: float | None, in_force_mps: float) -> None:
    """Limits scale down, never up, at run time."""
    bench, _ = rule(("acquire", ("engage", {"speed_limit_mps": limit_mps})), Reason.NONE, {"is_pending": True})
    assert bench.arbiter.setpoint.limits.speed_mps == in_force_mps


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


HIT_TWICE: tuple[Step, ...] = ("acquire", {"front_bumper": True}, 60, {}, 30, {"front_bumper": True}, 1, "reset")
NOT_SEEN = {"detail": "it was made before this was to be seen"}
RESET: Table = {
    "at rest": ((*LATCHED, "reset"), Reason.NONE, {"detail": "remote_stop"}),
    "stopping": ((*ENGAGED, "stop by second", "reset"), Reason.STOPPING),
    "moving": ((*LATCHED, {"speed_mps": 0.1}, 1, "reset"), Reason.MOVING),
    "the guard sends": ((*LATCHED, {"guard_sends": True}, 1, "reset"), Reason.GUARD),
    "silent feedback": ((*LATCHED, {"missing": ("Auto_GearFeedBack",)}, 1, "reset"), Reason.FEEDBACK_MISSING),
    "unknown scale": ((*LATCHED, {"variant": Variant.UNKNOWN}, 1, "reset"), Reason.VARIANT_UNKNOWN),
    "a command": ((*LATCHED, 1.0, "reset"), Reason.COMMAND_NOT_ZERO),
    "a command of zero": ((*LATCHED, 1.0, 0.0, "reset"), Reason.NONE),
    "490 ms after the latch": (("acquire", "stop", 48, "reset"), Reason.REMOTE_STOP),
    "500 ms after the latch": (("acquire", "stop", 49, "reset"), Reason.NONE),
    "a challenge of now": ((*LATCHED, 140, ("reset", {"challenge": 0})), Reason.NONE),
    "a challenge of 1 s ago": ((*LATCHED, 140, ("reset", {"challenge": 100})), Reason.NONE),
    "a challenge older than 1 s": ((*LATCHED, 140, ("reset", {"challenge": 101})), Reason.TOO_OLD, NOT_SEEN),
    "a challenge forgotten": ((*LATCHED, 140, ("reset", {"challenge": 500})), Reason.CHALLENGE_UNKNOWN, NOT_SEEN),
    "a challenge after the latch": ((*LATCHED, ("reset", {"challenge": 61})), Reason.NONE),
    "a challenge before the latch": ((*LATCHED, ("reset", {"challenge": 62})), Reason.REMOTE_STOP),
    "nothing latched": (("acquire", 60, ("reset", {"challenge": 20})), Reason.NONE),
    "a bumper hit again": (HIT_TWICE, Reason.FRONT_BUMPER),
    "a bumper held down": ((*HIT_TWICE, 60, "reset"), Reason.NONE),
}


@rows(RESET)
def test_what_a_reset_wants(steps: tuple[Step, ...], reason: Reason, said: dict[str, Any]) -> None:
    """Row 'stop: latched; reset needs the lease, a standing robot, zero command, the cause gone'.

    One that comes at once may have been on its way when the stop came. The bench's challenges are a tick late.
    """
    bench, ruling = rule(steps, reason, said)
    assert ruling.lease == bench.lease
    assert (not bench.arbiter.latches.details) is (reason is Reason.NONE)


def test_reset_clears_what_is_latched() -> None:
    """With an event; and nothing ever resumes by itself."""
    bench = engaged()
    bench.ask("stop", "second")
    stopped(bench)
    assert bench.ask("engage").reason is Reason.REMOTE_STOP
    assert bench.ask("reset", of="second").detail == "remote_stop"
    assert bench.told(EventKind.RESET)[-1].text == "reset: remote_stop"
    assert bench.arbiter.state is ArbiterState.STANDBY
    bench.ask("reset")
    assert bench.told(EventKind.RESET)[-1].text == "reset: nothing was latched"


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


# The rest.


AUXILIARY: Table = {
    "unpark under a command": (("acquire", "engage", 2, 1.0, "unpark"), Reason.COMMAND_NOT_ZERO),
    "park under a command": ((*ENGAGED, *[1.0] * 100, "park"), Reason.COMMAND_NOT_ZERO),
    "lamps": ((*ENGAGED, ("light", {"left": True})), Reason.NONE),
    "horn": ((*ENGAGED, ("horn", {"on": True})), Reason.NONE),
    "odometer": ((*ENGAGED, "clear_odometer"), Reason.NONE, {"is_pending": True}),
    "odometer twice": ((*ENGAGED, "clear_odometer", "clear_odometer"), Reason.BUSY),
    "odometer in motion": ((*ENGAGED, *[1.0] * 30, "clear_odometer"), Reason.MOVING),
}


@rows(AUXILIARY)
def test_what_an_engaged_robot_does_besides(steps: tuple[Step, ...], reason: Reason, said: dict[str, Any]) -> None:
    """What is served is sent together with the five motion frames."""
    bench, _ = rule(steps, reason, said)
    if reason is Reason.NONE and not said:
        asked = {"light": "Auto_LightCmd", "horn": "Auto_SpeakerCmd"}[steps[-1][0]]  # type: ignore[index]
        assert asked in [frame.name for frame in bench.tick().auxiliary]


def test_park_and_unpark() -> None:
    """Row 'rolling: park is accepted at any speed while the command is zero'; unpark at zero command too."""
    bench = engaged()
    assert not bench.arbiter.setpoint.parked
    bench.drive_for(100, 1.0)
    bench.drive(0.0)
    assert bench.arbiter.output.motion.speed_mps > 0.5
    assert bench.ask("park").reason is Reason.NONE
    told = bench.arbiter.output.actuation
    assert told is not None
    assert (told.parking, told.speed_mps, told.gear) == (True, 0.0, GearPosition.DRIVE)


def test_the_odometer_is_told_when_it_is_cleared() -> None:
    """The reply comes later."""
    bench = engaged()
    assert bench.ask("clear_odometer").is_pending
    bench.drive_for(8, 0.0)
    bench.changes = {"total_mileage_km": 0.0}
    answers = [answer for _ in range(5) for answer in bench.tick().answers]
    assert [(answer.verb, answer.ruling.reason) for answer in answers] == [("clear_odometer", Reason.NONE)]


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


NO_NUMBERS: Table = {
    f"{name} {number}": ((*ENGAGED, ("drive", {name: number})), Reason.MALFORMED, {})
    for name in ("speed_mps", "angle_deg")
    for number in (nan, inf, -inf)
}
DRIVE: Table = {
    "standing by": (("acquire", 1.0), Reason.NOT_ENGAGED),
    "engaging, zero": ((*ENGAGING, 0.0), Reason.NONE),
    "engaging": ((*ENGAGING, 1.0), Reason.ENGAGING),
    "stopping": ((*ENGAGING, "disengage", 0.0), Reason.STOPPING),
    "two bends": ((*ENGAGED, ("drive", {"curvature_1pm": 0.1})), Reason.MALFORMED, {"asked": None}),
    "sequence 0": (("acquire", ("drive", {"seq": 0})), Reason.NOT_ENGAGED),
    "sequence 0 again": (("acquire", ("drive", {"seq": 0}), ("drive", {"seq": 0})), Reason.SEQUENCE),
    "sequence 0 of the next lease": (
        ("acquire", ("drive", {"seq": 0}), "release", "acquire", ("drive", {"seq": 0})),
        Reason.NOT_ENGAGED,
    ),
}


@rows(NO_NUMBERS | DRIVE)
def test_what_is_ruled_on_a_drive(steps: tuple[Step, ...], reason: Reason, said: dict[str, Any]) -> None:
    """Each state has its reason; zero is welcome while it is being engaged. No command leaves a speed behind."""
    bench, ruling = rule(steps, reason, said)
    assert bench.arbiter.setpoint.target.speed_mps == 0
    assert "asked" not in said or "exactly one" in ruling.detail


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

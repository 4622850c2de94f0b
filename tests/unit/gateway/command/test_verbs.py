"""The ruling on each verb, in open and in signed mode. Rows are those of ``ArbiterRig``."""

from itertools import pairwise, product

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.command.rulings import Credentials
from schemas.decisions import ArbiterState, Bound, EventKind
from schemas.reasons import Reason
from schemas.subjects import BY_VERB, COMMANDS, Asking, Command
from tests.support.requests import LEASED, REQUESTS
from tests.support.rigs.arbiter import ArbiterRig, begun, play
from tests.support.rigs.steps import rows

ENGAGED = "engaged lease_s:10"
MOVING = "engaged lease_s:10; drive 1 30"
ENGAGING = "ready lease_s:10; acquire; see mode:stop gear:neutral; engage"
LATCHED = "ready lease_s:10; acquire; stop; tick 60"

# The request itself.


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.verb)
def test_a_verb_is_asked_for_in_its_own_way(command: Command) -> None:
    """As a query or as a put; stop as either."""
    wrong = 0 if command.asking is Asking.QUERY else 1
    ruling = ArbiterRig().send(command.verb, b"\x80", handle=wrong)
    if command.verb == "stop":
        assert ruling.reason is Reason.NONE
    else:
        words = f"'{command.verb}' as a {'query' if wrong else 'put'}"
        assert (ruling.reason, ruling.detail) == (Reason.UNKNOWN_VERB, words)


@pytest.mark.parametrize(
    ("verb", "payload", "size", "reason", "most"),
    [
        ("ä" * 99, b"", None, Reason.UNKNOWN_VERB, 32 * 4 + 14),
        ("acquire", b"\x80", 1024, Reason.NONE, 0),
        ("acquire", b"\x80", 1025, Reason.TOO_LARGE, 200),
        ("acquire", b"\x80", 10**7, Reason.TOO_LARGE, 200),
        *(
            ("acquire", payload, None, Reason.MALFORMED, 200)
            for payload in (
                *(b"\xc1", b"\x81", b"\x91" * 1000),
                *map(msgspec.msgpack.encode, ([1, 2], {"role": "king"}, {"more": 1})),
            )
        ),
    ],
)
def test_what_is_no_request_is_refused(
    verb: str, payload: bytes, size: int | None, reason: Reason, most: int
) -> None:
    """With a short reason; a request of more than a kilobyte is not read."""
    rig = ArbiterRig()
    ruling = rig.send(verb, payload, size=size)
    assert ruling.reason is reason
    assert min(1, most) <= len(ruling.detail) <= most
    assert (rig.arbiter.leases.held is None) is (reason is not Reason.NONE)


@pytest.mark.parametrize("command", LEASED, ids=lambda command: command.verb)
def test_every_other_verb_wants_the_lease_in_force(command: Command) -> None:
    """Row 'lease: exclusive'; and what only an engaged robot does is refused before."""
    rig = begun("engaged")
    fields = REQUESTS[command.verb] | {"lease": rig.lease + 1}
    handle = int(command.asking is Asking.QUERY)
    ruling = rig.send(command.verb, msgspec.msgpack.encode(fields), handle=handle)
    assert (ruling.reason, ruling.lease) == (Reason.NO_LEASE, rig.lease + 1)
    own = msgspec.msgpack.encode(fields | {"lease": rig.lease})
    assert rig.send(command.verb, own, "second", handle=handle).reason is Reason.NO_LEASE
    assert rig.arbiter.state is ArbiterState.ENGAGED
    if command.engaged_only:
        rig = begun("ready")
        rig.ask("acquire")
        own = msgspec.msgpack.encode(fields | {"lease": rig.lease})
        assert rig.send(command.verb, own).reason is Reason.NOT_ENGAGED
        assert rig.tick().auxiliary == []


@given(
    verb=st.sampled_from([command.verb for command in COMMANDS]), payload=st.binary(max_size=60), put=st.booleans()
)
def test_no_bytes_raise_or_move(verb: str, payload: bytes, put: bool) -> None:  # noqa: FBT001
    """Any bytes on any command key get a typed refusal, and change nothing."""
    rig = ArbiterRig()
    assert isinstance(rig.send(verb, payload, handle=0 if put else 1).reason, Reason)
    assert rig.arbiter.state is ArbiterState.STANDBY


# The lease.

LEASES = {
    "two seconds": "ready; acquire; = lasts 2",
    "without a name one may only stop": "ready; acquire by nobody; = refused malformed; stop by nobody; = ruled "
    "none; text latch by an unnamed operator",
    "held by another": "ready lease_s:10; acquire; tick 49; acquire by second; = refused lease_held; detail by "
    "first, expires in 9.5 s",
    "taken from a robot that moves": f"{MOVING}; take by second; = refused moving",
    "taken with a lower role": f"{MOVING}; take by second override:true role:program; = refused role_too_low; "
    "detail first holds it as operator",
    "given back and used": f"{ENGAGED}; release; drive; = refused lease_released",
    "a reset keeps it": "ready lease_s:10; acquire; tick 800; reset; tick 400; drive; = refused not_engaged",
    "a drive that is not engaged keeps it": "ready lease_s:10; acquire; tick 800; drive; tick 400; renew; = "
    "ruled none",
    "renewed": "ready lease_s:10; acquire; tick 800; renew; tick 400; renew; = ruled none, lasts 10",
    "about to expire": "ready lease_s:10; acquire; tick 998; drive; = refused not_engaged",
    "expired": "ready lease_s:10; acquire; tick 999; drive; = ruled lease_expired",
    # Its end stops the robot, also while engaging; the events name former and new holder.
    "given back": f"{ENGAGED}; release; = ruled none, stopping, for lease_released, by lease first; text lease "
    "first gave the lease back",
    "given back while engaging": f"{ENGAGING}; release; = stopping, for lease_released, by lease first",
    "taken": f"{MOVING}; take by second override:true; = held second, stopping, for lease_taken, by lease "
    "second, events lease none lease_taken none; text lease second has taken the lease as operator",
    "taken while engaging": f"{ENGAGING}; take; = held first, stopping, for lease_taken",
    "it expires": "engaged lease_s:0.5 deadman_s:0.5; tick 52; = stopping, for lease_expired, by lease first, by "
    "stop first",
    # A robot in standby is not stopped; a free lease is acquired.
    "taken in standby": "ready; take by second role:program; = ruled none; text lease second has acquired the "
    "lease as program; take; = ruled none, standby",
}


@rows(LEASES)
def test_who_has_the_lease(row: str) -> None:
    """Rows 'lease' and 'take': exclusive, renewed by what its holder sends, and taken from a robot that stands."""
    play(row)


# Engage.


def refused(seen: str, reason: str, detail: str = "") -> str:
    """It is asked to engage a tick after the chassis shows this."""
    return f"ready; acquire; see {seen}; tick; engage; = refused {reason}" + f"; detail {detail}" * bool(detail)


ENGAGE = {
    "no bus": refused("bus_up:false", "bus_down"),
    "no guard": refused("guarded:false", "unguarded"),
    "remote control": refused("mode:remote", "hand_transmitter"),
    "another computer": refused("commander_ns:80000000", "other_commander"),
    "silent feedback": refused(
        "missing:Auto_GearFeedBack+Auto_LightFeedback", "feedback_missing", "Auto_GearFeedBack, Auto_LightFeedback"
    ),
    "faulty feedback": refused("faulty:Auto_GearFeedBack", "feedback_faulty"),
    "unknown scale": refused("variant:unknown", "variant_unknown"),
    "unconfirmed scale": refused("confirmed:false", "variant_unknown"),
    "moving": refused("speed_mps:0.1", "moving"),
    "moving by a wheel": refused("fastest_wheel_mps:0.1", "moving"),
    "bumper": refused("front_bumper:true", "front_bumper"),
    "the guard sends": refused("guard_sends:true", "guard"),
    "several, the gravest first": "ready; acquire; stop by second; see mode:remote faulty:Auto_GearFeedBack "
    "speed_mps:1; tick; engage; = refused remote_stop; detail and hand_transmitter, feedback_faulty",
    "a link at the limit": "ready; tick 200; acquire; engage challenge:100; = pending, engaging, age 1000",
    "a link too slow": "ready; tick 200; acquire; engage challenge:101; = refused link_too_slow, age 1010; "
    "detail 1010 ms, at most 1000 ms",
    "a challenge forgotten": "ready; tick 200; acquire; engage challenge:500; = refused challenge_unknown, age "
    "none",
    "a challenge to come": "ready; tick 200; acquire; engage challenge:-5; = refused challenge_unknown, age none",
    "a command of 290 ms ago": "ready; acquire; drive 0.1; tick 29; engage; = refused command_not_zero",
    "a command of 310 ms ago": "ready; acquire; drive 0.1; tick 31; engage; = pending, engaging",
    "a command of zero": "ready; acquire; drive; tick; engage; = pending, engaging",
    **{
        asked: f"ready; acquire; engage {asked}; = refused malformed"
        for asked in (
            *("speed_limit_mps:0.0", "speed_limit_mps:-1.0", "deadman_s:0.0", "deadman_s:0.04"),
            *("deadman_s:1.01", "deadman_s:-1.0"),
        )
    },
    "engaging": f"{ENGAGING}; engage; = refused engaging",
    "engaged": f"{ENGAGED}; engage; = refused already_engaged",
    "stopping": f"{ENGAGED}; disengage; engage; = refused stopping",
    # Limits scale down, never up, at run time.
    **{
        f"a limit of {asked} m/s": f"ready; acquire; engage speed_limit_mps:{asked}; = pending, limit {limit_mps}"
        for asked, limit_mps in ((0.5, 0.5), (9.0, 2.222), ("null", 2.222))
    },
    # The configured deadman is the least.
    **{
        f"a deadman of {asked}": f"ready; acquire; engage deadman_s:{asked}; tick 2; drive; tick {ticks - 1}; = "
        "engaged; tick; = for deadman"
        for asked, ticks in (("null", 31), (0.1, 31), (0.8, 81), (1.0, 101))
    },
    "disengage": "driving 0.5 100; disengage; = ruled none, stopping, told 0.488; disengage; = ruled none, told "
    "0.476, latched; hold 600; disengage; = refused not_engaged",
    **{
        f"barred by {reason}": f"ready signed:true; bar {reason} the file x is missing; acquire; engage; = "
        f"refused {reason}; detail the file x is missing; bar; engage; = pending"
        for reason in ("unauthenticated", "self_test")
    },
}


@rows(ENGAGE)
def test_engage_wants_all_of_the_table(row: str) -> None:
    """Row 'engage', with a command of zero, a link that is fast enough, and valid limits."""
    play(row)


# Reset.

UNSEEN = "detail the reset was sent before this could be seen"
HIT_TWICE = "ready; acquire; see front_bumper:true; tick 60; see; tick 30; see front_bumper:true; tick; reset"
STOPPERS = [
    ("first", "", ""),
    ("second", "", "second"),
    ("second", "third", "second"),
    ("second", "second", ""),
    ("second first", "", "second"),
    ("second third", "second", "third"),
    ("second third", "third", ""),
    ("third second third", "third", ""),
    ("a b c d e f first", "f", ""),
    ("nobody", "", "an unnamed operator"),
    ("nobody", "an_unnamed_operator", ""),
]
RESET = {
    "at rest": f"{LATCHED}; reset; = ruled none, latched, own; detail remote_stop; text reset reset: remote_stop",
    "stopping": f"{ENGAGED}; stop by second; reset; = refused stopping, own",
    **{
        seen: f"{LATCHED}; see {seen}; tick; reset; = refused {reason}, own"
        for seen, reason in [
            ("speed_mps:0.1", "moving"),
            ("guard_sends:true", "guard"),
            ("missing:Auto_GearFeedBack", "feedback_missing"),
            ("variant:unknown", "variant_unknown"),
        ]
    },
    "a command": f"{LATCHED}; drive 1; reset; = refused command_not_zero",
    "a command of zero": f"{LATCHED}; drive 1; drive; reset; = ruled none, latched",
    # An early reset may have been sent before the stop. The rig's challenges are a tick late.
    "490 ms after the latch": "ready; acquire; stop; tick 48; reset; = refused remote_stop, own",
    "500 ms after the latch": "ready; acquire; stop; tick 49; reset; = ruled none, latched",
    "a challenge of now": f"{LATCHED}; tick 140; reset challenge:0; = ruled none, latched",
    "a challenge of 1 s ago": f"{LATCHED}; tick 140; reset challenge:100; = ruled none, latched",
    "a challenge older than 1 s": f"{LATCHED}; tick 140; reset challenge:101; = refused too_old; {UNSEEN}",
    "a challenge forgotten": f"{LATCHED}; tick 140; reset challenge:500; = refused challenge_unknown, own; "
    f"{UNSEEN}",
    "a challenge after the latch": f"{LATCHED}; reset challenge:61; = ruled none, latched",
    "a challenge before the latch": f"{LATCHED}; reset challenge:62; = refused remote_stop, own; {UNSEEN}",
    "nothing latched": "ready; acquire; tick 60; reset challenge:20; = ruled none; text reset reset: nothing was "
    "latched",
    "a bumper hit again": f"{HIT_TWICE}; = refused front_bumper",
    "a bumper held down": f"{HIT_TWICE}; tick 60; reset; = ruled none, latched",
    "what is reset is not engaged": "engaged; stop by second; hold 600; engage; = refused remote_stop; reset "
    "of:second; = ruled none, standby; detail remote_stop",
    # A reset has not seen a stop of the same tick: the stop wins.
    "a second stop in its tick": "ready; acquire; stop; tick 60; together stop by second + reset + engage; = "
    "standby; detail none remote_stop remote_stop",
}
WHOSE = {
    f"of {stoppers}, cleared is {of or 'none'}": "ready lease_s:10; acquire; "
    + "".join(f"stop by {name}; " for name in stoppers.split())
    + f"tick 60; reset{f' of:{of}' * bool(of)}; "
    + (f"= refused stopped_by_other; detail {refused_for}" if refused_for else "= ruled none, latched")
    for stoppers, of, refused_for in STOPPERS
} | {
    # A repeated stop makes its sender the newest, also in the detail, which survives a restart.
    "the last four are named": "ready; "
    + "".join(f"stop by {name}; " for name in "abcdeb")
    + "= events latch remote_stop; latch remote_stop by b, e, d, c, others"
}


@rows(RESET)
def test_what_a_reset_wants(row: str) -> None:
    """Row 'stop: latched; reset needs the lease, a standing robot, zero command, the cause gone'."""
    play(row)


@rows(WHOSE)
def test_a_reset_says_whose_stop_it_clears(row: str) -> None:
    """Row 'reset of a stop by somebody else': the newest of them, else refused with that name."""
    play(row)


# The rest.

AUXILIARY = {
    "unpark under a command": "ready; acquire; engage; tick 2; drive 1; unpark; = refused command_not_zero",
    "park under a command": "driving 1 100; park; = refused command_not_zero",
    # At any speed, while the command is zero.
    "park at speed": "driving 1 100; drive; = unbelow 0.5; park; = ruled none, parking, told 0, gear drive",
    "lamps": f"{ENGAGED}; light left:true; = ruled none, beside Light",
    "horn": f"{ENGAGED}; horn on:true; = ruled none, beside Speaker",
    "odometer": f"{ENGAGED}; clear_odometer; = pending; mark; drive 0 8; see total_mileage_km:0; tick 5; = "
    "answered clear_odometer none",
    "odometer that is not cleared": f"{ENGAGED}; drive 0 6; clear_odometer; mark; drive 0 205; = answered "
    "clear_odometer not_confirmed",
    "odometer twice": f"{ENGAGED}; clear_odometer; clear_odometer; = refused busy",
    "odometer in motion": f"{MOVING}; clear_odometer; = refused moving",
}


@rows(AUXILIARY)
def test_what_an_engaged_robot_does_besides(row: str) -> None:
    """Sent together with the five motion frames. Row 'rolling: park at zero command'."""
    play(row)


# Drive.

DRIVE = {
    **{
        f"{name} {number}": f"{ENGAGED}; drive {name}:{number}; = refused malformed, target 0"
        for name, number in product(("speed_mps", "angle_deg"), ("nan", "inf", "-inf"))
    },
    "standing by": "ready; acquire; drive 1; = refused not_engaged, target 0",
    "engaging, zero": f"{ENGAGING}; drive; = ruled none",
    "engaging": f"{ENGAGING}; drive 1; = refused engaging",
    "stopping": f"{ENGAGING}; disengage; drive; = refused stopping",
    "two bends": f"{ENGAGED}; drive curvature_1pm:0.1; = refused malformed",
    "obeyed, and told with its age": f"{ENGAGED}; drive 1 1 angle_deg:3; = ruled none, own, age 0, target 1 3",
    "sequence 0": "ready; acquire; drive seq:0; = refused not_engaged; drive seq:0; = refused sequence; release; "
    "acquire; drive seq:0; = refused not_engaged",
    # It is strictly rising within a lease.
    **{
        f"sequence {seq} after 50": f"{ENGAGED}; drive 0.5 1 seq:50; drive 1 1 seq:{seq}; = refused sequence, "
        f"target 0.5; detail {seq} after 50; drive 1 1 seq:51; = ruled none"
        for seq in (50, 49)
    },
    # A jump cannot block the holder's own numbers; a new lease starts from the beginning.
    **{
        f"sequence {seq} after 1": f"{ENGAGED}; drive 1 1 seq:{seq}; = refused sequence; detail {seq} after 1, at "
        "most 1000 more; drive 1 1 seq:1001; = ruled none; drive 1 1 seq:1002; = ruled none; release; acquire; "
        "drive seq:1000; = refused sequence; drive seq:999; = unruled sequence"
        for seq in (2**53 - 1, 1002)
    },
    # At the limit it is not refused. What is refused does not renew, nor does its sequence count.
    "as old as may be": "engaged deadman_s:0.5 max_age_s:0.4; tick 40; drive 1 1 challenge:40; = ruled none, age "
    "400, fresh",
    "too old": "engaged deadman_s:0.5 max_age_s:0.4; tick 41; drive 1 1 seq:2 challenge:41; = refused too_old, "
    "age 410, unfresh; detail 410 ms, at most 400 ms; drive 1 1 seq:2; = ruled none",
    # Not published yet, or in another run.
    "an unknown challenge": f"{ENGAGED}; drive 1 1 challenge:-5; = refused challenge_unknown, age none, target 0",
    # A stream that comes too late differs from one that has ended.
    "refused until the deadman": "driving 0.5 60 max_age_s:0.4; drive 0.5 31 challenge:47; = for deadman; text "
    "stop none for 310 ms| 31 commands refused as too old, 470 ms",
}


@rows(DRIVE)
def test_what_is_ruled_on_a_drive(row: str) -> None:
    """Rows 'sequence', 'command age, by echo' and 'deadman'; each state has its reason."""
    play(row)


def test_old_commands_drive_slowly() -> None:
    """Row 'travel delay': down by the normal deceleration, up by the acceleration, and recorded as what bound."""
    rig = begun("driving 2 300")
    motion = rig.arbiter.output
    speeds_mps = [motion.motion.speed_mps]
    for ticks_ago in [70] * 300 + [0] * 300:
        rig.drive(2.0, challenge=ticks_ago)
        limit_mps = rig.arbiter.link.age.speed_limit_mps(rig.now_ns)
        assert limit_mps is not None
        assert (Bound.TRAVEL_DELAY in motion.motion.bounds) is (limit_mps < 2.0)
        speeds_mps.append(motion.motion.speed_mps)
    assert (speeds_mps[0], speeds_mps[300], speeds_mps[-1]) == pytest.approx((2.0, 1.0 / (0.7 + 0.3), 2.0))
    steps_mps = [after - before for before, after in pairwise(speeds_mps)]
    assert (min(steps_mps), max(steps_mps)) == pytest.approx((-0.012, 0.008))


# Signed mode: the grant counts, not what the sender claims.

QUERIES = [verb for verb, command in BY_VERB.items() if command.asking is Asking.QUERY]


@pytest.mark.parametrize("verb", [*QUERIES, "drive"])
@pytest.mark.parametrize(
    "reason", [Reason.PROOF_MISSING, Reason.PROOF_WRONG, Reason.GRANT_REVOKED, Reason.REPLAYED]
)
def test_a_request_whose_proof_does_not_hold_is_refused_with_its_reason(verb: str, reason: Reason) -> None:
    """Every verb but the stop, with any fields."""
    rig = begun("engaged signed:true")
    rig.credentials = Credentials(reason, "so many")
    own = {"lease": rig.lease, "challenge": rig.challenge(), "seq": 99}
    fields = {name: own.get(name, value) for name, value in REQUESTS[verb].items()}
    ruling = rig.send(verb, msgspec.msgpack.encode(fields), handle=0 if verb == "drive" else 1)
    assert (ruling.reason, ruling.detail) == (reason, "so many")
    assert rig.state() == rig.before


def test_without_credentials_nothing_is_accepted() -> None:
    """Unjudged requests are refused; a stop is served, as unproven."""
    rig = begun("ready signed:true")
    rig.credentials = None
    rig.play("acquire; = refused proof_missing; stop; = ruled none; latch remote_stop by first (unproven)")


PROGRAM, NOBODY = "grant role:program", "grant reason:proof_missing"
SIGNED = {
    "the role is the grant's": f"ready signed:true; {PROGRAM}; acquire role:supervisor; = held first program; "
    f"grant; take by second role:program; = held second operator; {PROGRAM}; take role:supervisor; = refused "
    "role_too_low",
    "in open mode it is what people say": "ready; acquire role:supervisor; = held first supervisor",
    # Also where it would not be needed.
    "an override has to be granted": "ready signed:true; take override:true; = refused not_granted; grant "
    "override:true; take override:true; = ruled none",
    # The lowest limit counts: that of the grant, that of the request and the configured one.
    **{
        f"granted {granted}, asked {asked}": f"ready signed:true; grant speed_limit_mps:{granted}; acquire; "
        f"engage speed_limit_mps:{asked}; = limit {limit_mps}"
        for granted, asked, limit_mps in [
            ("null", "null", 2.222),
            (0.7, "null", 0.7),
            (0.7, 0.4, 0.4),
            (0.7, 2.0, 0.7),
            (9.0, "null", 2.222),
            ("null", 0.4, 0.4),
        ]
    },
    **{
        f"a stop by {credentials}": f"driving 0.3 20 signed:true; {credentials}; stop; = ruled none, stopping; "
        f"latch remote_stop {who}"
        for credentials, who in (("grant", "by first"), (NOBODY, "by first (unproven)"))
    },
    # The first word of a stop waits for no proof, so the record says afterwards whose it was; once.
    "proven afterwards": f"driving 0.3 20 signed:true; {NOBODY}; stop; text latch latched until a reset: a "
    f"remote stop was received| by first (unproven); grant; stop; {NOBODY}; stop; grant; stop; latch remote_stop "
    "by first; = events latch remote_stop none; text latch proven: a remote stop was received| by first",
    "a proven stop takes no name from another's": f"ready signed:true; {NOBODY}; stop by vic; grant; stop; latch "
    "remote_stop by first, vic (unproven); = events latch remote_stop",
    # In a controlled way; nothing is latched, and the lease says why to its holder.
    **{
        f"{reason} in a drive": f"driving 0.5 100 signed:true; mark; lose {reason}; = stopping, free; drive 0.5; "
        f"= refused {reason}; tick 100; = falling 0.012, latched, event lease {reason}; until standby; = free"
        for reason in ("grant_revoked", "grant_expired")
    },
    "no holder, no lease to end": "ready signed:true; lose grant_revoked; tick; = standby, events lease",
}


@rows(SIGNED)
def test_what_a_grant_says_counts(row: str) -> None:
    play(row)


def test_the_events_of_a_lease_say_who_lost_it() -> None:
    rig = begun("driving 1 30")
    rig.ask("take", "second", override=True)
    lost = rig.events_of(EventKind.LEASE)[1]
    assert (lost.operator, lost.text) == ("first", "second took the lease from first")

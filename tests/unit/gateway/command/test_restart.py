"""State across a restart or a gap: latches, a gateway at rest, the secret numbers of leases. Rows are scenes."""

from itertools import count

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.choice.chassis import CHASSIS
from gateway.command.flow import CommandFlow, PendingReply
from gateway.command.restart import QUIET_NS, LeaseNumbers, Snapshot, restore, snapshot
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.journal import inputs_of
from gateway.rerun import run_again
from schemas.decisions import LeaseReply, Reply
from schemas.journal import Kind
from schemas.reasons import Reason
from schemas.requests import LEASE_MAX
from tests.support.requests import LEASED, REQUESTS
from tests.support.rigs.gateway import GatewayRig, Operator
from tests.support.rigs.scenes import Scene, play
from tests.support.rigs.steps import rows

QUIET = f"wait {QUIET_NS / 1e9 + 0.1}"

CARRIED = {
    **{
        reason: f"driving 1; {strike}; rest; = latched {reason}; ask release; {QUIET}; = may_restart; restart; = "
        f"latched {reason}; text latch {words}; operator second; reply acquire none; reply engage {reason}; reply "
        f"reset none{of}; engage"
        for reason, strike, words, of in [
            ("remote_stop", "send stop stranger", "by stranger", " of:stranger"),
            ("front_bumper", "bumper front on for 100ms", "front bumper", ""),
            (
                "guard",
                "links guard_stops:1 guard_says:it_was_late; tick 1; links guard_stops:1",
                "it was late",
                "",
            ),
        ]
    },
    "nothing": f"ready; {QUIET}; restart; = latched",
}


@rows(CARRIED)
def test_what_is_latched_stays_latched_until_a_reset(row: str) -> None:
    """With its reason and its words; it is no hindrance to a restart, and a restart is none to a reset."""
    play(row)


NEEDED = {
    # For longer than it takes to be quiet: what was asked last is forgotten, the lease is not.
    "holds the lease": f"reply acquire none; {QUIET}; = holder first",
    "asks in vain": "send drive stranger; tick 1",
    "the bus is lost": f"links bus_up:0 bus_losses:1; {QUIET}",
    "not seen to stand": f"silence Auto_WheelSpdFeedback; {QUIET}",
    "moves": f"transmitter remote; sticks 0.5 0; {QUIET}",
    "a stop waits for its turn": f"transmitter remote; wait 0.5; send stop stranger; {QUIET}",
    "it ends": f"shutdown; {QUIET}",
    "owes a stop": "owe",
    "the horn was left on": "sound",
}


@pytest.mark.parametrize("disturbed", NEEDED.values(), ids=NEEDED)
def test_a_gateway_that_is_needed_does_not_start_again(disturbed: str) -> None:
    """Somebody commands the robot or asks, it is not seen to stand, or a stop waits for its turn."""
    play(f"ready lease_s:9.2; {QUIET}; = may_restart; {disturbed}; = unmay_restart")


def test_a_busy_computer_does_not_keep_a_gateway_from_starting_again() -> None:
    """Events of a late loop do not count as requests."""
    play(f"ready; {QUIET}" + "; lag 100; tick 1; lag 0; wait 0.5; = may_restart, event fault loop_late" * 20)


def test_a_chassis_that_was_left_with_a_command_is_not_left_alone() -> None:
    """The remote control took it over in a drive, and may give it back: the guard needs the gateway for that."""
    play(
        f"driving 1; transmitter remote; wait 1; reply release none; {QUIET}; = unmay_restart; transmitter "
        f"command; wait 2; = for found_moving; {QUIET}; = may_restart"
    )


def test_the_journal_of_the_second_run_begins_with_what_was_carried_over() -> None:
    """Run again from it, the core is latched as it was."""
    scene = Scene("driving 1")
    scene.play(f"send stop stranger; rest; ask release; {QUIET}; restart")
    rig = scene.rig
    said = [one for _, one in rig.recorded if one.subject.startswith("safety/")]
    inputs = [one for journal in rig.journals for one in inputs_of(journal)]
    assert inputs[0][0] == Kind.CARRIED
    again = Core(CHASSIS, rig.settings, "", inputs[0][1], 8)
    repeated = [one for _, samples in run_again(again, inputs) for one in samples]
    repeated = [one for one in repeated if one.subject.startswith("safety/")]
    assert len(repeated) > 10
    assert repeated == said[: len(repeated)]


# A gateway at rest.

RESTED = (
    "ready; engage; drive 0.5 3 1; ask disengage; wait 4; operator second; reply take none override:true; reply "
    f"release none; {QUIET}"
)
NO_REST = {
    # What keeps a gateway from starting again keeps it from rest, too; and more does.
    "asked in vain": "send drive stranger; tick 1",
    "a remote stop": "send stop stranger; wait 7",
    "a bumper": "bumper front on; wait 7",
    "no feedback": "silence Auto_GearFeedBack; wait 1",
}
LAMPS_LEFT = (
    "ready; engage; reply light none headlamp:true; reply light none headlamp:{}; transmitter remote; wait 0.5; "
    # Another computer commands the chassis for a moment: what it was left on is past.
    "reply release none; foreign 18C4D3D0 every 10ms for 50ms; wait 6; = {}at_rest"
)
REST = {why: f"{RESTED}; = at_rest; {disturbed}; = unat_rest" for why, disturbed in NO_REST.items()} | {
    # Those that shine do: the chassis has them on, and the next engagement puts them out.
    "lamps that shine": LAMPS_LEFT.format("true", "un"),
    "lamps that were put out": LAMPS_LEFT.format("false", ""),
    # Who begins there could not know it either.
    "the variant is not known yet": "new; silence Auto_WheelSpdFeedback; wait 6; = unat_rest",
}


@rows(REST)
def test_whatever_goes_on_is_no_rest(row: str) -> None:
    """Each of them would have to be remembered too."""
    play(row)


def rested() -> tuple[GatewayRig, CommandFlow, Snapshot]:
    """A robot at rest after two drivers, and its snapshot."""
    begin, _, steps = RESTED.partition("; ")
    scene = Scene(begin)
    scene.play(steps)
    flow = scene.rig.core.command
    assert flow is not None
    return scene.rig, flow, snapshot(flow)


def test_what_is_remembered_is_restored() -> None:
    """By way of the journal's bytes, and by a flow of the same run that knows nothing."""
    rig, before, memory = rested()
    assert (memory.leases, memory.target_angle_deg, memory.parked, len(memory.sent)) == (2, 3.0, False, 5)
    assert len(memory.challenges) > 50
    read = msgspec.convert(msgspec.msgpack.decode(msgspec.msgpack.encode(memory)), Snapshot)
    assert read == memory
    flow = CommandFlow(CHASSIS, rig.settings, 7)
    restore(flow, read, rig.now_ns)
    assert snapshot(flow) == memory
    assert flow.maker.counters == before.maker.counters
    challenge, published_ns = memory.challenges[-1]
    assert flow.arbiter.link.challenges.age_ns(challenge, published_ns + 5) == 5
    number, reason = memory.ended[-1]
    assert flow.arbiter.leases.refusal(number, "second") is Reason(reason)
    # The next lease has the number that it would have had.
    operator = Operator(rig, "third")
    operator.take_lease()
    given = flow.arbiter.leases.acquire("third", rig.says.lease_role, 0)
    assert not isinstance(given, Reason)
    assert given.id == operator.lease


# The number of a lease is a secret: nothing that the core gets, and so nothing that it publishes, holds it.

ID = 77
NUMBER = 0x1A_2B3C_4D5E_6F70
VERBS = [command.verb for command in LEASED]


def raw(verb: str, payload: bytes, size: int | None = None) -> RawRequest:
    """A request of first's."""
    return RawRequest(0 if verb == "drive" else 5, verb, "first", payload, len(payload) if size is None else size)


def reply(verb: str, lease: int, *, ok: bool = True) -> PendingReply:
    said = LeaseReply(ok, Reason.NONE if ok else Reason.LEASE_HELD, "", "", lease=lease, expires_s=2.0)
    return PendingReply(5, verb, msgspec.msgpack.encode(said))


def held() -> LeaseNumbers:
    """Lease 77 was given, by the number that its holder knows."""
    numbers = LeaseNumbers(iter([NUMBER]).__next__)
    told = msgspec.msgpack.decode(numbers.reply(reply("acquire", ID)).payload)
    assert (told["lease"], told["expires_s"], told["ok"]) == (NUMBER, 2.0, True)
    return numbers


def shows(request: RawRequest) -> bool:
    """The number stands in it, in one of the ways in which a number is written."""
    length = (NUMBER.bit_length() + 7) // 8
    forms = (NUMBER.to_bytes(length, "big"), NUMBER.to_bytes(length, "little"), str(NUMBER).encode())
    return any(form in part for form in forms for part in (request.payload, request.fault.encode()))


@pytest.mark.parametrize("number", [NUMBER, ID, 0, 1, NUMBER - 1, NUMBER + 1, LEASE_MAX])
@pytest.mark.parametrize("verb", VERBS)
def test_the_core_gets_the_identifier_for_the_number_alone(verb: str, number: int) -> None:
    """No other number is a lease, above all not its identifier; all else of the request is as it was sent."""
    sent = REQUESTS[verb] | {"lease": number}
    got = held().admit(raw(verb, msgspec.msgpack.encode(sent)))
    read = msgspec.msgpack.decode(got.payload)
    assert {name: read[name] for name in sent} == sent | {"lease": ID if number == NUMBER else 0}
    assert (got.verb, got.operator, got.fault, shows(got)) == (verb, "first", "", False)


@given(
    verb=st.sampled_from([*VERBS, "acquire", "take", "stop", "dirve", ""]),
    lease=st.sampled_from([NUMBER, float(NUMBER), str(NUMBER), str(NUMBER).encode(), [NUMBER], {"a": NUMBER}]),
    more=st.dictionaries(st.sampled_from(["role", "x"]), st.just(NUMBER)),
    tail=st.binary(max_size=3),
)
def test_a_request_that_nobody_can_read_does_not_show_it(
    verb: str, lease: object, more: dict[str, int], tail: bytes
) -> None:
    """A holder's client with a fault in it gives nothing away: bytes behind, a wrong type, field or verb."""
    payload = msgspec.msgpack.encode(REQUESTS.get(verb, {}) | {"lease": lease, **more}) + tail
    assert not shows(held().admit(raw(verb, payload)))


OWN = msgspec.msgpack.encode({"lease": NUMBER})


@pytest.mark.parametrize(
    ("request_", "fault"),
    [
        # The sender learns what is wrong with it, though the core never sees it.
        (raw("renew", msgspec.msgpack.encode({"lease": -1})), "$.lease"),
        # Nothing in a stop can make it a request that cannot be read.
        *((raw("stop", payload), "") for payload in (b"", b"help", b"\x81\xa5lease", OWN)),
        # Its size is kept; its bytes are not read.
        (raw("renew", OWN, 5000), ""),
        # Of another version, even if this one could read it.
        *((msgspec.structs.replace(raw(verb, OWN), fault="version 7"), "version 7") for verb in VERBS),
    ],
)
def test_what_the_core_need_not_read_it_does_not_get(request_: RawRequest, fault: str) -> None:
    """Its fault and its size go on."""
    got = held().admit(request_)
    assert (got.verb, got.payload, got.size) == (request_.verb, b"", request_.size)
    assert bool(got.fault) is bool(fault)
    assert fault in got.fault


def test_a_renewal_tells_the_same_number_and_a_refusal_none() -> None:
    """A number is drawn once for each lease."""
    numbers = held()
    assert msgspec.msgpack.decode(numbers.reply(reply("renew", ID)).payload)["lease"] == NUMBER
    plain = Reply(ok=True, reason=Reason.NONE, detail="", cure="")
    for other in (reply("take", 0, ok=False), PendingReply(5, "engage", msgspec.msgpack.encode(plain))):
        assert numbers.reply(other) == other


def test_the_lease_in_force_and_those_before_it_are_remembered() -> None:
    """Sixteen ended ones and the newest: the memory is bounded."""
    drawn = count(1000)
    numbers = LeaseNumbers(lambda: next(drawn))
    for lease in range(1, 501):
        numbers.reply(reply("acquire", lease))
    renewals = [raw("renew", msgspec.msgpack.encode({"lease": number})) for number in range(1000, 1500)]
    known = [msgspec.msgpack.decode(numbers.admit(one).payload)["lease"] for one in renewals]
    assert known[-17:] == list(range(484, 501))
    assert set(known[:-32]) == {0}

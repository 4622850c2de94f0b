"""The operator's half of signed mode against the robot's."""

from typing import Any

import msgspec
import pytest

from gateway.authority.operator_proof import ViewerProof, new_lease_key
from gateway.authority.session import UNSIGNED, not_believed
from gateway.command.rulings import RawRequest
from gateway.telemetry.samples import Received
from schemas.authority.trust import Objection, fingerprint
from schemas.command_line import CommandError
from schemas.decisions import LeaseReply, StatementReply
from schemas.messages import SEQUENCE_MAX
from schemas.reasons import Reason
from schemas.subjects import BY_NAME, STATEMENT_REPLY_ENCODING
from tests.support.authority import AUTH, CHALLENGE, NOW_S, QUESTION, AuthorityBench, Fleet, Pair

STATE = BY_NAME["safety/state"]
STATE_KEY = "fleet/cruiser-1/safety/state"


def test_a_viewer_knows_the_robot_and_commands_nothing_but_a_stop() -> None:
    pair = Pair()
    viewer = ViewerProof(pair.bench.fleet.trust, "fleet", lambda: NOW_S)
    raw = RawRequest(1, "", "", viewer.statement, 0, attachment=QUESTION)
    reply = pair.robot.receive(raw, pair.bench.now_ns)
    shown = Received(AUTH, STATEMENT_REPLY_ENCODING, reply.payload, reply.attachment)
    assert viewer.meet("cruiser-2", shown, QUESTION) is not None
    assert viewer.meet("cruiser-1", shown, QUESTION) is None
    assert viewer.believes("cruiser-1", pair.state(1))
    assert viewer.request("cruiser-1", "stop", b"", CHALLENGE) != viewer.request(
        "cruiser-1", "stop", b"", CHALLENGE
    )
    with pytest.raises(CommandError, match="acquire of cruiser-1 needs an operator's key"):
        viewer.request("cruiser-1", "acquire", b"", CHALLENGE)
    assert viewer.drive(b"") == b""


def test_both_meet_and_agree_on_the_key_of_a_lease() -> None:
    pair = Pair()
    assert pair.refusal is None
    credentials, private, request, reply = pair.leased(9)
    assert credentials.reason is Reason.NONE
    assert pair.proof.is_reply("cruiser-1", reply, request)
    # Only verbs to the robot whose lease is held have its tag.
    assert len(pair.proof.request("cruiser-1", "park", b"", CHALLENGE)) == 89
    said = msgspec.msgpack.decode(reply.payload, type=LeaseReply)
    assert pair.proof.begin_lease("cruiser-1", private, said, reply.attachment)
    tagged = pair.proof.request("cruiser-1", "park", b"", CHALLENGE)
    assert len(tagged) == 105
    assert pair.robot.admission.may_be_holders("park", b"", tagged)
    assert len(pair.proof.request("cruiser-2", "park", b"", CHALLENGE)) == 89
    assert pair.drives(9).reason is Reason.NONE
    assert pair.drives(8).reason is Reason.NONE  # the arbiter checks the payload's lease
    assert pair.new_proof().drive(b"") == b""


IMPOSTORS: dict[str, tuple[str, dict[str, Any], Objection | None]] = {
    "it repeats a robot's grant without its key": (
        "cruiser-1",
        {"attachment": b""},
        Objection(Reason.PROOF_MISSING, "the reply is not signed"),
    ),
    "it says something else": ("cruiser-1", {"payload": lambda payload: payload[:-1] + b" "}, None),
    "it says nothing": ("cruiser-1", {"payload": b""}, Objection(Reason.MALFORMED, "Input data was truncated")),
    "it signs something else": (
        "cruiser-1",
        {"attachment": lambda attachment: attachment[:-1] + b"x"},
        Objection(Reason.PROOF_WRONG, "the reply is not the robot's"),
    ),
    "it is another robot": (
        "cruiser-2",
        {},
        Objection(Reason.NOT_GRANTED, "the reply is from cruiser-1, not from cruiser-2"),
    ),
}


@pytest.mark.parametrize("who", IMPOSTORS)
def test_an_impostor_is_not_met(who: str) -> None:
    robot, changes, why = IMPOSTORS[who]
    pair = Pair(met=False)
    shown = pair.shown()
    made = {name: one(getattr(shown, name)) if callable(one) else one for name, one in changes.items()}
    refusal = pair.proof.meet(robot, msgspec.structs.replace(shown, **made), QUESTION)
    assert isinstance(refusal, Objection)
    assert why in {None, refusal}
    assert not pair.proof.has_met(robot)


def test_a_robot_of_another_fleet_and_a_person_who_poses_as_one_are_not_met() -> None:
    pair = Pair(met=False)
    assert isinstance(pair.proof.meet("cruiser-1", Pair(met=False).shown(), QUESTION), Objection)
    own = StatementReply(True, Reason.NONE, "", "", own=pair.proof.statement.decode())  # noqa: FBT003
    posing = msgspec.structs.replace(pair.shown(), payload=msgspec.msgpack.encode(own))
    refusal = pair.proof.meet("ann", posing, QUESTION)
    assert isinstance(refusal, Objection)
    assert refusal.reason is Reason.NOT_GRANTED
    assert not pair.proof.has_met("cruiser-1")
    assert not pair.proof.has_met("ann")


def test_a_robot_that_refuses_the_grant_is_known_all_the_same() -> None:
    pair = Pair(not_after=NOW_S - 3)
    assert isinstance(pair.refusal, Objection)
    assert pair.refusal.reason is Reason.GRANT_EXPIRED
    assert pair.refusal.detail.endswith("it ended 2026-11-18 11:06 UTC, and here it is 2026-11-18 11:06 UTC")
    assert pair.proof.has_met("cruiser-1")
    unmet = pair.proof.unmet("cruiser-1")
    assert unmet is not None
    assert (unmet.is_refusal, unmet.reason) == (True, Reason.GRANT_EXPIRED)
    assert pair.proof.doubt("cruiser-1") == UNSIGNED


def test_a_reply_is_believed_for_the_request_that_it_answers() -> None:
    pair = Pair()
    _, reply, request = pair.ask("renew", b"", b"done")
    assert pair.proof.is_reply("cruiser-1", reply, request)
    assert not pair.proof.is_reply("cruiser-1", reply, pair.proof.request("cruiser-1", "renew", b"", CHALLENGE))
    assert not pair.proof.is_reply("cruiser-2", reply, request)
    for changed in (
        {"payload": b"not done"},
        {"key": "fleet/cruiser-1/@cmd/ann/engage"},
        {"key": "fleet/cruiser-2/@cmd/ann/renew"},
        {"encoding": "other"},
        {"attachment": b""},
    ):
        assert not pair.proof.is_reply("cruiser-1", msgspec.structs.replace(reply, **changed), request)


def test_a_state_is_believed_from_the_robot_alone() -> None:
    pair = Pair()
    payload = b"\x80"  # any bytes will do
    signed = pair.bench.signer.publication(STATE_KEY, STATE.encoding, payload)
    state = Received(STATE_KEY, STATE.encoding, payload, signed)
    assert pair.proof.is_state("cruiser-1", state)
    assert not pair.proof.is_state("cruiser-2", state)
    good = pair.state(1)
    for changed in ({"payload": b"\x81"}, {"attachment": b""}, {"key": "fleet/cruiser-2/safety/state"}):
        assert not pair.proof.is_state("cruiser-1", msgspec.structs.replace(state, **changed))
    assert not pair.believes(state)
    assert not pair.believes(good, attachment=b"")
    assert not pair.believes(good, payload=payload)
    assert not pair.proof.believes("cruiser-2", msgspec.structs.replace(good, key=good.key.replace("-1", "-2")))
    assert pair.believes(good)


def test_a_reply_that_was_kept_meets_nobody() -> None:
    pair = Pair(met=False)
    kept = pair.shown(b"asked yesterday.")
    for question in (QUESTION, b""):
        refusal = pair.proof.meet("cruiser-1", kept, question)
        assert refusal == Objection(Reason.PROOF_WRONG, "the reply is not the robot's")
    assert not pair.proof.has_met("cruiser-1")
    assert pair.proof.meet("cruiser-1", kept, b"asked yesterday.") is None


@pytest.mark.parametrize(
    ("numbers", "believed"),
    [
        pytest.param((2, 2, 1, 3, 0, 5, 4, 3, 5), [2, 3, 5], id="over a loss"),
        pytest.param(
            (SEQUENCE_MAX - 1, SEQUENCE_MAX, 0, SEQUENCE_MAX, 1, 2 + SEQUENCE_MAX // 2, 1 + SEQUENCE_MAX // 2),
            [SEQUENCE_MAX - 1, SEQUENCE_MAX, 0, 1, 1 + SEQUENCE_MAX // 2],
            id="0 follows the last one",
        ),
    ],
)
@pytest.mark.parametrize("subject", ["safety/state", "state"])
def test_no_state_is_believed_twice_nor_an_older_one(
    subject: str, numbers: tuple[int, ...], believed: list[int]
) -> None:
    pair = Pair()
    kept = {number: pair.state(number, subject) for number in numbers}
    assert [number for number in numbers if pair.believes(kept[number])] == believed
    assert pair.meet(b"again") is None
    assert not pair.believes(kept[believed[-1]])
    assert pair.believes(pair.state(believed[-1] + 1, subject))
    # Each subject has numbers of its own.
    other = {"safety/state": "state", "state": "safety/state"}[subject]
    assert pair.believes(pair.state(0, other))


def test_states_of_another_run_are_not_believed_until_the_robot_says_that_it_is_in_it() -> None:
    """A replayed state of an earlier run is signed too: the robot's reply to a question decides."""
    pair = Pair()
    assert pair.believes(pair.state(1))
    assert not pair.proof.is_to_meet_again("cruiser-1")
    former, later = pair.state(500, boot=b"boot no0"), pair.state(0, boot=b"boot no2")
    for other in (former, later, former):
        assert not pair.believes(other)
        assert pair.proof.is_to_meet_again("cruiser-1")
    # A replayed state does not block those of this run.
    assert pair.believes(pair.state(2))
    # The robot did not restart.
    assert pair.meet(b"again") is None
    assert not pair.proof.is_to_meet_again("cruiser-1")
    assert not pair.believes(pair.state(2))
    assert pair.believes(pair.state(3))
    # The robot restarted: its numbers begin again, and its former states are not valid.
    pair.restart(b"boot no2")
    assert pair.meet(b"and now") is None
    assert pair.believes(later)
    assert not pair.believes(pair.state(4))
    assert not pair.believes(former)


def test_a_flood_of_states_that_were_kept_costs_no_signatures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the first state of another run is verified, since the robot may have restarted."""
    pair = Pair()
    assert pair.believes(pair.state(1))
    looked_at: list[Received] = []
    is_state = pair.proof.is_state

    def look(robot: str, received: Received) -> bool:
        looked_at.append(received)
        return is_state(robot, received)

    monkeypatch.setattr(pair.proof, "is_state", look)
    for other in (pair.state(1), pair.state(500, boot=b"boot no0"), pair.state(501, boot=b"boot no0")):
        assert not pair.believes(other)
    assert len(looked_at) == 1


def test_nobody_but_the_robot_has_it_asked_again() -> None:
    assert not Pair(met=False).proof.is_to_meet_again("cruiser-1")
    pair = Pair()
    other = pair.state(1, boot=b"boot no2")
    assert not pair.believes(other, attachment=other.attachment[:-1] + b"x")
    assert not pair.proof.is_to_meet_again("cruiser-1")


def test_no_key_is_agreed_on_where_one_half_is_missing() -> None:
    pair = Pair()
    _, private, _, reply = pair.leased(9)
    public = new_lease_key()[1]
    for key, attachment in ((public, b""), (None, reply.attachment), (bytes(32), reply.attachment)):
        said = LeaseReply(ok=True, reason=Reason.NONE, detail="", cure="", lease=9, public_key=key)
        assert not pair.proof.begin_lease("cruiser-1", private, said, attachment)
        assert pair.proof.drive(b"") == b""


@pytest.mark.parametrize(
    ("objection", "text", "cure"),
    [
        (
            Objection(Reason.GRANT_EXPIRED, "it ended 2026-11-18 11:06 UTC, and here it is 2026-11-19 11:06 UTC"),
            "the robot's own grant: it ended 2026-11-18 11:06 UTC, and here it is 2026-11-19 11:06 UTC",
            "set this computer's clock if it is wrong; if not, the robot needs a new grant: 'cruiser provision",
        ),
        (
            Objection(Reason.GRANT_UNKNOWN, "x"),
            "the robot's own grant is signed by the authority's key {theirs}, and authority.json here names",
            "if it is a robot of yours, one of the two has files of a former authority: 'cruiser provision",
        ),
        (Objection(Reason.PROOF_WRONG, "the reply is not the robot's"), "the reply is not the robot's", "check"),
    ],
    ids=lambda one: one.reason.value if isinstance(one, Objection) else "",
)
def test_why_a_robot_is_not_believed_is_said_with_the_cure(objection: Objection, text: str, cure: str) -> None:
    bench = AuthorityBench()
    unmet = not_believed(objection, bench.robot.chain, Fleet().trust)
    assert unmet.text.startswith(text.format(theirs=fingerprint(bench.fleet.authority.key)))
    assert unmet.cure.startswith(cure)
    assert (unmet.reason, unmet.is_refusal) == (objection.reason, False)

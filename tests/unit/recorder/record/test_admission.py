"""Who may give a recorder orders in signed mode."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from typing import Any

import pytest

from recorder.record.admission import (
    ALL_ROBOTS,
    CHALLENGE_MAX_NS,
    CHALLENGE_NS,
    GRANTS_KEPT,
    OrderAdmission,
    OrderNote,
    OrderProof,
    SignedOrder,
    refusal_text,
    text_of,
)
from schemas import codec, keys
from schemas.authority.identity import Identity
from schemas.authority.statement import GrantRole, Revocations, TimeStatement, chain_text
from schemas.codec import PayloadFault
from schemas.reasons import Reason
from schemas.recording import Mark, StopRecording
from schemas.requests import Request
from schemas.subjects import RECORDER_BY_VERB
from tests.support.authority import DAY_S, NOW_S, Fleet, Party

ALL_ORDERS = [verb for verb in RECORDER_BY_VERB if verb != "status"]


class Door:
    """A recorder's door, and somebody before it."""

    def __init__(
        self, note: OrderNote | None = None, fleet: Fleet | None = None, robots: Sequence[str] = (ALL_ROBOTS,)
    ) -> None:
        self.fleet = fleet or Fleet()
        numbers = itertools.count(1)

        def draw(size: int) -> bytes:
            return next(numbers).to_bytes(size, "big")

        self.door = OrderAdmission(self.fleet.trust, "fleet", "bench", note or OrderNote(), draw, robots)
        self.now_ns = 0
        self.now_s = NOW_S

    def let_in(self, name: str = "ann", **changes: Any) -> Party:  # noqa: ANN401 - fields of a grant
        party = self.fleet.operator(name, **({"verbs": ALL_ORDERS} | changes))
        self.show(chain_text(party.chain))
        return party

    def show(self, text: str) -> Reason:
        refusal = self.door.show(text.encode(), self.now_s)
        return Reason.NONE if refusal is None else refusal.reason

    def order(self, by: Party, verb: str = "stop", request: Request | None = None, **changes: Any) -> SignedOrder:  # noqa: ANN401
        """An order, signed as it should be, but for the changes."""
        challenge = self.door.challenge(self.now_ns)
        said: dict[str, Any] = {
            "operator": by.name,
            "recorder": "bench",
            "signed_as": verb,
            "challenge": challenge,
        }
        said |= changes
        payload = codec.encode(request or StopRecording())
        key = keys.recorder_command("fleet", said["recorder"], said["operator"], said["signed_as"])
        proof = by.prove(key, RECORDER_BY_VERB[said["signed_as"]].encoding, payload, said["challenge"])
        payload = changes.get("payload", payload)
        decoded = codec.decode_request(RECORDER_BY_VERB[verb], payload)
        assert not isinstance(decoded, PayloadFault)
        return SignedOrder(verb, by.name, payload, changes.get("attachment", proof), decoded)

    def judge(self, order: SignedOrder) -> Reason:
        refusal = self.door.judge(order, self.now_ns, self.now_s)
        return Reason.NONE if refusal is None else refusal.reason


@pytest.mark.parametrize("verb", ["stop", "split", "start"])
def test_who_is_granted_a_verb_may_ask_it(verb: str) -> None:
    """A person, a program, or another recorder."""
    for role in (GrantRole.OPERATOR, GrantRole.SUPERVISOR, GrantRole.PROGRAM, GrantRole.RECORDER):
        door = Door()
        ann = door.let_in(role=role, verbs=[verb])
        assert door.judge(door.order(ann, verb)) is Reason.NONE


def test_the_status_needs_no_proof() -> None:
    """It gives the challenge for everything else."""
    door = Door()
    assert door.judge(SignedOrder("status", "anyone", b"", b"", StopRecording())) is Reason.NONE


@pytest.mark.parametrize("verb", ALL_ORDERS)
@pytest.mark.parametrize("attachment", [b"", b"x", bytes(88), bytes(90), bytes(89)])
def test_no_order_is_obeyed_without_a_proof(verb: str, attachment: bytes) -> None:
    """Nor with something else in its place."""
    door = Door()
    ann = door.let_in()
    request = {"mark": Mark("why", "")}.get(verb)
    assert door.judge(door.order(ann, verb, request, attachment=attachment)) is Reason.PROOF_MISSING


@pytest.mark.parametrize(
    "changes", [{"signed_as": "split"}, {"operator": "bob"}, {"recorder": "other"}, {"payload": b""}]
)
def test_a_proof_is_for_one_order_of_one_operator_to_one_recorder(changes: dict[str, Any]) -> None:
    """Each part of it is signed."""
    door = Door()
    assert door.judge(door.order(door.let_in(), **changes)) is Reason.PROOF_WRONG


def test_every_byte_of_a_proof_counts() -> None:
    """Whichever is changed, the order is refused."""
    door = Door()
    order = door.order(door.let_in())
    for place in range(len(order.attachment)):
        proof = bytearray(order.attachment)
        proof[place] ^= 1
        changed = SignedOrder("stop", "ann", order.payload, bytes(proof), order.request)
        assert door.judge(changed) is not Reason.NONE, place
    assert door.judge(order) is Reason.NONE


def test_an_order_is_obeyed_once() -> None:
    """Not again while its challenge holds, and not afterwards."""
    door = Door()
    order = door.order(door.let_in())
    assert door.judge(order) is Reason.NONE
    for _ in range(10):
        assert door.judge(order) is not Reason.NONE
        door.now_ns += CHALLENGE_NS
        door.door.challenge(door.now_ns)


def test_an_order_that_was_kept_back_is_refused() -> None:
    """Five seconds after its challenge was drawn."""
    door = Door()
    order = door.order(door.let_in())
    door.now_ns = CHALLENGE_MAX_NS + 1
    assert door.judge(order) is Reason.TOO_OLD
    door.door.challenge(door.now_ns)
    assert door.judge(order) is Reason.CHALLENGE_UNKNOWN
    assert door.judge(door.order(door.let_in(), challenge=b"whatever")) is Reason.CHALLENGE_UNKNOWN


def test_a_challenge_is_drawn_each_second_and_holds_for_five() -> None:
    """So that an order may take its time on a thin link."""
    door = Door()
    first = door.door.challenge(0)
    assert door.door.challenge(CHALLENGE_NS - 1) == first
    assert door.door.challenge(CHALLENGE_NS) != first
    order = door.order(door.let_in(), challenge=first)
    door.now_ns = CHALLENGE_MAX_NS
    assert door.judge(order) is Reason.NONE


def test_an_order_to_a_recorder_before_its_restart_is_refused() -> None:
    """The challenges of two runs are never the same: they are random."""
    fleet = Fleet()
    doors = [
        OrderAdmission(fleet.trust, "fleet", "bench", OrderNote(), os.urandom).challenge(0) for _ in range(100)
    ]
    assert len(set(doors)) == 100


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"verbs": ["split"]}, Reason.NOT_GRANTED),
        ({"role": GrantRole.SITE}, Reason.NOT_GRANTED),
        ({"role": GrantRole.ROBOT}, Reason.NOT_GRANTED),
        ({"not_after": NOW_S - 1}, Reason.GRANT_UNKNOWN),
        ({"not_before": NOW_S + 1}, Reason.GRANT_UNKNOWN),
    ],
)
def test_an_order_is_refused_that_the_grant_does_not_allow(changes: dict[str, Any], reason: Reason) -> None:
    """A grant that does not hold is not even taken over."""
    door = Door()
    assert door.judge(door.order(door.let_in(**changes))) is reason


def test_a_grant_of_another_name_or_authority_is_none() -> None:
    """An order names its operator."""
    door = Door()
    ann = door.let_in()
    order = door.order(ann, operator="bob")
    as_bob = SignedOrder("stop", "bob", order.payload, order.attachment, order.request)
    assert door.judge(as_bob) is Reason.NOT_GRANTED
    stranger = Party("eve")
    Fleet().authority.grant(stranger, verbs=ALL_ORDERS)
    assert door.show(chain_text(stranger.chain)) is Reason.GRANT_UNKNOWN
    assert door.judge(door.order(stranger)) is Reason.GRANT_UNKNOWN


@pytest.mark.parametrize(
    ("verb", "request_", "reason"),
    [
        ("mark", Mark("", "cruiser-1"), Reason.NONE),
        ("mark", Mark("", "cruiser-2"), Reason.NOT_GRANTED),
        ("mark", Mark("", ""), Reason.NOT_GRANTED),
        ("stop", StopRecording(), Reason.NOT_GRANTED),
        ("split", StopRecording(), Reason.NOT_GRANTED),
        ("start", StopRecording(), Reason.NOT_GRANTED),
    ],
)
def test_an_order_about_robots_needs_a_grant_for_them(verb: str, request_: Request, reason: Reason) -> None:
    """What others' robots said is not for everybody."""
    door = Door()
    assert door.judge(door.order(door.let_in(robots=["cruiser-1"]), verb, request_)) is reason
    for_all = Door()
    assert for_all.judge(for_all.order(for_all.let_in(), verb, request_)) is Reason.NONE


@pytest.mark.parametrize("verb", ["start", "stop", "split", "mark"])
@pytest.mark.parametrize(
    ("recorded", "granted", "reason"),
    [
        (["cruiser-1"], ["cruiser-1"], Reason.NONE),
        (["cruiser-1", "cruiser-2"], ["cruiser-*"], Reason.NONE),
        (["cruiser-1", "cruiser-2"], ["cruiser-2", "cruiser-1"], Reason.NONE),
        (["cruiser-1", "cruiser-2"], ["cruiser-2"], Reason.NOT_GRANTED),
        (["cruiser-1", ALL_ROBOTS], ["cruiser-*"], Reason.NOT_GRANTED),
        ([ALL_ROBOTS], ["*"], Reason.NONE),
    ],
)
def test_an_order_about_the_whole_recorder_needs_a_grant_for_all_that_it_records(
    verb: str, recorded: list[str], granted: list[str], reason: Reason
) -> None:
    """Whoever may drive one robot does not end the recording of the others."""
    door = Door(robots=recorded)
    request = Mark("", "") if verb == "mark" else StopRecording()
    assert door.judge(door.order(door.let_in(robots=granted), verb, request)) is reason


def test_a_refusal_names_the_robots_that_the_grant_is_not_for() -> None:
    """And says of a mark what would be obeyed."""
    door = Door(robots=["cruiser-1", "cruiser-2"])
    order = door.order(door.let_in(robots=["cruiser-1"]), "mark", Mark("", ""))
    refusal = door.door.judge(order, door.now_ns, door.now_s)
    assert refusal is not None
    assert "not for cruiser-2; name a robot" in refusal_text(refusal)


def test_who_was_revoked_is_refused_at_once_and_after_a_restart() -> None:
    """The recorder keeps the list; an older one changes nothing."""
    door = Door()
    ann = door.let_in()
    assert door.show(door.fleet.authority.revoke(2, keys=(ann.key,)).text()) is Reason.NONE
    assert door.judge(door.order(ann)) is Reason.GRANT_REVOKED
    assert door.show(door.fleet.authority.revoke(1).text()) is Reason.REPLAYED
    again = Door(door.door.note, door.fleet)
    assert again.show(chain_text(ann.chain)) is Reason.GRANT_REVOKED
    assert again.show(door.fleet.authority.revoke(1).text()) is Reason.REPLAYED


def test_an_epoch_never_falls_not_even_across_a_restart() -> None:
    """A newer list of a lower epoch lets nobody in again."""
    door = Door()
    ann = door.let_in(epoch=1)
    door.show(door.fleet.authority.revoke(1, epoch=2).text())
    door.show(door.fleet.authority.revoke(2).text())
    assert door.judge(door.order(ann)) is Reason.GRANT_REVOKED
    assert Door(door.door.note, door.fleet).show(chain_text(ann.chain)) is Reason.GRANT_REVOKED


def test_lists_do_not_pile_up() -> None:
    """Of those that follow each other one is kept."""
    door = Door()
    for serial in range(1, 20):
        door.show(door.fleet.authority.revoke(serial).text())
    assert len(door.door.note.statements) == 1


def test_after_a_rotation_the_new_authority_counts_and_after_a_restart_too() -> None:
    """With what the former one had revoked before in force or not, the recorder starts again."""
    door, new, standby = Door(), Party("new"), Party("next")
    ann = door.let_in()
    door.show(door.fleet.authority.revoke(1).text())
    assert door.show(door.fleet.standby.rotate(1, new, standby).text()) is Reason.NONE
    assert door.judge(door.order(ann)) is Reason.GRANT_REVOKED
    bob = Party("bob")
    new.grant(bob, verbs=ALL_ORDERS)
    for one in (door, Door(door.door.note, door.fleet)):
        assert one.show(chain_text(bob.chain)) is Reason.NONE
        assert one.judge(one.order(bob)) is Reason.NONE


def test_a_grant_ends_by_the_latest_time_that_is_known() -> None:
    """A recorder's clock that is set back revives nothing that a list was signed after."""
    door = Door()
    ann = door.let_in(not_after=NOW_S - 1, not_before=NOW_S - DAY_S)
    door.now_s = NOW_S - 100
    door.show(chain_text(ann.chain))
    assert door.judge(door.order(ann)) is Reason.NONE
    door.show(door.fleet.authority.revoke(1).text())
    assert door.judge(door.order(ann)) is Reason.GRANT_EXPIRED


def test_a_verified_grant_lifts_the_floor_of_time_across_a_restart() -> None:
    """It has begun, so it is later than that: a clock that is set back revives no grant of before."""
    door = Door()
    old = door.let_in("old", not_before=NOW_S - 9 * DAY_S, not_after=NOW_S - 8 * DAY_S)
    door.let_in("new", not_before=NOW_S - DAY_S)
    assert door.door.note.floor_s == NOW_S - DAY_S
    again = Door(door.door.note, door.fleet)
    for one in (door, again):
        one.now_s = NOW_S - 8 * DAY_S - DAY_S // 2
        assert one.show(chain_text(old.chain)) is Reason.GRANT_EXPIRED
    fresh = Door(fleet=door.fleet)
    fresh.now_s = NOW_S - 8 * DAY_S - DAY_S // 2
    assert fresh.show(chain_text(old.chain)) is Reason.NONE


def test_a_grant_that_is_not_the_authoritys_lifts_no_floor() -> None:
    """Else anybody could end all grants."""
    door, stranger = Door(), Party("eve")
    Fleet().authority.grant(stranger, verbs=ALL_ORDERS, not_before=NOW_S - 1)
    assert door.show(chain_text(stranger.chain)) is Reason.GRANT_UNKNOWN
    assert door.let_in(not_before=NOW_S + DAY_S)
    assert door.door.note.floor_s == 0


def test_a_new_authority_says_what_time_it_is() -> None:
    """A thief of the former one's key may have signed any time."""
    door, new, standby, bob = Door(), Party("new"), Party("next"), Party("bob")
    door.show(door.fleet.authority.sign(Revocations(serial=9, at=NOW_S + 1000 * DAY_S)).text())
    new.grant(bob, verbs=ALL_ORDERS)
    assert door.show(door.fleet.standby.rotate(1, new, standby).text()) is Reason.NONE
    for one in (door, Door(door.door.note, door.fleet)):
        assert one.show(chain_text(bob.chain)) is Reason.NONE
        assert one.judge(one.order(bob)) is Reason.NONE


@pytest.mark.parametrize("text", ["", "junk", "{}\ned25519 00 00\n"])
def test_what_is_no_statement_is_refused(text: str) -> None:
    """Whoever shows it."""
    assert Door().show(text) is Reason.MALFORMED


def test_a_recorder_takes_no_time_from_anybody() -> None:
    """It has a clock."""
    door = Door()
    said = door.fleet.authority.sign(TimeStatement(challenge="00" * 8, at=NOW_S + DAY_S))
    assert door.show(said.text()) is Reason.NOT_GRANTED


def test_only_so_many_grants_are_known_at_a_time() -> None:
    """The one that was not used for longest goes."""
    door = Door()
    ann = door.let_in()
    for number in range(GRANTS_KEPT):
        door.let_in(f"p{number}")
    assert door.judge(door.order(ann)) is Reason.GRANT_UNKNOWN


def test_what_an_operator_signs_is_obeyed() -> None:
    """The other half: ``cruiser record stop`` and the rest."""
    door = Door()
    ann = door.fleet.operator("ann", verbs=ALL_ORDERS)
    proof = OrderProof(Identity(ann.private, ann.chain, door.fleet.trust), "fleet", os.urandom)
    assert proof.name == "ann"
    assert door.show(proof.statement.decode()) is Reason.NONE
    payload = codec.encode(StopRecording())
    attachment = proof.attachment("bench", "stop", payload, door.door.challenge(0))
    assert door.judge(SignedOrder("stop", "ann", payload, attachment, StopRecording())) is Reason.NONE


def test_a_refusal_says_what_would_help() -> None:
    """With the reason's name, for those who look it up."""
    refusal = Door().door.judge(SignedOrder("stop", "ann", b"", b"", StopRecording()), 0, NOW_S)
    assert refusal is not None
    assert "(proof_missing). Cure: " in refusal_text(refusal)


def test_no_refusal_of_a_recorder_speaks_of_the_robot() -> None:
    """Who asked it would look in the wrong place."""
    said = [
        text
        for reason in (
            Reason.MALFORMED, Reason.PROOF_MISSING, Reason.PROOF_WRONG, Reason.CHALLENGE_UNKNOWN, Reason.TOO_OLD,
            Reason.REPLAYED, Reason.GRANT_UNKNOWN, Reason.GRANT_EXPIRED, Reason.GRANT_REVOKED, Reason.NOT_GRANTED,
        )
        for text in (text_of(reason).means, text_of(reason).cure)
    ]  # fmt: skip
    assert not [text for text in said if "robot" in text]

"""Who counts as a gateway of this robot's name: who proves that the name was granted to it, and nobody else."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.authority.robot_authority import NameProof
from gateway.authority.session import RobotSigner
from schemas.authority.proof import ROBOT_PROOF_BYTES, GrantRole, chain_text
from schemas.settings import Settings
from tests.support.authority import DAY_S, NOW_S, AuthorityBench, Fleet, Party

PAYLOAD = b"\x80"
QUESTION = bytes(range(16))

BENCH = AuthorityBench()


def proof_of(party: Party) -> NameProof:
    """The proof that a gateway with the keys of this party gives."""
    signer = RobotSigner(party.private, b"boot no2")
    return NameProof(Settings(), signer, BENCH.authority.admission, lambda: party.chain)


def granted(fleet: Fleet, name: str = "cruiser-1", **changes: Any) -> Party:  # noqa: ANN401 - fields of a grant
    """A robot with a new key, and a grant."""
    robot = Party(name)
    fleet.authority.grant(robot, **({"role": GrantRole.ROBOT, "robots": [name]} | changes))
    return robot


def counts(party: Party, now_s: int = NOW_S) -> bool:
    """Does the answer of this party's gateway count at the robot?"""
    attachment = proof_of(party).attachment(PAYLOAD, QUESTION)
    return BENCH.authority.name_proof.is_namesake(PAYLOAD, attachment, QUESTION, now_s)


def test_a_gateway_with_the_same_keys_is_a_namesake() -> None:
    """Also where its grant is over, and whatever the clocks say: the key is enough."""
    assert counts(BENCH.robot)
    assert counts(BENCH.robot, now_s=0)
    assert counts(BENCH.robot, now_s=NOW_S + 99 * DAY_S)


def test_a_gateway_with_another_key_and_a_grant_for_the_name_is_a_namesake() -> None:
    """The robot got a new computer, and the old one is still on."""
    assert counts(granted(BENCH.fleet))
    assert counts(granted(BENCH.fleet), now_s=0)


@pytest.mark.parametrize(
    "other",
    [
        granted(BENCH.fleet, "cruiser-2"),
        granted(BENCH.fleet, "cruiser-2", robots=["*"]),
        granted(Fleet()),
        granted(BENCH.fleet, role=GrantRole.OPERATOR),
        granted(BENCH.fleet, not_after=NOW_S - 1),
    ],
)
def test_nobody_else_is(other: Party) -> None:
    """Another robot, one of another fleet, a person of that name, a robot whose grant is over.

    Nor is any of them who shows the robot's own chain, which is public, without its key.
    """
    assert not counts(other)
    other.chain = BENCH.robot.chain
    assert not counts(other)


def test_a_chain_that_cannot_be_read_proves_nothing() -> None:
    """Behind a proof that is well made, with a key of one's own."""
    other = granted(BENCH.fleet)
    proof = RobotSigner(other.private, b"boot no2").reply("key", "encoding", PAYLOAD, QUESTION)
    for chain in (b"", b"no chain", chain_text(other.chain).encode()[:-1] + b"!"):
        assert not BENCH.authority.name_proof.is_namesake(PAYLOAD, proof + chain, QUESTION, NOW_S)


def test_a_revoked_robot_is_none() -> None:
    """A thief of the old computer keeps the new one from nothing."""
    bench = AuthorityBench()
    thief = granted(bench.fleet)
    attachment = NameProof(
        Settings(), RobotSigner(thief.private, b"boot no2"), bench.authority.admission, lambda: thief.chain
    ).attachment(PAYLOAD, QUESTION)
    assert bench.authority.name_proof.is_namesake(PAYLOAD, attachment, QUESTION, NOW_S)
    assert bench.show(bench.fleet.authority.revoke(1, keys=(thief.key,)).text()).ok
    assert not bench.authority.name_proof.is_namesake(PAYLOAD, attachment, QUESTION, NOW_S)


def test_an_answer_answers_one_question() -> None:
    """Whoever kept an answer of the robot itself cannot pass for it later."""
    proof = BENCH.authority.name_proof
    attachment = proof.attachment(PAYLOAD, QUESTION)
    assert proof.is_namesake(PAYLOAD, attachment, QUESTION, NOW_S)
    assert not proof.is_namesake(PAYLOAD, attachment, bytes(16), NOW_S)
    assert not proof.is_namesake(PAYLOAD + b"x", attachment, QUESTION, NOW_S)
    assert not proof.is_namesake(PAYLOAD, b"", QUESTION, NOW_S)
    assert not proof.is_namesake(PAYLOAD, chain_text(BENCH.robot.chain).encode(), QUESTION, NOW_S)


@given(place=st.integers(0, ROBOT_PROOF_BYTES - 1), bit=st.integers(0, 7))
def test_no_bit_of_a_proof_can_be_changed(place: int, bit: int) -> None:
    """Neither the signature nor what is under it."""
    attachment = bytearray(proof_of(BENCH.robot).attachment(PAYLOAD, QUESTION))
    attachment[place] ^= 1 << bit
    assert not BENCH.authority.name_proof.is_namesake(PAYLOAD, bytes(attachment), QUESTION, NOW_S)


@given(st.binary(max_size=400))
def test_whatever_is_answered_breaks_nothing(attachment: bytes) -> None:
    """It comes from anybody."""
    assert not BENCH.authority.name_proof.is_namesake(PAYLOAD, attachment, QUESTION, NOW_S)

"""What a robot signs of itself: states, and the heads of the chains over its records."""

import hashlib

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.authority.signer import RobotSigner
from schemas.authority.chain import CHAINED, FormerHeads, first_link, heads_text, next_link
from schemas.authority.proof import RobotProof
from schemas.authority.trust import fits
from schemas.decisions import ChainHeads

BOOT = b"boot no1"
ROBOT = Ed25519PrivateKey.generate()
KEY = ROBOT.public_key().public_bytes_raw()


def is_signed(heads: ChainHeads) -> bool:
    """Is it the robot's signature?"""
    chains = {one.subject: (one.count, one.head) for one in heads.heads}
    return fits(KEY, heads.signature, heads_text(heads.boot, heads.time_ns, heads.sequence, chains))


def test_a_published_state_is_the_robots_under_its_key_and_no_other() -> None:
    """Nor is it a reply."""
    signer = RobotSigner(ROBOT, BOOT)
    proof = RobotProof.read(signer.publication("fleet/a/safety/state", "encoding", b"payload"))
    assert proof is not None
    assert proof.boot == BOOT
    assert fits(KEY, proof.signature, proof.signed_publication("fleet/a/safety/state", "encoding", b"payload"))
    for key, encoding, payload in (
        ("fleet/b/safety/state", "encoding", b"payload"),
        ("fleet/a/safety/state", "", b""),
    ):
        assert not fits(KEY, proof.signature, proof.signed_publication(key, encoding, payload))
    assert not fits(KEY, proof.signature, proof.signed_reply("fleet/a/safety/state", "encoding", b"payload", b""))


def test_a_head_is_over_all_samples_of_its_subject_in_their_order() -> None:
    """Each subject has a chain of its own."""
    signer = RobotSigner(ROBOT, BOOT)
    signer.record("journal", b"one")
    signer.record("state", b"not in a chain")
    signer.record("safety/event", b"an event")
    signer.record("journal", b"two")
    heads = signer.heads(1234)
    assert is_signed(heads)
    found = {one.subject: (one.count, one.head) for one in heads.heads}
    assert set(found) == set(CHAINED)
    assert found["journal"] == (2, next_link(next_link(first_link(BOOT, "journal"), b"one"), b"two"))
    assert found["safety/decision"] == (0, first_link(BOOT, "safety/decision"))


def test_a_link_is_a_plain_sha256_over_the_head_before_and_the_sample() -> None:
    """So that any language can follow it."""
    assert next_link(bytes(32), b"sample") == hashlib.sha256(bytes(32) + b"sample").digest()


def test_heads_of_another_run_time_or_robot_do_not_fit() -> None:
    """All that a head says is signed."""
    heads = RobotSigner(ROBOT, BOOT).heads(1234)
    chains = {one.subject: (one.count, one.head) for one in heads.heads}
    assert not fits(KEY, heads.signature, heads_text(b"boot no2", 1234, 0, chains))
    assert not fits(KEY, heads.signature, heads_text(BOOT, 1235, 0, chains))
    assert not fits(KEY, heads.signature, heads_text(BOOT, 1234, 1, chains))
    other = chains | {"journal": (1, chains["journal"][1])}
    assert not fits(KEY, heads.signature, heads_text(BOOT, 1234, 0, other))
    assert not is_signed(RobotSigner(Ed25519PrivateKey.generate(), BOOT).heads(1234))


def test_heads_name_those_of_the_run_before() -> None:
    """All of a run name the same ones, under their signature; those of a first run name none."""
    first = RobotSigner(ROBOT, b"boot no0")
    assert first.last_heads == b""
    assert first.heads(1).former == b""
    last = first.heads(2)
    chains = {one.subject: (one.count, one.head) for one in last.heads}
    text = heads_text(b"boot no0", 2, 1, chains)
    assert first.last_heads == FormerHeads(b"boot no0", 1, hashlib.sha256(text).digest()).text()
    second = RobotSigner(ROBOT, BOOT, first.last_heads)
    for heads in (second.heads(3), second.heads(4)):
        chains = {one.subject: (one.count, one.head) for one in heads.heads}
        assert heads.former == first.last_heads
        assert fits(KEY, heads.signature, heads_text(BOOT, heads.time_ns, heads.sequence, chains, heads.former))
        assert not fits(KEY, heads.signature, heads_text(BOOT, heads.time_ns, heads.sequence, chains))


def test_heads_are_numbered() -> None:
    """From 0 on, like every message."""
    signer = RobotSigner(ROBOT, BOOT)
    assert [signer.heads(0).sequence for _ in range(3)] == [0, 1, 2]

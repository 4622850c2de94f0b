"""Test vectors for clients in other languages, compared with docs/authority.md and the code. They never change."""

import hashlib
import hmac
import json
from pathlib import Path
from typing import NamedTuple

import msgspec
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.enrolment import (
    TransportRole,
    bundle_text,
    new_request,
    read_bundle,
    request_fingerprint,
)
from gateway.authority.session import DriveTags, RobotSigner, lease_key, public_bytes
from schemas.authority.proof import RequestProof, StatementFault, body_of, chain_text, prove_request, read_chain
from schemas.decisions import LeaseReply
from schemas.reasons import Reason
from schemas.requests import Acquire, Drive, Park

FILE = Path(__file__).parents[4] / "schemas" / "vectors" / "proof.json"
VECTORS = json.loads(FILE.read_text(encoding="utf-8"))
SEEDS = {name: bytes.fromhex(seed) for name, seed in VECTORS["keys"].items()}
AUTHORITY, ANN, ROBOT = (Ed25519PrivateKey.from_private_bytes(SEEDS[n]) for n in ("authority", "ann", "cruiser-1"))
BOOT, LEASE, CHALLENGE, NONCE = bytes(range(1, 9)), 4711, b"challeng", b"nonce-01"
LEASE_KEY = bytes.fromhex(VECTORS["drive"]["lease_key"])


class Vector(NamedTuple):
    key: str
    encoding: str
    payload: bytes
    signed: bytes
    attachment: bytes


def vector(name: str) -> Vector:
    said = VECTORS[name]
    parts = (bytes.fromhex(said.get(part, "")) for part in ("payload", "signed", "attachment"))
    return Vector(said["key"], said["encoding"], *parts)


def frame(kind: bytes, *parts: bytes) -> bytes:
    """The signed text, by the description in docs/authority.md only."""
    return b"cruiser-auth-1\0" + kind + b"".join(len(part).to_bytes(4, "big") + part for part in parts)


def tag(text: bytes) -> bytes:
    return hmac.digest(LEASE_KEY, text, "sha256")[:16]


@pytest.mark.parametrize(
    ("name", "kind", "size", "head"),
    [
        ("request", b"S", 89, b"challengnonce-01"),
        ("verb", b"S", 105, b"challengnonce-01"),
        ("reply", b"R", 73, BOOT),
        ("publication", b"P", 73, BOOT),
        ("drive", b"M", 25, LEASE.to_bytes(8, "big")),
    ],
)
def test_each_kind_is_laid_out_as_its_page_says(name: str, kind: bytes, size: int, head: bytes) -> None:
    one = vector(name)
    if kind == b"S":
        head = hashlib.sha256(VECTORS["statement"]["body"].encode()).digest()[:8] + head
    fields, proof = one.attachment[: 1 + len(head)], one.attachment[1 + len(head) :]
    assert (len(one.attachment), fields) == (size, b"\1" + head)
    answered = [vector("request").attachment] if name == "reply" else []
    text = frame(kind, one.key.encode(), one.encoding.encode(), fields, one.payload, *answered)
    if kind == b"M":
        assert proof == tag(text)
        return
    assert one.signed == text
    (ANN if kind == b"S" else ROBOT).public_key().verify(proof[:64], text)
    assert proof[64:] == (tag(text) if name == "verb" else b"")


def test_the_code_makes_the_same() -> None:
    request, verb, reply, said, drive = map(vector, ("request", "verb", "reply", "publication", "drive"))
    ours, robots = (X25519PrivateKey.from_private_bytes(SEEDS[f"lease of {who}"]) for who in ("ann", "robot"))
    for private, other in ((ours, robots), (robots, ours)):
        assert lease_key(private, public_bytes(other), BOOT, LEASE, drive.key) == LEASE_KEY
    given = LeaseReply(True, Reason.NONE, "", "", lease=LEASE, expires_s=2.0, public_key=public_bytes(robots))  # noqa: FBT003
    for one, payload in (
        (request, Acquire(public_key=public_bytes(ours))),
        (verb, Park(lease=LEASE)),
        (reply, given),
        (drive, Drive(lease=LEASE, seq=1, challenge=CHALLENGE, speed_mps=0.3, angle_deg=-2.5)),
    ):
        assert msgspec.msgpack.encode(payload) == one.payload
    proof = RequestProof(bytes.fromhex(VECTORS["statement"]["id"]), CHALLENGE, NONCE)
    tags, signer = DriveTags(LEASE_KEY, LEASE, drive.key, drive.encoding), RobotSigner(ROBOT, BOOT)
    assert prove_request(ANN, proof, *request[:3]) == request.attachment
    assert prove_request(ANN, proof, *verb[:3]) + tags.verb_tag(verb.signed) == verb.attachment
    assert tags.attachment(drive.payload) == drive.attachment
    assert signer.reply(*reply[:3], request.attachment) == reply.attachment
    assert signer.publication(*said[:3]) == said.attachment


def test_a_statement_a_request_to_be_let_in_and_a_bundle_are_the_same() -> None:
    statement, enrolment, bundle = VECTORS["statement"], VECTORS["enrolment"], VECTORS["bundle"]
    chain = read_chain(statement["text"].encode())
    assert not isinstance(chain, StatementFault)
    [signed] = chain
    text = frame(b"A", statement["body"].encode())
    assert (chain_text(chain), body_of(signed.statement).decode()) == (statement["text"], statement["body"])
    assert (signed.id.hex(), signed.signed) == (statement["id"], text)
    assert (AUTHORITY.sign(text).hex(), statement["signed"]) == (statement["signature"], text.hex())
    request = new_request(TransportRole.OPERATOR, ["ann"], "", ANN, None)
    assert json.loads(msgspec.json.encode(request)) == enrolment["request"]
    assert (request.signed().hex(), request_fingerprint(request)) == (
        enrolment["signed"],
        enrolment["fingerprint"],
    )
    certified = msgspec.structs.replace(request, names=["one.example", "10.0.0.5"], csr="csr", key=None)
    assert certified.signed().hex() == enrolment["signed_with_csr"]
    read = read_bundle(bundle["text"].encode(), 1_795_000_000)
    assert (read.fingerprint, bundle_text(read, AUTHORITY).decode()) == (bundle["fingerprint"], bundle["text"])

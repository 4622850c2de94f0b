"""Test vectors of the proofs, for other languages: ``python -m tests.support.proof_vectors`` writes them.

All keys and nonces are fixed, so Ed25519 and HMAC give the same bytes each time. Bytes are hexadecimal.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Final

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey

from gateway.authority.enrolment import (
    Bundle,
    EnrolmentRole,
    FleetPlace,
    bundle_text,
    new_request,
    request_fingerprint,
)
from gateway.authority.session import DriveTags, RobotSigner, lease_key, public_bytes
from schemas import keys
from schemas.authority.proof import (
    Grant,
    GrantRole,
    ProofKind,
    RequestProof,
    RobotProof,
    Signed,
    body_of,
    chain_text,
    signed_bytes,
    statement_id,
)
from schemas.authority.trust import AuthorityKeys
from schemas.decisions import LeaseReply
from schemas.reasons import Reason
from schemas.requests import Acquire, Drive, Park
from schemas.subjects import BY_NAME, BY_VERB

FILE: Final = Path(__file__).parents[2] / "schemas" / "vectors" / "proof.json"

ROOT, ROBOT, OPERATOR = "fleet", "cruiser-1", "ann"
LEASE: Final = 4711
BOOT: Final = b"\x01\x02\x03\x04\x05\x06\x07\x08"
CHALLENGE: Final = b"challeng"
NONCE: Final = b"nonce-01"


def seed(name: str) -> bytes:
    """A private key that everybody knows: SHA-256 of its name."""
    return hashlib.sha256(f"cruiser test key {name}".encode()).digest()


def vectors() -> dict[str, Any]:
    """Everything that a client has to make or to check, once."""
    authority, operator, robot = (
        Ed25519PrivateKey.from_private_bytes(seed(n)) for n in ("authority", OPERATOR, ROBOT)
    )
    grant = Grant(
        serial=17,
        name=OPERATOR,
        key=operator.public_key().public_bytes_raw().hex(),
        role=GrantRole.OPERATOR,
        robots=["cruiser-*"],
        verbs=["acquire", "drive"],
        speed_limit_mps=0.8,
        not_before=1_795_000_000,
        not_after=1_795_043_200,
    )
    body = body_of(grant)
    signature = authority.sign(signed_bytes(ProofKind.STATEMENT, body))
    signed = Signed(body, authority.public_key().public_bytes_raw(), signature, grant)
    return {
        "keys": {
            name: seed(name).hex() for name in ("authority", OPERATOR, ROBOT, "lease of ann", "lease of robot")
        },
        "statement": {
            "body": body.decode(),
            "signed": signed.signed.hex(),
            "signature": signature.hex(),
            "id": statement_id(body).hex(),
            "text": chain_text([signed]),
        },
        **_lease(signed, operator, robot),
        "publication": _publication(robot),
        "enrolment": _enrolment(operator),
        "bundle": _bundle(signed, authority),
    }


def _lease(signed: Signed, operator: Ed25519PrivateKey, robot: Ed25519PrivateKey) -> dict[str, Any]:
    """A request for the lease, the reply, the key of the lease, and a drive command under it."""
    ours, robots = (X25519PrivateKey.from_private_bytes(seed(f"lease of {who}")) for who in (OPERATOR, "robot"))
    acquire, command = keys.command(ROOT, ROBOT, OPERATOR, "acquire"), BY_VERB["acquire"]
    request = msgspec.msgpack.encode(Acquire(public_key=public_bytes(ours)))
    proof = RequestProof(signed.id, CHALLENGE, NONCE)
    text = proof.signed(acquire, command.encoding, request)
    attachment = msgspec.structs.replace(proof, signature=operator.sign(text)).attachment()
    reply = msgspec.msgpack.encode(
        LeaseReply(True, Reason.NONE, "", "", lease=LEASE, expires_s=2.0, public_key=public_bytes(robots))  # noqa: FBT003
    )
    signer = RobotSigner(robot, BOOT)
    drive = keys.command(ROOT, ROBOT, OPERATOR, "drive")
    payload = msgspec.msgpack.encode(Drive(lease=LEASE, seq=1, challenge=CHALLENGE, speed_mps=0.3, angle_deg=-2.5))
    key = lease_key(ours, public_bytes(robots), BOOT, LEASE, drive)
    if key is None:
        raise AssertionError("a key that was drawn properly")
    tags = DriveTags(key, LEASE, drive, BY_VERB["drive"].encoding)
    return {
        "request": {
            "key": acquire,
            "encoding": command.encoding,
            "payload": request.hex(),
            "signed": text.hex(),
            "attachment": attachment.hex(),
        },
        "reply": {
            "key": acquire,
            "encoding": command.reply_encoding,
            "payload": reply.hex(),
            "signed": RobotProof(BOOT).signed_reply(acquire, command.reply_encoding, reply, attachment).hex(),
            "attachment": signer.reply(acquire, command.reply_encoding, reply, attachment).hex(),
        },
        "verb": _verb(signed, operator, tags),
        "drive": {
            "lease_key": key.hex(),
            "key": drive,
            "encoding": BY_VERB["drive"].encoding,
            "payload": payload.hex(),
            "attachment": tags.attachment(payload).hex(),
        },
    }


def _verb(signed: Signed, operator: Ed25519PrivateKey, tags: DriveTags) -> dict[str, str]:
    """A verb under the lease, with its tag."""
    park, command = keys.command(ROOT, ROBOT, OPERATOR, "park"), BY_VERB["park"]
    payload = msgspec.msgpack.encode(Park(lease=LEASE))
    proof = RequestProof(signed.id, CHALLENGE, NONCE)
    text = proof.signed(park, command.encoding, payload)
    attachment = msgspec.structs.replace(
        proof, signature=operator.sign(text), tag=tags.verb_tag(text)
    ).attachment()
    return {
        "key": park,
        "encoding": command.encoding,
        "payload": payload.hex(),
        "signed": text.hex(),
        "attachment": attachment.hex(),
    }


def _enrolment(operator: Ed25519PrivateKey) -> dict[str, Any]:
    """A request to be let in, as a browser makes it; and the text of one that has a request for a certificate."""
    request = new_request(EnrolmentRole.OPERATOR, [OPERATOR], "", operator, None)
    certified = msgspec.structs.replace(request, names=["one.example", "10.0.0.5"], csr="csr", key=None)
    return {
        "request": json.loads(msgspec.json.encode(request)),
        "signed": request.signed().hex(),
        "fingerprint": request_fingerprint(request),
        "signed_with_csr": certified.signed().hex(),
    }


def _bundle(grant: Signed, authority: Ed25519PrivateKey) -> dict[str, str]:
    """The authority's answer to it, with two routers."""
    standby = Ed25519PrivateKey.from_private_bytes(seed("standby")).public_key().public_bytes_raw()
    bundle = Bundle(
        role=EnrolmentRole.OPERATOR,
        name=OPERATOR,
        authority=AuthorityKeys(grant.signer.hex(), standby.hex()),
        fleet=FleetPlace(ROOT, ["tls/router.example:7447", "quic/10.0.0.5:7447"]),
        certificate="",
        ca="ca",
        chain=chain_text([grant]),
    )
    return {"text": bundle_text(bundle, authority).decode(), "fingerprint": bundle.fingerprint}


def _publication(robot: Ed25519PrivateKey) -> dict[str, str]:
    subject = BY_NAME["safety/state"]
    key, payload = keys.build(ROOT, ROBOT, subject), b"\x80"
    return {
        "key": key,
        "encoding": subject.encoding,
        "payload": payload.hex(),
        "signed": RobotProof(BOOT).signed_publication(key, subject.encoding, payload).hex(),
        "attachment": RobotSigner(robot, BOOT).publication(key, subject.encoding, payload).hex(),
    }


def text() -> str:
    """The file."""
    return json.dumps(vectors(), indent=2) + "\n"


if __name__ == "__main__":
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(text(), encoding="utf-8")

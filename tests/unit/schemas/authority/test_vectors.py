"""The test vectors that clients in other languages are held against."""

import hashlib
import hmac
import json

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from tests.support.proof_vectors import BOOT, FILE, LEASE, ROBOT, text

VECTORS = json.loads(FILE.read_text(encoding="utf-8"))


def test_the_vectors_are_what_the_code_gives() -> None:
    """If this fails, ``python -m tests.support.proof_vectors`` writes them anew, and every client changes."""
    assert FILE.read_text(encoding="utf-8") == text()


def frame(kind: bytes, *parts: bytes) -> bytes:
    """The signed text, by the description in docs/proof.md and by nothing else."""
    return b"cruiser-auth-1\0" + kind + b"".join(len(part).to_bytes(4, "big") + part for part in parts)


def test_a_request_is_laid_out_as_its_page_says() -> None:
    """Version, grant, challenge, nonce, signature."""
    request = {
        name: bytes.fromhex(value) for name, value in VECTORS["request"].items() if name not in {"key", "encoding"}
    }
    attachment = request["attachment"]
    assert (len(attachment), attachment[0]) == (89, 1)
    assert attachment[1:9] == hashlib.sha256(VECTORS["statement"]["body"].encode()).digest()[:8]
    assert attachment[9:25] == b"challengnonce-01"
    key, encoding = (VECTORS["request"][name].encode() for name in ("key", "encoding"))
    assert request["signed"] == frame(b"S", key, encoding, attachment[:25], request["payload"])
    grant = json.loads(VECTORS["statement"]["body"])
    Ed25519PublicKey.from_public_bytes(bytes.fromhex(grant["key"])).verify(attachment[25:], request["signed"])


def test_a_reply_covers_the_request_that_it_answers() -> None:
    """The last part of the signed text is the attachment of the request."""
    key, encoding = (VECTORS["reply"][name].encode() for name in ("key", "encoding"))
    payload, attachment = (bytes.fromhex(VECTORS["reply"][name]) for name in ("payload", "attachment"))
    request = bytes.fromhex(VECTORS["request"]["attachment"])
    assert (len(attachment), attachment[:9]) == (73, b"\1" + BOOT)
    assert bytes.fromhex(VECTORS["reply"]["signed"]) == frame(
        b"R", key, encoding, attachment[:9], payload, request
    )


def test_a_verb_may_carry_a_tag_under_the_key_of_the_lease() -> None:
    """HMAC-SHA256 over the text that is signed, the first sixteen bytes of it, behind the signature."""
    verb = VECTORS["verb"]
    payload, attachment = bytes.fromhex(verb["payload"]), bytes.fromhex(verb["attachment"])
    assert (len(attachment), attachment[0]) == (105, 1)
    signed = frame(b"S", verb["key"].encode(), verb["encoding"].encode(), attachment[:25], payload)
    assert bytes.fromhex(verb["signed"]) == signed
    assert attachment[89:] == hmac.digest(bytes.fromhex(VECTORS["drive"]["lease_key"]), signed, "sha256")[:16]
    grant = json.loads(VECTORS["statement"]["body"])
    Ed25519PublicKey.from_public_bytes(bytes.fromhex(grant["key"])).verify(attachment[25:89], signed)


def test_a_drive_carries_a_tag_under_the_key_of_the_lease() -> None:
    """HMAC-SHA256 over the framed text, the first sixteen bytes of it."""
    drive = VECTORS["drive"]
    payload, attachment = bytes.fromhex(drive["payload"]), bytes.fromhex(drive["attachment"])
    assert (len(attachment), attachment[:9]) == (25, b"\1" + LEASE.to_bytes(8, "big"))
    signed = frame(b"M", drive["key"].encode(), drive["encoding"].encode(), attachment[:9], payload)
    assert attachment[9:] == hmac.digest(bytes.fromhex(drive["lease_key"]), signed, "sha256")[:16]


def test_a_published_state_is_framed_like_a_reply_without_a_request() -> None:
    """With a kind of its own, so neither passes for the other."""
    said = VECTORS["publication"]
    attachment, payload = bytes.fromhex(said["attachment"]), bytes.fromhex(said["payload"])
    assert bytes.fromhex(said["signed"]) == frame(
        b"P", said["key"].encode(), said["encoding"].encode(), attachment[:9], payload
    )
    assert ROBOT in said["key"]

"""What a robot signs of itself: its states."""

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.authority.session import RobotSigner
from schemas.authority.proof import RobotProof
from schemas.authority.trust import fits

BOOT = b"boot no1"
ROBOT = Ed25519PrivateKey.generate()
KEY = ROBOT.public_key().public_bytes_raw()


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

"""The robot's own signature: replies and states. Pure."""

from __future__ import annotations

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from schemas.authority.proof import RobotProof


class RobotSigner:
    """Signs in the robot's name.

    Attributes:
        boot: random, of this run of the gateway, 8 bytes.
        public_key: the robot's, Ed25519, 32 bytes.
    """

    def __init__(self, private: Ed25519PrivateKey, boot: bytes) -> None:
        """Sign for one run.

        Args:
            private: the robot's key.
            boot: random, 8 bytes.
        """
        self.boot = boot
        self.public_key = private.public_key().public_bytes_raw()
        self._private = private
        self._unsigned = RobotProof(boot)

    def reply(self, key: str, encoding: str, payload: bytes, request: bytes) -> bytes:
        """The attachment of a reply to the request that had this attachment."""
        return self._proof(self._unsigned.signed_reply(key, encoding, payload, request))

    def publication(self, key: str, encoding: str, payload: bytes) -> bytes:
        """The attachment of a published sample."""
        return self._proof(self._unsigned.signed_publication(key, encoding, payload))

    def _proof(self, text: bytes) -> bytes:
        return msgspec.structs.replace(self._unsigned, signature=self._private.sign(text)).attachment()

"""The robot's own signature: replies, states, and the heads of the chains over what it records. Pure."""

from __future__ import annotations

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from schemas.authority.chain import CHAINED, FormerHeads, first_link, heads_text, next_link
from schemas.authority.proof import RobotProof
from schemas.decisions import ChainHead, ChainHeads


class RobotSigner:
    """Signs in the robot's name.

    Attributes:
        boot: random, of this run of the gateway, 8 bytes.
        public_key: the robot's, Ed25519, 32 bytes.
        last_heads: the name of the heads that were signed last, for the next run; empty before the first.
    """

    def __init__(self, private: Ed25519PrivateKey, boot: bytes, former: bytes = b"") -> None:
        """Sign for one run.

        Args:
            private: the robot's key.
            boot: random, 8 bytes.
            former: ``last_heads`` of the run before, as far as they were kept.
        """
        self.boot = boot
        self.last_heads = b""
        self._former = former
        self.public_key = private.public_key().public_bytes_raw()
        self._private = private
        self._unsigned = RobotProof(boot)
        self._heads = {subject: (0, first_link(boot, subject)) for subject in CHAINED}
        self._sequence = 0

    def reply(self, key: str, encoding: str, payload: bytes, request: bytes) -> bytes:
        """The attachment of a reply to the request that had this attachment."""
        return self._proof(self._unsigned.signed_reply(key, encoding, payload, request))

    def publication(self, key: str, encoding: str, payload: bytes) -> bytes:
        """The attachment of a published sample."""
        return self._proof(self._unsigned.signed_publication(key, encoding, payload))

    def record(self, subject: str, payload: bytes) -> None:
        """A sample is published: it becomes a link of its subject's chain, if that has one."""
        if subject in self._heads:
            count, head = self._heads[subject]
            self._heads[subject] = count + 1, next_link(head, payload)

    def heads(self, time_ns: int) -> ChainHeads:
        """The heads of the chains as they are now, signed.

        Args:
            time_ns: since 1970.
        """
        sequence, self._sequence = self._sequence, self._sequence + 1
        text = heads_text(self.boot, time_ns, sequence, self._heads, self._former)
        self.last_heads = FormerHeads.of(self.boot, sequence, text).text()
        return ChainHeads(
            time_ns=time_ns,
            sequence=sequence,
            boot=self.boot,
            heads=[ChainHead(subject, count, head) for subject, (count, head) in self._heads.items()],
            signature=self._private.sign(text),
            former=self._former,
        )

    def _proof(self, text: bytes) -> bytes:
        return msgspec.structs.replace(self._unsigned, signature=self._private.sign(text)).attachment()

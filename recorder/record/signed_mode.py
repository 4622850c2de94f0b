"""Signed mode of a recorder: its signature of each finished log, and verified statements. Pure.

The signature is a file beside the log, ``NAME.mcap.sig``: text that ``sha256sum`` and OpenSSL can check. Its parts
are the name of the format, the log's line of ``sha256sum``, the signature of these two lines (Ed25519, base64),
the recorder's public key (PEM), and the grant of that key. It proves that the recorder wrote the log, not that the
received data was true.

Open mode loads neither this module nor the cryptography.
"""

from __future__ import annotations

import binascii
import re
from base64 import b64decode, b64encode
from typing import Final, Self

import msgspec

from schemas.authority.key_files import Identity
from schemas.authority.proof import KEY_BYTES, Grant, Rotation, Signed, StatementFault, chain_text, read_chain
from schemas.authority.trust import Trust, fits

SIGNATURE_MAX_BYTES: Final = 65_536  # a chain of grants takes a few thousand

_DOMAIN: Final = "cruiser-log-1"
_DER: Final = bytes.fromhex("302a300506032b6570032100")  # stands before an Ed25519 key in DER (RFC 8410)

_FORM: Final = re.compile(
    rf"{_DOMAIN}\n([0-9a-f]{{64}})  ([A-Za-z0-9._-]+)\n([A-Za-z0-9+/]{{86}}==)\n"
    r"-----BEGIN PUBLIC KEY-----\n[A-Za-z0-9+/=]+\n-----END PUBLIC KEY-----\n(\{.*)",
    re.DOTALL,
)


class LogSignature(msgspec.Struct, frozen=True):
    """The signature beside a log.

    Attributes:
        sha256: of the whole log, hexadecimal.
        chain: the recorder's grant, with those of its signers.
    """

    sha256: str
    file: str
    signature: bytes
    chain: list[Signed]

    @property
    def key(self) -> bytes:
        grant = self.chain[0].statement
        return bytes.fromhex(grant.key) if isinstance(grant, Grant) else b""

    @property
    def fits(self) -> bool:
        """True if the grant's key made the signature. Does not check the grant."""
        return fits(self.key, self.signature, signed_text(self.sha256, self.file))

    @classmethod
    def read(cls, data: bytes) -> Self | None:
        """Read a signature; None if it is malformed. The file is untrusted."""
        match = _FORM.fullmatch(data.decode("ascii", "replace"))
        chain = StatementFault("") if match is None else read_chain(match[4].encode())
        if match is None or isinstance(chain, StatementFault):
            return None
        try:
            found = cls(match[1], match[2], b64decode(match[3]), chain)
        except (binascii.Error, ValueError):
            return None
        # Other tools must see exactly what is verified here.
        return found if len(found.key) == KEY_BYTES and found.text() == data else None

    def text(self) -> bytes:
        pem = b64encode(_DER + self.key).decode()
        return (
            signed_text(self.sha256, self.file)
            + f"{b64encode(self.signature).decode()}\n"
            f"-----BEGIN PUBLIC KEY-----\n{pem}\n-----END PUBLIC KEY-----\n{chain_text(self.chain)}".encode()
        )


def signed_text(sha256: str, file: str) -> bytes:
    """The text under the signature: the first two lines of the file."""
    return f"{_DOMAIN}\n{sha256}  {file}\n".encode()


class LogSigner:
    """Signs logs with a recorder's key."""

    def __init__(self, identity: Identity) -> None:
        self._identity = identity

    def sign(self, sha256: str, file: str) -> bytes:
        signature = self._identity.private.sign(signed_text(sha256, file))
        return LogSignature(sha256, file, signature, self._identity.chain).text()


TRUSTS_MAX: Final = 8  # the authority before a rotation, and those after it
VERIFIED_PER_TICK: Final = 2  # statements of up to three signatures: bounds the cost of forged ones


class StatementProofs:
    """Verifies the statements that robots show."""

    def __init__(self, trust: Trust) -> None:
        self._trusts = [trust]
        self._left = VERIFIED_PER_TICK

    def tick(self) -> None:
        self._left = VERIFIED_PER_TICK

    def has(self, text: str) -> bool:
        """True if the authority, or a successor by rotation, signed it; even if it is revoked or expired."""
        if not self._left:
            return False
        chain = read_chain(text.encode())
        if isinstance(chain, StatementFault):
            return False
        keys = {key for trust in self._trusts for key in (trust.active, trust.standby)}
        if chain[-1].signer not in keys:
            return False
        self._left -= 1
        if not any(trust.has_signed(chain) for trust in self._trusts):
            return False
        newer = self._trusts[-1].rotate(chain[0]) if isinstance(chain[0].statement, Rotation) else None
        if isinstance(newer, Trust):
            self._trusts = [*self._trusts[-TRUSTS_MAX + 1 :], newer]
        return True

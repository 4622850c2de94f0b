"""Statements of an authority: grants, revocations, new authorities. JSON under a detached signature.

A signed statement is two lines of text: the JSON, and the signature over exactly these bytes. Earlier versions let
sites grant as well: their grants are followed by the site's own. Such a chain is read, to be refused in words.

    {"kind":"grant","serial":17,"operator":"desk-1",...}
    ed25519 KEY_OF_THE_SIGNER SIGNATURE
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from enum import Enum
from fnmatch import fnmatchcase
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from schemas import keys
from schemas.authority.proof import ProofKind, signed_bytes, statement_id

STATEMENTS_MAX: Final = 3
"""Statements of the longest chain of earlier versions: of a person, a group, and a site."""

TEXT_MAX_BYTES: Final = 16_384
"""No statement with its chain is longer."""

ALGORITHM: Final = "ed25519"

KeyHex = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z", description="public key, Ed25519, hexadecimal")]
IdHex = Annotated[str, Meta(pattern=r"^[0-9a-f]{16}\Z", description="identifier of a grant, hexadecimal")]
Time = Annotated[int, Meta(ge=0, le=2**53 - 1, description="seconds since 1970, UTC")]
Serial = Annotated[int, Meta(ge=0, le=2**53 - 1)]
Delegations = Annotated[int, Meta(ge=0, le=STATEMENTS_MAX - 1)]
RobotPattern = Annotated[str, Meta(pattern=r"^[a-z0-9*-]+\Z", max_length=64)]
NameOfHolder = Annotated[str, Meta(pattern=rf"^{keys.OPERATOR_PATTERN}\Z")]
Verb = Annotated[str, Meta(pattern=r"^[a-z_]+\Z", max_length=32)]


class GrantRole(Enum):
    """The role of a grant's holder. The first three are those of a lease's holder; ``site`` was one."""

    PROGRAM = "program"
    OPERATOR = "operator"
    SUPERVISOR = "supervisor"
    SITE = "site"
    ROBOT = "robot"
    RECORDER = "recorder"


class _Statement(msgspec.Struct, frozen=True, forbid_unknown_fields=True, tag_field="kind", kw_only=True):
    """Unknown fields are an error: one that restricts must not be passed over."""


class Grant(_Statement, frozen=True, forbid_unknown_fields=True, tag="grant", kw_only=True):
    """Permission for one holder to use verbs, on some robots, for a limited time.

    Attributes:
        serial: rises with each grant of its signer; for people.
        name: the holder: an operator's chunk of the command keys, or a robot's.
        key: the holder's.
        robots: patterns of robots' names, ``*`` for any letters.
        verbs: those that the holder may ask of robots.
        override: it may take the lease of a robot that moves.
        speed_limit_mps: the robot drives no faster for this holder; none if absent.
        not_before, not_after: it holds from the first to the second, both included.
        epoch: authorities raise it to end all grants of before at once.
        may_delegate: of earlier versions, read and without effect.
    """

    serial: Serial
    name: NameOfHolder
    key: KeyHex
    role: GrantRole
    robots: Annotated[list[RobotPattern], Meta(max_length=64)]
    verbs: Annotated[list[Verb], Meta(max_length=64)] = []
    override: bool = False
    speed_limit_mps: Annotated[float, Meta(gt=0, le=100)] | None = None
    not_before: Time
    not_after: Time
    epoch: Serial = 0
    may_delegate: Delegations = 0

    def covers(self, robot: str) -> bool:
        """Return True if a robot of this name is among its robots."""
        # ``*`` is the only sign that a pattern may hold which means something to fnmatch; it takes no time that
        # grows with a power of the stars, as a plain regular expression would.
        return any(fnmatchcase(robot, pattern) for pattern in self.robots)


class Revocations(_Statement, frozen=True, forbid_unknown_fields=True, tag="revocations", kw_only=True):
    """All that is revoked now. A list of a higher serial replaces one of a lower; never the other way.

    Attributes:
        at: when it was signed.
        grants: identifiers of grants.
        keys: no grant of these holders counts.
        epoch: no grant of a lower epoch counts.
    """

    serial: Serial
    at: Time
    grants: Annotated[list[IdHex], Meta(max_length=4096)] = []
    keys: Annotated[list[KeyHex], Meta(max_length=4096)] = []
    epoch: Serial = 0


class Rotation(_Statement, frozen=True, forbid_unknown_fields=True, tag="rotation", kw_only=True):
    """The authority's keys from now on. Signed by the standby key, which the robots know.

    Attributes:
        serial: rises with each rotation.
        active, standby: the keys.
        epoch: no grant of a lower epoch counts any more.
    """

    serial: Serial
    at: Time
    active: KeyHex
    standby: KeyHex
    epoch: Serial = 0


Statement = Grant | Revocations | Rotation


class Signed(msgspec.Struct, frozen=True):
    """A statement with its signature, as it was received.

    Attributes:
        body: the signed bytes, JSON.
        signer: the key that the signature is said to be of.
        statement: the decoded body.
    """

    body: bytes
    signer: bytes
    signature: bytes
    statement: Statement

    @property
    def id(self) -> bytes:
        """Its identifier."""
        return statement_id(self.body)

    @property
    def signed(self) -> bytes:
        """The text under the signature."""
        return signed_bytes(ProofKind.STATEMENT, self.body)

    def text(self) -> str:
        """The two lines."""
        return f"{self.body.decode()}\n{ALGORITHM} {self.signer.hex()} {self.signature.hex()}\n"


class StatementFault(msgspec.Struct, frozen=True):
    """A text that is no chain of signed statements. A value: what comes from the wire never raises."""

    detail: str


def body_of(statement: Statement) -> bytes:
    """The JSON of a new statement, to be signed."""
    return _ENCODER.encode(statement)


def read_chain(text: bytes) -> list[Signed] | StatementFault:
    """The statements of a chain, the first one first. Their signatures are not checked here.

    Args:
        text: pairs of lines. Blank lines, and lines that begin with ``#``, say nothing.
    """
    if len(text) > TEXT_MAX_BYTES:
        return StatementFault(f"it is longer than {TEXT_MAX_BYTES} bytes")
    lines = [line for line in text.split(b"\n") if line.strip() and not line.startswith(b"#")]
    if not lines or len(lines) % 2:
        return StatementFault("it is not pairs of lines, a statement and its signature")
    if len(lines) > 2 * STATEMENTS_MAX:
        return StatementFault(f"it has more than {STATEMENTS_MAX} statements")
    chain: list[Signed] = []
    for body, proof in zip(lines[::2], lines[1::2], strict=True):
        match = _PROOF.fullmatch(proof)
        if match is None:
            return StatementFault("a statement is not followed by its signature")
        try:
            statement = _DECODER.decode(body)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            return StatementFault(str(error)[:200])
        chain.append(Signed(body, bytes.fromhex(match[1].decode()), bytes.fromhex(match[2].decode()), statement))
    return chain


def chain_text(chain: Iterable[Signed]) -> str:
    """The text of a chain, as it is kept in files and sent."""
    return "".join(signed.text() for signed in chain)


_PROOF: Final = re.compile(rb"ed25519 ([0-9a-f]{64}) ([0-9a-f]{128})")
_ENCODER: Final = msgspec.json.Encoder()
_DECODER: Final = msgspec.json.Decoder(Statement)

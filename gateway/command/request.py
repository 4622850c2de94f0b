"""A request as it comes from the wire, and what was ruled on it."""

from __future__ import annotations

import msgspec

from gateway.command.motion import Target
from schemas.reasons import TEXTS, Reason
from schemas.requests import Role


class Credentials(msgspec.Struct, frozen=True, array_like=True):
    """The proven facts about a request's sender, as the arbiter gets them. In the journal it is an array.

    Attributes:
        reason: NONE if the proof holds; else why it does not, and all below is empty.
        detail: figures that the reason's own text does not have.
        serial: the grant's, for people.
        role, override, speed_limit_mps: those that the grant allows.
    """

    reason: Reason
    detail: str = ""
    serial: int = 0
    role: Role = Role.PROGRAM
    override: bool = False
    speed_limit_mps: float | None = None


class RawRequest(msgspec.Struct, frozen=True):
    """A request, untrusted.

    Attributes:
        handle: to whom the reply goes, a number of the port's; 0 for a put, which has no reply.
        verb: the last chunk of the key.
        operator: the chunk before it; empty if it is not of the form of an operator's name.
        payload: the bytes, or nothing if there are more of them than any request has.
        size: number of bytes of the whole payload.
        fault: why the payload cannot be read, where that was found before the core got it; it is left out then.
        attachment: the bytes that came beside the payload; see ``schemas.authority.proof``.
        credentials: the proven ones; None where no proof is needed.
    """

    handle: int
    verb: str
    operator: str
    payload: bytes
    size: int
    fault: str = ""
    attachment: bytes = b""
    credentials: Credentials | None = None

    @property
    def is_query(self) -> bool:
        """Somebody waits for a reply."""
        return self.handle != 0


class Ruling(msgspec.Struct, frozen=True):
    """The ruling on a request.

    Attributes:
        reason: NONE if it was accepted.
        detail: figures that the reason's own text does not have.
        is_pending: accepted; the reply comes later, with the result.
        lease: the identifier of what the request names, or of what was given.
        expires_ns: the remaining duration of the lease.
        sequence, asked: a drive command's.
        cure: what would cure it at this moment; empty if it is the reason's.
        age_ns: the greatest age that it can have, where it echoes a known challenge.
    """

    reason: Reason = Reason.NONE
    detail: str = ""
    is_pending: bool = False
    lease: int | None = None
    expires_ns: int = 0
    sequence: int | None = None
    age_ns: int | None = None
    asked: Target | None = None
    cure: str = ""

    @property
    def text(self) -> str:
        """The reason in words, with the figures."""
        means = TEXTS[self.reason].means if self.reason is not Reason.NONE else ""
        return "; ".join(filter(None, (means, self.detail)))


class Judged(msgspec.Struct, frozen=True):
    """A request and its ruling."""

    request: RawRequest
    ruling: Ruling


class VerbAnswer(msgspec.Struct, frozen=True):
    """A ruling that goes back to who waits for it."""

    handle: int
    verb: str
    ruling: Ruling

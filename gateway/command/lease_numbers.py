"""The numbers of leases: a secret between the holder and the robot. Pure.

Every request of a holder carries the number that the reply to ``acquire`` or ``take`` gave. The core, the journal
and everything that is published know a lease by its identifier alone, which gives nobody anything. The run loop
puts identifiers for numbers into each request before the core gets it, numbers for identifiers into each reply.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import msgspec

from gateway.command.flow import PendingReply
from gateway.command.request import RawRequest
from schemas import codec
from schemas.codec import PayloadFault
from schemas.decisions import LeaseReply
from schemas.requests import Leased
from schemas.settings import REQUEST_MAX_BYTES
from schemas.subjects import BY_VERB, STOP_VERB

UNKNOWN_LEASE: Final = 0
"""The identifier of no lease, for a number that was not given."""

_KEPT: Final = 32
"""More than the leases whose end the arbiter remembers: their holders are told how they lost them."""


class LeaseNumbers:
    """The number of each lease that was given."""

    def __init__(self, draw: Callable[[], int]) -> None:
        """No lease was given yet.

        Args:
            draw: a random number from 1 to ``LEASE_MAX`` that nobody can foretell.
        """
        self._draw = draw
        self._ids: dict[int, int] = {}

    def admit(self, raw: RawRequest, _now_ns: int = 0) -> RawRequest:
        """The request as the core may know it, and the journal may keep it.

        What the core needs not read, and what cannot be read, is left out: a number could be anywhere in it.
        """
        raw = msgspec.structs.replace(raw, attachment=b"") if raw.attachment else raw
        command = BY_VERB.get(raw.verb)
        if command is None or raw.verb == STOP_VERB or raw.size > REQUEST_MAX_BYTES or raw.fault:
            return msgspec.structs.replace(raw, payload=b"")
        request = codec.decode_request(command, raw.payload)
        if isinstance(request, PayloadFault):
            return msgspec.structs.replace(raw, payload=b"", fault=request.detail)
        if isinstance(request, Leased):
            request = msgspec.structs.replace(request, lease=self._ids.get(request.lease, UNKNOWN_LEASE))
        return msgspec.structs.replace(raw, payload=_ENCODER.encode(request))

    def reply(self, reply: PendingReply) -> PendingReply:
        """The reply as its receiver gets it: the lease that it gives by its number, which is drawn here."""
        command = BY_VERB.get(reply.verb)
        if command is None or command.reply is not LeaseReply:
            return reply
        said = _LEASE_REPLY.decode(reply.payload)
        if not said.ok:
            return reply
        number = self.number_of(said.lease)
        if not number:
            number = self._draw()
            self._ids[number] = said.lease
            if len(self._ids) > _KEPT:
                del self._ids[next(iter(self._ids))]
        payload = _ENCODER.encode(msgspec.structs.replace(said, lease=number))
        return msgspec.structs.replace(reply, payload=payload)

    def number_of(self, lease_id: int) -> int:
        """The number of a lease that was given; 0, which is no lease's, for any other."""
        return next((number for number, known in self._ids.items() if known == lease_id), 0)


_ENCODER: Final = msgspec.msgpack.Encoder()
_LEASE_REPLY: Final = msgspec.msgpack.Decoder(LeaseReply)

"""MessagePack, and the encoding string that names a schema and its version.

``encode`` writes what any MessagePack library reads: a map with string keys. ``decode`` checks types and bounds,
and ignores fields that it does not know, so that a newer sender is still understood.
"""

from __future__ import annotations

from math import isfinite
from typing import Any, Final

import msgspec

from schemas.messages import Message
from schemas.requests import Request
from schemas.subjects import ALL_SUBJECTS, ALL_VERBS, Subject, Verb


class PayloadFault(msgspec.Struct, frozen=True):
    """A payload that is not what its subject promises. A value, not an exception: wire input never raises."""

    detail: str


encode: Final = msgspec.msgpack.Encoder().encode
"""A message's MessagePack bytes."""

PAYLOAD_ERRORS: Final = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
"""What decoding may raise, whatever the payload holds."""

_DECODERS: Final = {subject.type: msgspec.msgpack.Decoder(subject.type) for subject in ALL_SUBJECTS}


def decode(subject: Subject, payload: bytes) -> Message | PayloadFault:
    """The typed message of a payload, or what is wrong with it."""
    try:
        return _DECODERS[subject.type].decode(payload)
    except PAYLOAD_ERRORS as error:
        return PayloadFault(str(error))


_REQUEST_DECODERS: Final = {verb.request: msgspec.msgpack.Decoder(verb.request) for verb in ALL_VERBS}


def decode_request(verb: Verb[Any], payload: bytes) -> Request | PayloadFault:
    """The typed request of a payload, or what is wrong with it. Every number in it is finite."""
    try:
        # A verb that needs nothing may be sent with no payload at all.
        request = _REQUEST_DECODERS[verb.request].decode(payload or _EMPTY_MAP)
    except PAYLOAD_ERRORS as error:
        return PayloadFault(str(error))
    for name in request.__struct_fields__:
        value = getattr(request, name)
        if isinstance(value, float) and not isfinite(value):
            return PayloadFault(f"{name} is not a finite number")
    return request


_EMPTY_MAP: Final = b"\x80"

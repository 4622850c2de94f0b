"""MessagePack, and the encoding string that names a schema and its version.

``encode`` writes what any MessagePack library reads: a map with string keys. ``decode`` checks types and bounds,
and ignores fields that it does not know, so that a newer sender is still understood.
"""

from __future__ import annotations

from typing import Final

import msgspec

from schemas.messages import Message
from schemas.subjects import SUBJECTS, Subject


class PayloadFault(msgspec.Struct, frozen=True):
    """A payload that is not what its subject promises. A value, not an exception: wire input never raises."""

    detail: str


encode: Final = msgspec.msgpack.Encoder().encode
"""A message's MessagePack bytes."""

_DECODERS: Final = {subject.type: msgspec.msgpack.Decoder(subject.type) for subject in SUBJECTS}


def decode(subject: Subject, payload: bytes) -> Message | PayloadFault:
    """The typed message of a payload, or what is wrong with it."""
    try:
        return _DECODERS[subject.type].decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return PayloadFault(str(error))

"""The bytes of requests, replies and samples, and what is wrong with those that cannot be read. Pure."""

from __future__ import annotations

from typing import Final

import msgspec

from gateway.telemetry.received import Received
from schemas import codec, keys
from schemas.codec import PayloadFault
from schemas.decisions import LeaseReply, Reply
from schemas.messages import Message
from schemas.subjects import COMMANDS, Command

BY_REQUEST: Final = {command.request: command for command in COMMANDS}

_DECODERS: Final = {command.reply: msgspec.msgpack.Decoder(command.reply) for command in COMMANDS}

encode_request: Final = msgspec.msgpack.Encoder().encode
"""A request's MessagePack bytes."""


CONTRADICTION: Final = "the replies contradict each other: another gateway of this name, or an impostor, is there"


def contradict(replies: list[Reply | PayloadFault]) -> bool:
    """Replies to one question differ in more than their words."""
    return len({_essence(reply) for reply in replies}) > 1


def _essence(reply: Reply | PayloadFault) -> tuple[object, ...]:
    if isinstance(reply, PayloadFault):
        return ()
    return reply.ok, reply.reason, reply.lease if isinstance(reply, LeaseReply) else 0


def read_reply(command: Command, received: Received) -> Reply | PayloadFault:
    """The typed reply, or what is wrong with it."""
    if received.encoding != command.reply_encoding:
        return PayloadFault(f"the reply is {received.encoding}, not {command.reply_encoding}")
    try:
        return _DECODERS[command.reply].decode(received.payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return PayloadFault(f"the reply cannot be read: {error}")


def read_sample(received: Received) -> tuple[keys.KeyParts, Message | PayloadFault] | None:
    """Return the parts of a sample's key and its message, or what is wrong with it; None if it is no robot's."""
    parts = keys.parse(received.key)
    if parts is None:
        return None
    subject = parts.subject
    if received.encoding != subject.encoding:
        return parts, PayloadFault(f"{subject.name} is {received.encoding}, not {subject.encoding}")
    message = codec.decode(subject, received.payload)
    if isinstance(message, PayloadFault):
        return parts, PayloadFault(f"{subject.name}: {message.detail}")
    return parts, message

"""Requests and replies by the command table, and what is wrong with those that cannot be read. Pure."""

from __future__ import annotations

from typing import Final

import msgspec

from gateway.telemetry.received import Received
from schemas.codec import PayloadFault
from schemas.decisions import LeaseReply, Reply
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

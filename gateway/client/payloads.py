"""The bytes of requests, replies and samples, and what is wrong with those that cannot be read. Pure."""

from __future__ import annotations

from collections import Counter
from typing import Final

import msgspec

from gateway.telemetry.received import Received
from schemas import codec, keys
from schemas.codec import PayloadFault, encoding_fault
from schemas.decisions import LeaseReply, Reply
from schemas.messages import Message
from schemas.subjects import COMMANDS, Command

BY_REQUEST: Final = {command.request: command for command in COMMANDS}

THIS_SIDE: Final = "this program"
"""Who reads, in what is said of another version."""

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
        fault = encoding_fault(received.encoding, command.reply_encoding, THIS_SIDE, "the robot's gateway")
        return PayloadFault(f"the reply is {fault}")
    read = codec.understand(command.reply, received.payload)
    return (
        PayloadFault(f"the reply cannot be read: {read.detail}")
        if isinstance(read, PayloadFault)
        else read.message
    )


class SampleRead(msgspec.Struct, frozen=True, gc=False):
    """A sample of a robot or a recorder.

    Attributes:
        parts: of its key.
        message: what it says, or why that cannot be read.
        unknown: what in it a newer version says and this one does not know.
    """

    parts: keys.KeyParts
    message: Message | PayloadFault
    unknown: tuple[str, ...] = ()


def read_sample(received: Received) -> SampleRead | None:
    """Read a sample; None if it is no robot's and no recorder's."""
    parts = keys.parse(received.key)
    if parts is None:
        return None
    subject = parts.subject
    if received.encoding != subject.encoding:
        sender = "the recorder" if parts.recorder else "the robot's gateway"
        fault = encoding_fault(received.encoding, subject.encoding, THIS_SIDE, sender)
        return SampleRead(parts, PayloadFault(f"{subject.name} is {fault}"))
    read = codec.understand(subject.type, received.payload)
    if isinstance(read, PayloadFault):
        return SampleRead(parts, PayloadFault(f"{subject.name}: {read.detail}"))
    return SampleRead(parts, read.message, tuple(f"{subject.name}: {one}" for one in read.unknown))


class NewerWords:
    """Words and fields of a newer version that this one does not know: each counted, and logged once.

    Attributes:
        counts: samples by what is unknown in them.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def note(self, unknown: tuple[str, ...]) -> list[str]:
        """Count what is unknown in a sample; returns what of it is new, of a bounded number."""
        new = [one for one in unknown if one not in self.counts][: max(0, NEWER_WORDS_MAX - len(self.counts))]
        self.counts.update(one for one in unknown if one in self.counts or one in new)
        return new

    @property
    def text(self) -> str:
        """All of it in one line; empty if there is none."""
        shown = ", ".join(sorted(self.counts)[:NEWER_WORDS_SHOWN])
        return (
            f"a newer version says what {THIS_SIDE} does not know ({shown}): upgrade {THIS_SIDE}" if shown else ""
        )


NEWER_WORDS_MAX: Final = 64
"""Unknown words that are counted; the words are the sender's, and so may be any number."""

NEWER_WORDS_SHOWN: Final = 4

"""Other writers behind the same subscriber: one protobuf record per sample, one per raw frame of a batch.

- ``plain``: the recorder's decoding and transcoding, the Writer of mcap
- ``foxglove``: the same, with the compiled writer of foxglove-sdk

Neither counts losses, syncs the disk, asks for missed samples, or stores unknown ones.

Usage: python -m tests.bench.recorder_peers KIND ENDPOINT FILE QUEUE_SAMPLES
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import zenoh
from mcap.writer import Writer

from recorder.encoding.protobuf import (
    compile_encoder,
    compile_row_encoder,
    descriptor_set,
    schema_name,
)
from schemas import codec, keys
from schemas.can_word import EXTENDED, FD, IDENTIFIER_MASK
from schemas.messages import CanFrame, CanFrames, Message
from schemas.settings import ZenohSettings
from schemas.subjects import Subject
from schemas.zenoh_session import close_session, open_session

IDLE_S: Final = 0.005

Write = Callable[[str, bytes, int], None]  # key, payload, receive time
Add = Callable[[int, bytes, int, int], None]  # sequence, protobuf bytes, receive time, publish time


def has_foxglove() -> bool:
    return find_spec("foxglove") is not None


def write_transcoded(channel: Callable[[str, type], Add]) -> Write:
    """Decode and transcode as the recorder does; ``channel`` makes the channel of a key and class."""
    routes: dict[str, tuple[Subject, Callable[[Any], bytes], Add]] = {}
    encode_row: Callable[..., bytes] = compile_row_encoder(CanFrame)
    encoder = cache(compile_encoder)

    def write(key: str, payload: bytes, log_ns: int) -> None:
        route = routes.get(key)
        if route is None:
            subject = _subject(key)
            kind = CanFrame if subject.type is CanFrames else subject.type
            route = routes[key] = (subject, encoder(kind), channel(key, kind))
        subject, encode, add = route
        message = codec.decode(subject, payload)
        if isinstance(message, CanFrames):
            for row in _rows(message):
                add(message.sequence, encode_row(*row), log_ns, row[0])
        elif isinstance(message, Message):
            add(message.sequence, encode(message), log_ns, message.time_ns)

    return write


def _subject(key: str) -> Subject:
    parts = keys.parse(key)
    assert parts is not None, key
    return parts.subject


def _rows(batch: CanFrames) -> list[tuple[Any, ...]]:
    """The fields of a CanFrame for each frame of a batch, in order."""
    bus = batch.bus
    return [
        (
            time_ns,
            bus,
            word & IDENTIFIER_MASK,
            word & EXTENDED != 0,
            False,
            False,
            flags & FD != 0,
            False,
            False,
            length,
            data,
        )
        for time_ns, word, flags, length, data in zip(
            batch.frame_time_ns, batch.can_id, batch.fd_flags, batch.length, batch.data, strict=True
        )
    ]


def plain(stack: ExitStack, path: Path) -> Write:
    writer = Writer(stack.enter_context(path.open("wb")))
    writer.start()
    stack.callback(writer.finish)

    def channel(key: str, kind: type) -> Add:
        schema_id = writer.register_schema(schema_name(kind), "protobuf", descriptor_set(kind))
        channel_id = writer.register_channel(key, "protobuf", schema_id)

        def add(sequence: int, data: bytes, log_ns: int, publish_ns: int) -> None:
            writer.add_message(channel_id, log_ns, data, publish_ns, sequence)

        return add

    return write_transcoded(channel)


def foxglove(stack: ExitStack, path: Path) -> Write:
    """The writer of foxglove-sdk; it takes neither sequence nor publish time."""
    from foxglove import Channel, Schema, open_mcap  # noqa: PLC0415 - it need not be installed

    stack.enter_context(open_mcap(path))

    def channel(key: str, kind: type) -> Add:
        schema = Schema(name=schema_name(kind), encoding="protobuf", data=descriptor_set(kind))
        # Without the wrapper around it, which only looks at types.
        log = Channel(key, schema=schema, message_encoding="protobuf").base.log

        def add(_sequence: int, data: bytes, log_ns: int, _publish_ns: int) -> None:
            log(data, log_ns)

        return add

    return write_transcoded(channel)


WRITERS: Final[dict[str, Callable[[ExitStack, Path], Write]]] = {"plain": plain, "foxglove": foxglove}


def main(kind: str, endpoint: str, path: Path, queue_samples: int) -> None:
    is_stopped = False

    def stop(*_: object) -> None:
        nonlocal is_stopped
        is_stopped = True

    signal.signal(signal.SIGTERM, stop)
    with ExitStack() as stack:
        session = open_session(ZenohSettings(), [endpoint], [])
        stack.callback(close_session, session)
        write = WRITERS[kind](stack, path)
        receive = session.declare_subscriber("**", zenoh.handlers.RingChannel(queue_samples)).try_recv
        sys.stderr.write("record: ready\n")
        while True:
            sample = receive()
            if sample is not None:
                write(str(sample.key_expr), sample.payload.to_bytes(), time.time_ns())
            elif is_stopped:
                break
            else:
                time.sleep(IDLE_S)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], Path(sys.argv[3]), int(sys.argv[4]))

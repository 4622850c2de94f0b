"""Recorders on Zenoh that record nothing, and give prepared answers."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import zenoh

from schemas.recording import RecorderReply
from schemas.subjects import RECORDER_BY_VERB
from tests.support.fakes.peer import Peer
from tests.support.messages import recorder_health


def a_reply(detail: str = "recording", *, files: list[str] | None = None) -> bytes:
    return msgspec.msgpack.encode(
        RecorderReply(ok=True, detail=detail, files=files or [], health=recorder_health())
    )


@contextmanager
def answering(peer: Peer, name: str, *payloads: bytes, silent: str = "") -> Iterator[list[str]]:
    """Answer queries to recorders of this name, but for one verb; yields the keys that were asked."""
    asked: list[str] = []
    stop = threading.Event()
    queries = peer.session.declare_queryable(
        f"fleet/@recorder/{name}/@cmd/*/*", zenoh.handlers.RingChannel(16), complete=True
    )

    def serve() -> None:
        while not stop.wait(0.005):
            query = queries.try_recv()
            if query is None:
                continue
            asked.append(str(query.key_expr))
            operator, verb = asked[-1].split("/")[-2:]
            with query:
                encoding = RECORDER_BY_VERB[verb].reply_encoding
                for payload in payloads if verb != silent else ():
                    query.reply(f"fleet/@recorder/{name}/@cmd/{operator}/{verb}", payload, encoding=encoding)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield asked
    finally:
        stop.set()
        thread.join()
        queries.undeclare()

"""Recorders that answer what they are told to: none of them records."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import zenoh

from schemas.recording import RecorderReply
from tests.support.health_of import health
from tests.support.zenoh_peer import Peer


def a_reply(detail: str = "recording", *, ok: bool = True, files: list[str] | None = None) -> bytes:
    """A recorder's reply as it is on the wire."""
    return msgspec.msgpack.encode(RecorderReply(ok=ok, detail=detail, files=files or [], health=health()))


@contextmanager
def answering(peer: Peer, name: str, *payloads: bytes, silent: str = "") -> Iterator[list[str]]:
    """Answer what is asked of recorders of this name, but for one verb; the keys that were asked.

    The name may be anything that a key takes: who answers on the network may be anybody.
    """
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
                for payload in payloads if verb != silent else ():
                    query.reply(f"fleet/@recorder/{name}/@cmd/{operator}/{verb}", payload)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield asked
    finally:
        stop.set()
        thread.join()
        queries.undeclare()

"""Recorders on Zenoh that record nothing: one gives prepared answers, one answers out of a directory of logs."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import zenoh

from recorder.zenoh.backfill_server import BackfillServer
from recorder.zenoh.session import key_matches
from schemas import codec, keys
from schemas.recording import Backfill, BackfillPiece, RecorderReply
from schemas.settings import ZenohSettings
from schemas.subjects import RECORDER_BY_VERB
from schemas.zenoh_link import session_settings
from tests.support.fakes.peer import Peer
from tests.support.messages import recorder_health


def a_reply(detail: str = "recording", *, ok: bool = True, files: list[str] | None = None) -> bytes:
    """A recorder's reply as it is on the wire."""
    return msgspec.msgpack.encode(RecorderReply(ok=ok, detail=detail, files=files or [], health=recorder_health()))


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


BACKFILL = RECORDER_BY_VERB["backfill"]


class BackfillHost:
    """A recorder that does nothing but answer. The pieces of the numbers ``drops``, from 1, are lost."""

    def __init__(self, endpoint: str, directory: Path, name: str = "robot") -> None:
        config = zenoh.Config()
        for path, value in session_settings(ZenohSettings(), [], [endpoint]).items():
            config.insert_json5(path, json.dumps(value))
        self.requests: list[Backfill] = []
        self.drops: set[int] = set()
        self.sent = 0
        self._name = name
        self._server = BackfillServer(directory, key_matches)
        self._session = zenoh.open(config)
        self._token = self._session.liveliness().declare_token(keys.of_recorder("fleet", name))
        self._queries: Any = self._session.declare_queryable(
            keys.recorder_command("fleet", name, keys.ALL, keys.ALL), zenoh.handlers.FifoChannel(16), complete=True
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.005):
            query = self._queries.try_recv()
            if query is not None:
                self._take(query)

    def _take(self, query: zenoh.Query) -> None:
        payload = query.payload
        request = codec.decode_request(BACKFILL, b"" if payload is None else payload.to_bytes())
        assert isinstance(request, Backfill)
        assert str(query.encoding) == BACKFILL.encoding
        self.requests.append(request)
        operator, verb = keys.parse_command(str(query.key_expr))
        key = keys.recorder_command("fleet", self._name, operator, verb)

        def reply(piece: BackfillPiece) -> None:
            self.sent += 1
            if self.sent not in self.drops:
                query.reply(key, msgspec.msgpack.encode(piece), encoding=BACKFILL.reply_encoding)

        self._server.submit(request, reply, query.drop)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._server.close()
        self._session.close()

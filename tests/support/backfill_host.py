"""Another recorder's place on Zenoh: a directory of logs that answers, on the loopback."""

import json
import threading
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec
import zenoh

from recorder.zenoh.backfill_server import BackfillServer
from recorder.zenoh.session import key_matches
from schemas import codec, keys
from schemas.recording import Backfill, BackfillPiece
from schemas.settings import ZenohSettings
from schemas.subjects import RECORDER_BY_VERB
from schemas.zenoh_link import session_settings

VERB = RECORDER_BY_VERB["backfill"]


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
        request = codec.decode_request(VERB, b"" if payload is None else payload.to_bytes())
        assert isinstance(request, Backfill)
        assert str(query.encoding) == VERB.encoding
        self.requests.append(request)
        operator, verb = keys.parse_command(str(query.key_expr))
        key = keys.recorder_command("fleet", self._name, operator, verb)

        def reply(piece: BackfillPiece) -> None:
            self.sent += 1
            if self.sent not in self.drops:
                query.reply(key, msgspec.msgpack.encode(piece), encoding=VERB.reply_encoding)

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

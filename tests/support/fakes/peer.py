"""A gateway's place on Zenoh, as small as it can be: on a free port of the loopback, never multicast."""

import json
import socket
import threading
from contextlib import suppress
from random import SystemRandom
from typing import Final, Self

import zenoh

from recorder.encoding.samples import ReceivedSample
from schemas.settings import ZenohSettings
from schemas.zenoh_session import session_settings

# Below those that Linux assigns to clients: a restarted gateway finds its own free.
PORTS: Final = range(10_000, 32_000)


def free_endpoint(protocol: str = "tcp") -> str:
    """An endpoint of this machine whose port and the one after it are free: a gateway takes both."""
    while True:
        port = SystemRandom().choice(PORTS)
        with socket.socket() as probe, socket.socket() as after, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            after.bind(("127.0.0.1", port + 1))
            return f"{protocol}/127.0.0.1:{port}"


class Peer:
    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        for path, value in session_settings(ZenohSettings(), [], [endpoint]).items():
            config.insert_json5(path, json.dumps(value))
        self._session = zenoh.open(config)
        self._stop = threading.Event()
        self._threads: list[threading.Thread] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def session(self) -> zenoh.Session:
        return self._session

    def put(self, sample: ReceivedSample) -> None:
        self._session.put(
            sample.key,
            sample.payload,
            encoding=sample.encoding,
            attachment=sample.attachment or None,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    def delete(self, key: str) -> None:
        self._session.delete(key)

    def answer(self, reply: ReceivedSample) -> None:
        queries = self._session.declare_queryable(reply.key, zenoh.handlers.RingChannel(16), complete=True)

        def serve() -> None:
            while not self._stop.wait(0.01):
                query = queries.try_recv()
                if query is not None:
                    with query:
                        query.reply(reply.key, reply.payload, encoding=reply.encoding)

        thread = threading.Thread(target=serve)
        thread.start()
        self._threads.append(thread)

    def close(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._session.close()

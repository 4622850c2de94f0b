"""Routers: ours, or the ``zenohd`` that ``ZENOHD`` names (``make test-zenohd``); both run from the same file."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import zenoh

from gateway.authority.enrolment import TransportRole
from gateway.zenoh.client import open_router
from tests.support.processes.gateway import Running
from tests.support.processes.listening import listening
from tests.support.secured import Network
from tests.support.waiting import wait_until

PROGRAM: Final = os.environ.get("ZENOHD", "")

# All keys of nodes: no wildcard stands for a chunk with an @.
EVERYTHING: Final = (
    "**",
    "fleet/*/@cmd/**",
    "fleet/*/@auth/**",
    "fleet/@recorder/**",
    "fleet/@recorder/*/@cmd/**",
)
MESSAGES: Final = (
    *("put", "delete", "declare_subscriber", "query", "reply", "declare_queryable"),
    *("liveliness_token", "liveliness_query", "declare_liveliness_subscriber"),
)


class Zenohd:
    def __init__(self, file: Path, *words: str) -> None:
        self.process = subprocess.Popen([PROGRAM, "-c", str(file), *words], stdin=subprocess.DEVNULL)
        endpoints = json.loads(file.read_text("utf-8"))["listen"]["endpoints"]
        places = {endpoint.partition("/")[2] for endpoint in endpoints}
        try:
            wait_until(lambda: self.process.poll() is not None or places <= listening(self.process.pid))
            assert self.process.poll() is None
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(30)


class WatchedRouter:
    """A router, and a session that sees all that passes it; for zenohd its file gets one more row."""

    def __init__(self, network: Network, file: Path) -> None:
        self._zenohd: Zenohd | None = None
        if not PROGRAM:
            self.session, _ = open_router(file, [])
            return
        self._zenohd = Zenohd(_with_watcher(file))
        try:
            self.session = network.session(TransportRole.NOTHING, "watcher", access_control__enabled=False)
        except BaseException:
            self._zenohd.close()
            raise

    def close(self) -> None:
        self.session.close()
        if self._zenohd is not None:
            assert self._zenohd.process.poll() is None, "the router has ended by itself"
            self._zenohd.close()


@contextmanager
def routing(file: Path) -> Iterator[None]:
    """A router that nothing watches; ours is a session in this process."""
    router: Zenohd | zenoh.Session = Zenohd(file) if PROGRAM else open_router(file, [])[0]
    try:
        yield
    finally:
        router.close()


@contextmanager
def router_process(file: Path) -> Iterator[None]:
    if PROGRAM:
        with routing(file):
            yield
        return
    with Running("router", "--zenoh-config", str(file)) as running:
        running.wait_says("router: listens")
        yield


def _with_watcher(file: Path) -> Path:
    """The file with one more row: nodes of an otherwise unused role see all that passes."""
    said = json.loads(file.read_text("utf-8"))
    access = said["access_control"]
    row = {
        "id": "watcher",
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": MESSAGES,
        "key_exprs": EVERYTHING,
    }
    role = TransportRole.NOTHING.value
    access["rules"].append(row)
    access["subjects"].append({"id": role, "cert_common_names": [role]})
    access["policies"].append({"rules": ["watcher"], "subjects": [role]})
    watched = file.with_name("watched.json5")
    watched.write_text(json.dumps(said), "utf-8")
    return watched

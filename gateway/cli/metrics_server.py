"""Serves metrics to Prometheus over HTTP. Needs the extra 'metrics'."""

from __future__ import annotations

import ipaddress
import logging
import re
import resource
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any, Final, Self
from wsgiref.simple_server import WSGIRequestHandler, make_server
from wsgiref.types import StartResponse, WSGIApplication, WSGIEnvironment

from prometheus_client import CollectorRegistry, Metric, ProcessCollector, make_wsgi_app
from prometheus_client.exposition import ThreadingWSGIServer
from prometheus_client.registry import Collector

from gateway.metrics import FleetMetrics
from gateway.zenoh.client import FleetListener
from schemas.command_line import CommandError, ExitCode, shown_address
from schemas.peers import REQUEST_S, Peers, most_connections, peer_of

log = logging.getLogger(__name__)

POLL_S: Final = 0.1  # the period in which arrivals are taken from Zenoh


class MetricsServer(Collector):
    """Serves the metrics of a fleet on its own threads; ``where`` is its URL."""

    def __init__(self, metrics: FleetMetrics, host: str, port: int) -> None:
        """Listen; port 0 is a free one. From here on the metrics belong to this server."""
        self._metrics = metrics
        self._lock = threading.Lock()
        registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        registry.register(self)

        class Server(_Server):
            address_family = socket.AF_INET6 if ":" in host else socket.AF_INET

        if not ipaddress.ip_address(host).is_loopback:
            log.warning("any client that reaches %s can read the robots' health", shown_address(host, port))
        app = make_wsgi_app(registry)
        if ipaddress.ip_address(host).is_loopback:
            app = _for_this_machine(app)
        try:
            self._server = make_server(host, port, app, Server, _Handler)
        except OSError as error:
            text = f"cannot listen on {shown_address(host, port)}: {error.strerror or error}"
            raise CommandError(text, ExitCode.UNREACHABLE) from error
        self.where = f"http://{shown_address(host, self._server.server_port)}/metrics"
        self._thread = threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True)

    def follow(self, listener: FleetListener, ends: Callable[[], bool]) -> None:
        """Process arrivals until ``ends()``."""
        polled_ns = time.monotonic_ns()
        while not ends():
            now_ns = time.monotonic_ns()
            arrivals, linked = list(listener.drain()), listener.connected()
            with self._lock:
                self._metrics.linked = linked
                for arrival in arrivals:
                    self._metrics.receive(arrival, polled_ns, time.time())
            polled_ns = now_ns
            time.sleep(POLL_S)

    def collect(self) -> Iterator[Metric]:
        with self._lock:
            families = list(self._metrics.families(time.monotonic_ns()))
        yield from families

    def describe(self) -> Iterator[Metric]:
        """Describe nothing, so that the registry does not collect at registration."""
        yield from ()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_raised: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingWSGIServer):
    """Answers each connection on its own thread; bounds their number and duration."""

    request_queue_size = 128

    def __init__(self, *arguments: Any) -> None:  # noqa: ANN401 - the library's
        most = most_connections(resource.getrlimit(resource.RLIMIT_NOFILE)[0])
        self._peers: Peers[socket.socket] = Peers(most)
        self._begun_s: dict[socket.socket, float] = {}
        self._lock = threading.Lock()
        super().__init__(*arguments)

    def verify_request(self, request: Any, client_address: Any) -> bool:  # noqa: ANN401 - the library's
        """Accept a connection, or not; called on the server's thread, as ``service_actions`` is."""
        now_s = time.monotonic()
        with self._lock:
            if self._peers.pause_s(now_s):
                return False
            gone = self._peers.enter(request, peer_of(client_address[0]), now_s)
            if gone is None:
                return False
            self._begun_s[request] = now_s
        self._cut(gone)
        return True

    def service_actions(self) -> None:
        """Cut connections that take too long; called twice a second, and after each connection."""
        late_s = time.monotonic() - REQUEST_S
        with self._lock:
            late = [one for one, begun_s in self._begun_s.items() if begun_s < late_s]
        self._cut(late)

    def close_request(self, request: Any) -> None:  # noqa: ANN401 - the library's
        """Forget a connection; called on its own thread."""
        with self._lock:
            self._peers.leave(request)
            self._begun_s.pop(request, None)
        super().close_request(request)

    def _cut(self, connections: list[socket.socket]) -> None:
        for one in connections:
            # Its thread reads the end, and closes it.
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)


def _for_this_machine(app: WSGIApplication) -> WSGIApplication:
    """Refuse a request whose Host header is neither an address nor localhost (DNS rebinding)."""

    def answer(environ: WSGIEnvironment, start: StartResponse) -> Iterable[bytes]:
        name = re.sub(r":\d*\Z", "", environ.get("HTTP_HOST", "")).strip("[]")
        try:
            is_own = name == "localhost" or bool(ipaddress.ip_address(name))
        except ValueError:
            is_own = False
        if is_own:
            return app(environ, start)
        start("421 Misdirected Request", [("Content-Type", "text/plain")])
        return [b"ask for 127.0.0.1, [::1] or localhost\n"]

    return answer


class _Handler(WSGIRequestHandler):
    def log_message(self, *_said: object) -> None:
        """Log nothing: Prometheus asks every few seconds."""

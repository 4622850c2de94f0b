"""Answers Prometheus over HTTP. For ``cruiser metrics``; needs the extra 'metrics'."""

from __future__ import annotations

import ipaddress
import logging
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Final, Self
from wsgiref.simple_server import WSGIRequestHandler, make_server

from prometheus_client import CollectorRegistry, Metric, ProcessCollector, make_wsgi_app
from prometheus_client.exposition import ThreadingWSGIServer
from prometheus_client.registry import Collector

from gateway.metrics.fleet_metrics import FleetMetrics
from gateway.zenoh.client import FleetListener
from schemas.exit_codes import CommandError, ExitCode
from schemas.listen_address import shown_address

log = logging.getLogger(__name__)

REQUEST_TIMEOUT_S: Final = 10.0
"""A client that then sends or reads nothing for this time is cut off."""

POLL_S: Final = 0.1
"""The period in which arrivals are taken from Zenoh."""


class MetricsServer(Collector):
    """Serves the metrics of a fleet, on threads of its own.

    Attributes:
        where: its address, as it is typed into a browser.
    """

    def __init__(self, metrics: FleetMetrics, host: str, port: int) -> None:
        """Listen.

        Args:
            metrics: the served ones; from here on this server's alone.
            host: an IP address.
            port: 0 is a free one.

        Raises:
            CommandError: the address is taken, or not one of this machine.
        """
        self._metrics = metrics
        self._lock = threading.Lock()
        registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        registry.register(self)

        class Server(ThreadingWSGIServer):
            address_family = socket.AF_INET6 if ":" in host else socket.AF_INET

        if not ipaddress.ip_address(host).is_loopback:
            log.warning("whoever reaches %s reads how the robots are", shown_address(host, port))
        try:
            self._server = make_server(host, port, make_wsgi_app(registry), Server, _Handler)
        except OSError as error:
            text = f"cannot listen on {shown_address(host, port)}: {error.strerror or error}"
            raise CommandError(text, ExitCode.UNREACHABLE) from error
        self.where = f"http://{shown_address(host, self._server.server_port)}/metrics"
        self._thread = threading.Thread(target=self._server.serve_forever, name="metrics", daemon=True)

    def follow(self, listener: FleetListener, ends: Callable[[], bool]) -> None:
        """Take over what arrives until the end."""
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
        """All metrics as they are now: for the registry."""
        with self._lock:
            families = list(self._metrics.families(time.monotonic_ns()))
        yield from families

    def describe(self) -> Iterator[Metric]:
        """Nothing: no other collector of the registry has names of the fleet's."""
        yield from ()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_raised: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Handler(WSGIRequestHandler):
    """Answers one request."""

    timeout = REQUEST_TIMEOUT_S

    def log_message(self, *_said: object) -> None:
        """Log nothing: Prometheus asks every few seconds."""

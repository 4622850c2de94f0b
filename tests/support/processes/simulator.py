"""A served bus for tests: the real server on a free port of the loopback, the real run loop in a thread."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import can

from gateway.can.socketcand_server import SocketcandServer
from gateway.choice.chassis import CHASSIS
from gateway.cli.sim import SimClock, SimSummary, live
from gateway.sim.model import VirtualChassis
from schemas.messages import Variant

DEADLINE_S = 20.0


class Served:
    def __init__(self, server: SocketcandServer) -> None:
        self.server = server
        self.host, self.port = server.address
        self.chassis = VirtualChassis(CHASSIS, Variant.COARSE, SimClock().monotonic_ns())
        self.summary: SimSummary | None = None
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.serve)

    def end(self) -> None:
        self.stop.set()
        self.thread.join(DEADLINE_S)
        self.server.close()

    def serve(self) -> None:
        self.summary = live(self.chassis, self.server, self.stop.is_set, SimClock())

    @contextmanager
    def bus(self) -> Iterator[can.BusABC]:
        with can.Bus(interface="socketcand", host=self.host, port=self.port, channel="can0") as bus:
            yield bus

    @contextmanager
    def raw(self) -> Iterator[socket.socket]:
        with socket.create_connection((self.host, self.port), DEADLINE_S) as connection:
            assert connection.recv(64) == b"< hi >"
            yield connection


@contextmanager
def served() -> Iterator[Served]:
    server = SocketcandServer("127.0.0.1", 0)
    running = Served(server)
    running.thread.start()
    try:
        yield running
    finally:
        running.end()
    assert not running.thread.is_alive()


def receive(bus: can.BusABC, wanted: Callable[[can.Message], bool]) -> can.Message:
    deadline_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline_s:
        message = bus.recv(0.5)
        if message is not None and wanted(message):
            return message
    raise AssertionError("the message never came")

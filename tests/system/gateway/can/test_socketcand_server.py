"""The served bus, with python-can's own socketcand interface as the client."""

import contextlib
import socket
from collections.abc import Iterator

import can
import pytest

from gateway.can.socketcand_server import JOIN_NS, MAX_CLIENTS, SocketcandServer
from gateway.chassis.frame import EXTENDED, Frame
from tests.support.processes.simulator import DEADLINE_S, Served, receive, served

FRAME = Frame(0x18C4D1EF | EXTENDED, bytes(8), 1_000_000_000)
LINE = b"< frame 18C4D1EF 1.000000 0000000000000000 >"


@pytest.fixture
def running() -> Iterator[Served]:
    with served() as chassis:
        yield chassis


@pytest.fixture
def server() -> Iterator[SocketcandServer]:
    """A server whose time the test sets."""
    bare = SocketcandServer("127.0.0.1", 0)
    yield bare
    bare.close()


def no_faults(_text: str) -> str:
    return ""


def turn(server: SocketcandServer, now_ns: int = 0, wall_ns: int = 0) -> list[Frame]:
    server.wait(1.0)
    return server.read(now_ns, wall_ns, no_faults)


def turn_quickly(server: SocketcandServer) -> None:
    server.wait(0)
    server.read(JOIN_NS, 0, no_faults)


def join(server: SocketcandServer, now_ns: int = 0) -> socket.socket:
    client = socket.create_connection(server.address, DEADLINE_S)
    turn(server, now_ns)
    assert client.recv(64) == b"< hi >"
    for request in (b"< open can0 >", b"< rawmode >"):
        client.sendall(request)
        turn(server, now_ns)
        assert client.recv(64) == b"< ok >"
    return client


def test_each_client_sees_the_others_and_not_itself(running: Served) -> None:
    with running.bus() as first, running.bus() as second, running.bus() as third:
        for bus in (first, second, third):
            assert receive(bus, lambda message: message.arbitration_id == 0x18C4D1EF)  # It is on the bus now.
        first.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\x01\x02\x03"))
        second.send(can.Message(arbitration_id=0x1ABCDEF0, data=b""))
        # Which of two clients is heard first is open.
        at_third: dict[int, can.Message] = {}
        while len(at_third) < 2:
            message = receive(third, lambda message: message.arbitration_id in {0x123, 0x1ABCDEF0})
            at_third[message.arbitration_id] = message
        assert (bytes(at_third[0x123].data), at_third[0x123].is_extended_id) == (b"\x01\x02\x03", False)
        assert (bytes(at_third[0x1ABCDEF0].data), at_third[0x1ABCDEF0].is_extended_id) == (b"", True)
        assert receive(second, lambda message: message.arbitration_id == 0x123)
        others = {0x123, 0x1ABCDEF0}
        assert receive(first, lambda message: message.arbitration_id in others).arbitration_id == 0x1ABCDEF0


def test_a_client_is_on_the_bus_after_its_handshake(server: SocketcandServer) -> None:
    """A frame in the same segment as the ``< ok >`` would fail python-can's handshake."""
    client = join(server, now_ns=1000)
    server.send([FRAME], 1001)
    server.send([FRAME], 1000 + JOIN_NS - 1)
    client.settimeout(0)
    with pytest.raises(BlockingIOError):
        client.recv(1)
    server.send([FRAME], 1000 + JOIN_NS)
    client.settimeout(DEADLINE_S)
    assert client.recv(300) == LINE
    client.close()


def test_a_client_that_does_not_read_is_cut_off(server: SocketcandServer) -> None:
    for asks in (False, True):
        deaf, other = join(server), join(server)
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for client in (deaf, other):
            client.settimeout(0)
        while server.clients == 2:
            with contextlib.suppress(OSError):
                deaf.send(b"< x >" * 2000) if asks else server.send([FRAME] * 1000, JOIN_NS)
            turn_quickly(server)
            with contextlib.suppress(BlockingIOError):
                other.recv(1 << 20)
        assert server.clients == 1
        for client in (deaf, other):
            client.close()
        while server.clients:
            turn(server)


def test_the_number_of_clients_is_bounded(server: SocketcandServer) -> None:
    clients = []
    for _ in range(MAX_CLIENTS):
        clients.append(socket.create_connection(server.address, DEADLINE_S))
        turn(server)
    with socket.create_connection(server.address, DEADLINE_S) as surplus:
        turn(server)
        assert surplus.recv(300).startswith(b"< error ")
    assert server.clients == MAX_CLIENTS
    for client in clients:
        client.close()

"""The CAN bus by a socketcand server, and the gateways that claim one."""

import fcntl
import os
import select
import socket
import struct
import termios
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress

import pytest

from gateway.can.can_bus import SEND_TIMEOUT_US, SEND_WAITING_MAX_BYTES, Bus, BusLost, CanBus
from gateway.can.open_bus import BusClaim, ReconnectingBus, count_claims, open_bus
from gateway.chassis.frame import EXTENDED, Frame
from schemas.settings import CanSettings
from tests.support.waiting import DEADLINE_S, wait_until


def comes_true(within_s: float, condition: Callable[[], bool]) -> bool:
    deadline_s = time.monotonic() + within_s
    while not (holds := condition()) and time.monotonic() < deadline_s:
        time.sleep(0.002)
    return holds


def waiting_bytes(stream: socket.socket) -> int:
    (count,) = struct.unpack("@i", fcntl.ioctl(stream, termios.TIOCOUTQ, bytes(4)))
    return int(count)


def opened(channel: str) -> Bus:
    return open_bus(CanSettings(interface="socketcand", channel=channel))


def test_no_server_is_a_lost_bus() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(BusLost, match="no server there"):
            opened(f"127.0.0.1:{taken.getsockname()[1]}")


@contextmanager
def server(
    greeting: bytes, answers: int = 2, answer: bytes = b"< ok >", last: bytes = b"", host: str = "127.0.0.1"
) -> Iterator[tuple[str, Callable[[], None]]]:
    """A TCP server that greets in two segments, answers this many lines, and is then silent."""
    hang_up = threading.Event()

    def serve() -> None:
        while not hang_up.is_set():
            try:
                client, _ = listener.accept()
            except TimeoutError:
                continue
            client.settimeout(0.02)
            with client, suppress(ConnectionError):
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                client.sendall(greeting[:3])
                client.sendall(greeting[3:])
                answered = 0
                while not hang_up.is_set():
                    try:
                        if not client.recv(256):
                            break
                        if answered < answers:
                            answered += 1
                            client.sendall(answer + (last if answered == answers else b""))
                    except TimeoutError:
                        continue

    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.create_server((host.strip("[]"), 0), family=family) as listener:
        listener.settimeout(0.02)
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"{host}:{listener.getsockname()[1]}", hang_up.set
        finally:
            hang_up.set()
            thread.join()


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    ("greeting", "answers", "answer", "why"),
    [
        (b"SSH-2.0-OpenSSH_9.2\r\n", 2, b"< ok >", "does not speak the socketcand protocol"),
        (b"< hi >", 0, b"< ok >", "the server did not answer within 0.5 s"),
        (b"< hi >", 1, b"< ok >", "the server did not answer within 0.5 s"),
        # As socketcand says it of a bus that is not there.
        (b"< hi >", 2, b"< error could not open bus >", "the server answered '< error could not open bus >'"),
    ],
)
def test_a_server_that_does_not_open_the_bus_is_told(
    monkeypatch: pytest.MonkeyPatch, greeting: bytes, answers: int, answer: bytes, why: str
) -> None:
    monkeypatch.setattr("gateway.can.can_bus.HANDSHAKE_TIMEOUT_S", 0.5)
    with server(greeting, answers, answer) as (channel, _), pytest.raises(BusLost, match=f"{channel}: .*{why}"):
        opened(channel)


@pytest.mark.parametrize("host", ["127.0.0.1", "[::1]"])
def test_frames_right_behind_the_handshake_are_frames(host: str) -> None:
    with server(b"< hi >", last=b"< frame 18C4D1EF 23.424242 0102030405060708 >", host=host) as (channel, _):
        with closing(opened(channel)) as bus:
            frame = bus.receive(DEADLINE_S)
        assert frame is not None
        assert (frame.can_id, frame.data) == (EXTENDED | 0x18C4D1EF, bytes(range(1, 9)))


@pytest.mark.parametrize(
    "broken",
    [
        b"< frame 18C4D1EF 23.4 01020Z >",
        b"< frame 18C4 >",
        b"\xff\xfe >",
        b"< " + b"0" * 600 + b" >",
        b"frame >",
        b"< what >",
    ],
)
def test_a_message_that_cannot_be_read_costs_no_other(broken: bytes) -> None:
    frame = b"< frame 18C4D1EF 23.424242 0102030405060708 >"
    with server(b"< hi >", last=frame + broken + frame + frame) as (channel, _):
        with closing(opened(channel)) as bus:
            received = [bus.receive(DEADLINE_S) for _ in range(2)]
        assert all(one is not None and one.data == bytes(range(1, 9)) for one in received)
        assert bus.drops == 1


def test_a_server_that_hangs_up_is_a_lost_bus() -> None:
    with server(b"< hi >") as (channel, hang_up), closing(opened(channel)) as bus:
        assert bus.receive(0.01) is None
        hang_up()
        with pytest.raises(BusLost, match="closed the connection"):
            wait_until(lambda: bus.receive(0.01) is not None)


BURST = [Frame(EXTENDED | 0x18C4D1D0 + 0x10000 * number, bytes(8)) for number in range(5)]


def never_opened() -> CanBus:
    raise BusLost("never")


class DeafServer:
    """A socketcand server that opens the bus, and reads nothing until the client has hung up."""

    def __init__(self) -> None:
        self.heard = b""
        self.end = ""
        # Small, so that it is full soon; what is accepted inherits it.
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self._listener.bind(("127.0.0.1", 0))
        self._listener.listen()
        self.channel = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def join(self) -> None:
        self._thread.join()
        self._listener.close()

    def _serve(self) -> None:
        client, _ = self._listener.accept()
        with client:
            client.sendall(b"< hi >")
            for _ in ("open", "rawmode"):
                client.recv(256)
                client.sendall(b"< ok >")
            cut_off = select.poll()
            cut_off.register(client, 0)
            cut_off.poll(1000 * DEADLINE_S)
            try:
                while chunk := client.recv(65_536):
                    self.heard += chunk
                self.end = "closed"
            except ConnectionResetError:
                self.end = "reset"


def test_a_server_that_reads_nothing_neither_holds_the_loop_nor_gets_stale_commands() -> None:
    deaf = DeafServer()
    below = opened(deaf.channel)
    assert isinstance(below, CanBus)
    stream = below._socket
    assert stream is not None
    # The kernel holds whoever sends for so long, in whole ticks of its own, and no longer.
    kept_s, kept_us = struct.unpack("@ll", stream.getsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, 16))
    assert kept_s == 0
    assert SEND_TIMEOUT_US <= kept_us <= SEND_TIMEOUT_US + 10_000
    assert stream.gettimeout() is None, "or Python waits by itself, without that bound"
    bus = ReconnectingBus(never_opened, below)
    taken = 0

    def sent() -> int:
        nonlocal taken
        count = bus.send(BURST)
        taken += count
        return count

    is_deaf = False
    # As long as the server's side takes them in they are gone at once; then they wait on ours.
    while sent() == len(BURST):
        assert taken < 10_000, "it takes frames without end"
        is_deaf = is_deaf or not comes_true(1.0, lambda: waiting_bytes(stream) == 0)
    assert bus.is_up, "a full bus is no lost one"
    assert waiting_bytes(stream) <= SEND_WAITING_MAX_BYTES + 200
    wait_until(lambda: sent() == 0 and not bus.is_up)
    assert bus.losses == 1
    deaf.join()
    heard = deaf.heard.count(b"< send ")
    assert deaf.end == "reset"
    assert 0 < heard < taken
    bus.close()


def test_gateways_of_one_bus_are_counted_while_they_run() -> None:
    bus = CanSettings(channel=f"test{os.getpid()}")
    assert count_claims(bus) == 0
    with BusClaim(bus) as first:
        assert not first.is_shared
        with BusClaim(bus) as second, BusClaim(bus) as third:
            assert second.is_shared
            assert third.is_shared
            assert count_claims(bus) == 3
        assert count_claims(bus) == 1
        assert count_claims(CanSettings(channel="another")) == 0
    assert count_claims(bus) == 0

"""The CAN bus through python-can."""

import fcntl
import re
import socket
import struct
import termios
import threading
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import can
import pytest
from hypothesis import given

from gateway.can.can_bus import (
    SEND_TIMEOUT_US,
    SEND_WAITING_MAX_BYTES,
    BusFull,
    BusLost,
    CanBus,
    to_frame,
    to_message,
)
from gateway.can.open_bus import open_bus
from gateway.can.reconnecting_bus import ReconnectingBus
from gateway.chassis.frame import ERROR, EXTENDED, REMOTE, Frame
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import CanSettings
from tests.support.can_strategies import frames

DEADLINE_S = 10.0


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait for a condition that has to come true."""
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s, "it never came true"
        time.sleep(0.002)


def comes_true(within_s: float, condition: Callable[[], bool]) -> bool:
    """Wait for a condition that need not come true."""
    deadline_s = time.monotonic() + within_s
    while not (holds := condition()) and time.monotonic() < deadline_s:
        time.sleep(0.002)
    return holds


def waiting_bytes(stream: socket.socket) -> int:
    """What was given to a socket and has not arrived at the other side."""
    (count,) = struct.unpack("@i", fcntl.ioctl(stream, termios.TIOCOUTQ, bytes(4)))
    return int(count)


def consistent(frame: Frame) -> Frame:
    """The frame as a driver can deliver it: no remote FD frames, no remote data, 11 bits if standard."""
    can_id = frame.can_id if frame.can_id & EXTENDED else frame.can_id & ~0x1FFF_F800
    remote = bool(can_id & REMOTE) and not can_id & ERROR
    can_id = can_id if remote else can_id & ~REMOTE
    fd_flags = 0 if remote or can_id & ERROR else frame.fd_flags
    data = b"" if remote else frame.data[: 64 if fd_flags else 8]
    return Frame(can_id, data, frame.wall_ns, fd_flags, frame.remote_length if remote else 0)


@given(frame=frames.map(consistent))
def test_a_frame_survives_the_way_through_python_can(frame: Frame) -> None:
    """Identifier, kind, data, FD flags and length are the same after python-can's message as before."""
    back = to_frame(to_message(frame), frame.wall_ns)
    assert (back.can_id, back.data, back.fd_flags, back.length) == (
        frame.can_id,
        frame.data,
        frame.fd_flags,
        frame.length,
    )
    assert abs(back.wall_ns - frame.wall_ns) < 2000


class StampedBus(can.BusABC):
    """A driver that stamps its frames as told."""

    def __init__(self, timestamps: list[float]) -> None:
        super().__init__(channel="stamped")
        self.timestamps = timestamps

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError(f"{msg} {timeout}")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return can.Message(timestamp=self.timestamps.pop(0)), timeout is None


@pytest.mark.parametrize("start_s", [0.0, 12.5, 1e12, float("nan"), float("inf"), -1e300])
def test_a_clock_that_does_not_keep_epoch_time_is_not_believed(start_s: float) -> None:
    """Interfaces that count from their own start would put frames into 1970 or the far future."""
    bus = CanBus(StampedBus([start_s, start_s + 1, time.time()]))
    for _ in range(3):
        frame = bus.receive(1)
        assert frame is not None
        assert abs(frame.wall_ns - time.time_ns()) < 10**10
    bus.close()


def test_frames_that_waited_keep_their_times() -> None:
    """Once the interface's clock is known to keep epoch time, a frame that comes late is old, not new."""
    now_s = time.time()
    bus = CanBus(StampedBus([now_s, now_s - 20, now_s - 19.99]))
    times_ns = [frame.wall_ns for _ in range(3) if (frame := bus.receive(1)) is not None]
    assert times_ns == pytest.approx([now_s * 1e9, (now_s - 20) * 1e9, (now_s - 19.99) * 1e9], abs=1000)
    bus.close()


def test_frames_go_from_bus_to_bus() -> None:
    """Two buses on python-can's virtual interface hear each other."""
    settings = CanSettings(interface="virtual", channel="test-two")
    one, other = open_bus(settings), open_bus(settings)
    try:
        one.send(Frame(EXTENDED | 0x18C4D1EF, b"\x01\x04", 0))
        received = other.receive(1)
        assert received is not None
        assert (received.can_id, received.data) == (EXTENDED | 0x18C4D1EF, b"\x01\x04")
        assert other.receive(0) is None
    finally:
        one.close()
        other.close()


def test_a_serial_adapter_without_pyserial_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """The extra that it names is one of ours, and brings what python-can asks for."""
    monkeypatch.setattr("can.interfaces.slcan.serial", None)
    with pytest.raises(CommandError, match=re.escape("pip install 'cruiser-gateway[serial]'")) as error:
        open_bus(CanSettings(interface="slcan", channel="/dev/ttyACM0"))
    assert error.value.code is ExitCode.USAGE
    project = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text("utf-8"))["project"]
    (requirement,) = project["optional-dependencies"]["serial"]
    assert requirement.startswith("python-can[serial]")


def test_an_unknown_interface_is_a_wrong_setting() -> None:
    """It names the interface, and is a matter of usage."""
    with pytest.raises(CommandError, match="no-such") as error:
        open_bus(CanSettings(interface="no-such", channel="x"))
    assert error.value.code is ExitCode.USAGE


@pytest.mark.parametrize("channel", ["can0", "127.0.0.1", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:x/can0"])
def test_a_socketcand_channel_needs_host_and_port(channel: str) -> None:
    """Anything else is a wrong setting, and the line says what is wanted."""
    with pytest.raises(CommandError, match="HOST:PORT"):
        open_bus(CanSettings(interface="socketcand", channel=channel))


def test_no_server_is_a_lost_bus() -> None:
    """A refused connection is told at once (python-can alone would try for ten seconds)."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(BusLost, match="no socketcand server"):
            open_bus(CanSettings(interface="socketcand", channel=f"127.0.0.1:{taken.getsockname()[1]}"))


def test_a_missing_kernel_interface_is_a_lost_bus() -> None:
    """The interface may come later, so this is no wrong setting."""
    with pytest.raises(BusLost, match="socketcan nosuchcan"):
        open_bus(CanSettings(interface="socketcan", channel="nosuchcan"))


@pytest.mark.parametrize(
    "error", [OSError("pcanbasic library not found."), NameError("name 'canOpenChannel' is not defined")]
)
def test_a_missing_driver_is_no_matter_of_waiting(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """A library that is not installed will not come by itself: a matter of usage, which names the driver."""

    def without_library(**_arguments: object) -> can.BusABC:
        raise error

    monkeypatch.setattr(can, "Bus", without_library)
    with pytest.raises(CommandError, match=r"'pcan' cannot be used: its driver is not installed \(.*n") as caught:
        open_bus(CanSettings(interface="pcan", channel="PCAN_USBBUS1"))
    assert caught.value.code is ExitCode.USAGE
    assert str(error) in str(caught.value)


def test_a_vendors_device_that_is_missing_is_a_lost_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be plugged in later."""

    def without_device(**_arguments: object) -> can.BusABC:
        raise can.CanInitializationError("A PCAN Channel has not been initialized yet")

    monkeypatch.setattr(can, "Bus", without_device)
    with pytest.raises(BusLost, match="pcan PCAN_USBBUS1: A PCAN Channel"):
        open_bus(CanSettings(interface="pcan", channel="PCAN_USBBUS1"))


@contextmanager
def server(greeting: bytes) -> Iterator[tuple[str, Callable[[], None]]]:
    """A TCP server that greets, answers every line with ok, and hangs up when told to."""
    hang_up = threading.Event()

    def serve() -> None:
        while not hang_up.is_set():
            try:
                client, _ = listener.accept()
            except TimeoutError:
                continue
            client.settimeout(0.02)
            with client, suppress(ConnectionError):
                client.sendall(greeting)
                while not hang_up.is_set():
                    try:
                        if not client.recv(256):
                            break
                        client.sendall(b"< ok >")
                    except TimeoutError:
                        continue

    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.02)
        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield f"127.0.0.1:{listener.getsockname()[1]}", hang_up.set
        finally:
            hang_up.set()
            thread.join()


def test_a_server_that_does_not_speak_socketcand_is_told() -> None:
    """Whatever else listens there, the line says so."""
    with (
        server(b"SSH-2.0-OpenSSH_9.2\r\n") as (channel, _),
        pytest.raises(BusLost, match="does not speak the socketcand protocol"),
    ):
        open_bus(CanSettings(interface="socketcand", channel=channel))


def test_a_server_that_hangs_up_is_a_lost_bus() -> None:
    """python-can reads the end of the stream as silence for ever; we read it as a loss."""
    with server(b"< hi >") as (channel, hang_up):
        bus = open_bus(CanSettings(interface="socketcand", channel=channel))
        try:
            assert bus.receive(0.01) is None
            hang_up()
            with pytest.raises(BusLost, match="closed the connection"):
                wait_until(lambda: bus.receive(0.01) is not None)
        finally:
            bus.close()


class FakeBus:
    """A bus with failure knobs."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.drops = 0
        self.lost = ""
        self.room = 100
        self.lost_after = 100
        self.tried = 0
        self.closed = False
        self.may_close = threading.Event()
        self.may_close.set()

    def receive(self, timeout_s: float) -> Frame | None:
        if self.lost:
            raise BusLost(self.lost)
        if not self.frames:
            time.sleep(min(timeout_s, 0.001))
            return None
        return self.frames.pop(0)

    def send(self, frame: Frame) -> None:
        self.tried += 1
        if self.tried > self.lost_after:
            raise BusLost("Network is down")
        if self.room == 0:
            # The next one would have room again.
            self.room = 1
            raise BusFull("Transmit buffer full")
        self.room -= 1
        self.frames.append(frame)

    def close(self) -> None:
        assert self.may_close.wait(DEADLINE_S)
        self.closed = True


FRAME = Frame(EXTENDED | 0x18C4D1EF, bytes(8))


def test_a_lost_bus_is_opened_again() -> None:
    """While it is away there are no frames and it says why; afterwards frames come again."""
    first, second = FakeBus(), FakeBus()
    outcomes: list[FakeBus | str] = ["no such device", "no such device", second]

    def opener() -> FakeBus:
        outcome = outcomes.pop(0)
        if isinstance(outcome, str):
            raise BusLost(outcome)
        return outcome

    bus = ReconnectingBus(opener, first, first_pause_s=0.001, longest_pause_s=0.004)
    first.frames.append(FRAME)
    assert bus.receive(0.01) == FRAME
    first.lost = "Network is down"
    assert bus.receive(0.01) is None
    assert (bus.is_up, bus.losses) == (False, 1)
    assert bus.detail
    wait_until(lambda: (bus.receive(0.001), bus.is_up)[1])
    second.frames.append(FRAME)
    assert bus.receive(0.01) == FRAME
    assert (bus.is_up, bus.detail, bus.losses) == (True, "", 1)
    assert first.closed
    bus.close()
    assert second.closed


def test_a_lost_bus_that_is_slow_to_close_does_not_stop_the_loop() -> None:
    """The caller goes on at once; the bus is opened again only when the lost one is closed."""
    first, second = FakeBus(), FakeBus()
    closed_before: list[bool] = []

    def opener() -> FakeBus:
        closed_before.append(first.closed)
        return second

    bus = ReconnectingBus(opener, first, first_pause_s=0.001)
    first.may_close.clear()
    first.lost = "Network is down"
    assert bus.receive(0.01) is None
    assert (bus.losses, bus.is_up, first.closed) == (1, False, False)
    assert bus.receive(0.01) is None
    assert closed_before == []
    first.may_close.set()
    wait_until(lambda: (bus.receive(0.001), bus.is_up)[1])
    assert closed_before == [True]
    bus.close()


def test_a_bus_that_is_not_there_at_the_start_is_awaited() -> None:
    """Without a first bus it is down, not lost, and comes up when it can be opened."""
    present = FakeBus()
    bus = ReconnectingBus(lambda: present, None, first_pause_s=0.001)
    wait_until(lambda: (bus.receive(0.001), bus.is_up)[1])
    assert bus.losses == 0
    bus.close()
    assert present.closed


def test_closing_ends_the_search() -> None:
    """A bus that never comes does not keep the process alive."""

    def opener() -> FakeBus:
        raise BusLost("never")

    bus = ReconnectingBus(opener, None, first_pause_s=0.001)
    wait_until(lambda: bus.detail == "never")
    bus.close()
    assert not any(thread.name == "bus-opener" for thread in threading.enumerate())


class FailingDriver(can.BusABC):
    """A driver that can neither send nor receive, and says so with this error."""

    def __init__(self, error: Exception) -> None:
        super().__init__(channel="none")
        self.error = error

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        del msg, timeout
        raise self.error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        del timeout
        raise self.error


def test_a_frame_that_the_driver_does_not_take_is_full_and_a_failing_receive_is_a_loss() -> None:
    """A full transmit buffer and a lost cable look alike to who sends; ``receive`` tells them apart."""
    bus = CanBus(FailingDriver(can.CanOperationError("Transmit buffer full\nTraceback ...")))
    try:
        with pytest.raises(BusFull, match=r"^Transmit buffer full$"):
            bus.send(FRAME)
        with pytest.raises(BusLost, match=r"^Transmit buffer full$"):
            bus.receive(0)
    finally:
        bus.close()


@pytest.mark.parametrize("error", [OSError("Network is down"), ValueError("fd -1"), can.CanError("gone")])
def test_sending_on_a_closed_bus_is_a_loss(error: Exception) -> None:
    """python-can's own errors do not leave the port."""
    bus = CanBus(FailingDriver(error))
    try:
        with pytest.raises(BusLost, match=str(error)):
            bus.send(FRAME)
    finally:
        bus.close()


BURST = [Frame(EXTENDED | 0x18C4D1D0 + 0x10000 * number, bytes(8)) for number in range(5)]


def never_opened() -> FakeBus:
    """An opener of a bus that does not come back."""
    raise BusLost("never")


def test_a_burst_is_counted() -> None:
    """All frames of it go out, in their order."""
    first = FakeBus()
    bus = ReconnectingBus(never_opened, first)
    assert bus.send(BURST) == 5
    assert bus.send([]) == 0
    assert first.frames == BURST
    bus.close()


@pytest.mark.parametrize("room", range(5))
def test_a_burst_ends_with_the_first_frame_that_is_not_taken(room: int) -> None:
    """The rest of it is not tried, also where there would be room again; the bus is not lost by that."""
    first = FakeBus()
    bus = ReconnectingBus(never_opened, first)
    first.room = room
    assert bus.send(BURST) == room
    assert first.tried == room + 1
    assert (bus.is_up, bus.losses) == (True, 0)
    first.room = 100
    assert bus.send(BURST) == 5
    assert first.frames == BURST[:room] + BURST
    bus.close()


@pytest.mark.parametrize("room", range(5))
def test_a_bus_that_is_lost_in_the_midst_of_a_burst_says_how_far_it_came(room: int) -> None:
    """What was taken counts, the bus is down, and nothing of the burst goes to the bus that comes next."""
    first, second = FakeBus(), FakeBus()
    bus = ReconnectingBus(lambda: second, first, first_pause_s=0.001)
    first.lost_after = room
    assert bus.send(BURST) == room
    assert (bus.is_up, bus.losses, bus.detail) == (False, 1, "Network is down")
    assert bus.send(BURST) == 0
    wait_until(lambda: (bus.receive(0.001), bus.is_up)[1])
    assert second.frames == []
    assert bus.send(BURST[:2]) == 2
    assert (first.frames, second.frames) == (BURST[:room], BURST[:2])
    bus.close()


class DeafServer:
    """A socketcand server that opens the bus, and then reads nothing until it is told to."""

    def __init__(self) -> None:
        self.listen = threading.Event()
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
        """Hear what has come, to its end."""
        self.listen.set()
        self._thread.join()
        self._listener.close()

    def _serve(self) -> None:
        probe, _ = self._listener.accept()
        with probe:
            probe.sendall(b"< hi >")
        client, _ = self._listener.accept()
        with client:
            client.sendall(b"< hi >")
            for _ in ("open", "rawmode"):
                client.recv(256)
                client.sendall(b"< ok >")
            self.listen.wait(DEADLINE_S)
            try:
                while chunk := client.recv(65_536):
                    self.heard += chunk
                self.end = "closed"
            except ConnectionResetError:
                self.end = "reset"


def test_what_was_dropped_is_counted_from_one_bus_to_the_next() -> None:
    """Each counts from its own opening."""
    first, second = FakeBus(), FakeBus()
    bus = ReconnectingBus(lambda: second, first, first_pause_s=0.001)
    assert bus.drops == 0
    first.drops = 3
    assert bus.drops == 3
    first.lost = "Network is down"
    assert bus.receive(0.01) is None
    assert (bus.is_up, bus.drops) == (False, 3)
    wait_until(lambda: (bus.receive(0.001), bus.is_up)[1])
    second.drops = 4
    assert bus.drops == 7
    bus.close()


def test_a_server_that_reads_nothing_neither_holds_the_loop_nor_gets_stale_commands() -> None:
    """Whoever sends waits no longer than the timeout; the bus is lost, and what still waited is thrown away."""
    deaf = DeafServer()
    opened = open_bus(CanSettings(interface="socketcand", channel=deaf.channel))
    assert isinstance(opened, CanBus)
    stream = opened._socket
    assert stream is not None
    # The kernel holds whoever sends for so long, in whole ticks of its own, and no longer.
    kept_s, kept_us = struct.unpack("@ll", stream.getsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, 16))
    assert kept_s == 0
    assert SEND_TIMEOUT_US <= kept_us <= SEND_TIMEOUT_US + 10_000
    assert stream.gettimeout() is None, "or Python waits by itself, without that bound"
    bus = ReconnectingBus(never_opened, opened)
    taken = 0
    is_deaf = False
    # As long as the server's side takes them in they are gone at once; then they wait on ours.
    while (count := bus.send(BURST)) == len(BURST):
        taken += count
        assert taken < 10_000, "it takes frames without end"
        is_deaf = is_deaf or not comes_true(1.0, lambda: waiting_bytes(stream) == 0)
    taken += count
    assert bus.is_up, "a full bus is no lost one"
    assert waiting_bytes(stream) <= SEND_WAITING_MAX_BYTES + 200
    wait_until(lambda: bus.send(BURST) == 0 and not bus.is_up)
    assert bus.losses == 1
    wait_until(lambda: stream.fileno() == -1)
    deaf.join()
    heard = deaf.heard.count(b"< send ")
    assert deaf.end == "reset"
    assert 0 < heard < taken
    bus.close()


def test_a_bus_that_opens_and_is_lost_at_once_is_not_tried_without_end() -> None:
    """The pauses grow for it too."""
    opened: list[FakeBus] = []

    def opener() -> FakeBus:
        bus = FakeBus()
        bus.lost = "Network is down"
        opened.append(bus)
        return bus

    bus = ReconnectingBus(opener, opener(), first_pause_s=0.001, longest_pause_s=60)
    wait_until(lambda: (bus.receive(0.001), bus.losses >= 5)[1])
    assert bus._pause_s >= 0.001 * 2**4
    bus.close()
    assert all(one.closed for one in opened)

"""``cruiser sim`` and ``cruiser fault``, from the outside."""

import contextlib
import signal
import socket
import threading
from collections.abc import Callable, Iterator

import can
import pytest

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import IDENTIFIER_MASK
from gateway.chassis.layout import Encoder
from schemas.command_line import ExitCode
from schemas.messages import Variant
from tests.support.commands import in_process
from tests.support.processes.gateway import Running, chassis
from tests.support.processes.simulator import DEADLINE_S, Served, receive, served
from tests.support.rigs.chassis import ENABLES

BODY, WHEELS, GEAR = 0x18C4D9EF, 0x18C4D7EF, 0x18C4D1EF
ENCODER = Encoder(load(Variant.COARSE))


def bus_at(address: str) -> can.BusABC:
    host, _, port = address.rpartition(":")
    return can.Bus(interface="socketcand", host=host, port=int(port), channel="can0")


@pytest.fixture
def running() -> Iterator[Served]:
    with served() as chassis:
        yield chassis


def test_it_says_where_it_is_and_ends_on_sigterm() -> None:
    faults = ("--fault", "0.3s bumper rear on", "--fault", "foreign 123")
    with chassis("--variant", "fine", *faults) as (sim, address), bus_at(address) as bus:
        assert sim.said == [f"sim: fine chassis on {address}"]
        wheels = receive(bus, lambda message: message.arbitration_id == WHEELS)
        assert wheels.data[1:5] == bytes.fromhex("00800080")
        assert receive(bus, lambda message: message.arbitration_id == 0x123)
        assert receive(bus, lambda message: message.arbitration_id == BODY and message.data[4] == 0x10)
        assert sim.stop(signal.SIGTERM) == ExitCode.OK


def test_conditions_come_by_flag() -> None:
    faults = (word for fault in ("slope -20", "payload 50", "pedal 0.5") for word in ("--fault", fault))
    with chassis(*faults, "--stop-mode", "coasts") as (_, address), bus_at(address) as bus:
        for enable, least_mps in ((True, 0.1), (False, 4.0)):
            for name in ENABLES:
                frame = ENCODER.encode(name, {"Enable": enable}, 0)
                bus.send(can.Message(arbitration_id=frame.can_id & IDENTIFIER_MASK, data=frame.data))
            assert receive(bus, wheels_faster_than(least_mps))


def wheels_faster_than(least_mps: float) -> Callable[[can.Message], bool]:
    def is_faster(message: can.Message) -> bool:
        speed_mps = (int.from_bytes(message.data[1:3], "little") & 0x1FF) * 0.04 - 8
        return message.arbitration_id == WHEELS and speed_mps > least_mps

    return is_faster


def test_it_attaches_to_a_bus_of_python_can(running: Served) -> None:
    channel = f"{running.host}:{running.port}"
    words = ("--interface", "socketcand", "--channel", channel, "--fault", "foreign 321")
    with Running("sim", *words) as sim:
        sim.wait_says(f"^sim: coarse chassis on socketcand {channel}$")
        with running.bus() as bus:
            assert receive(bus, lambda message: message.arbitration_id == 0x321)
        running.end()
        assert sim.process.wait(30) == ExitCode.UNREACHABLE
        sim.wait_says("bus unavailable")


def test_seconds_end_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert in_process("sim", "--listen", "127.0.0.1:0", "--seconds", "0.05") == ExitCode.OK
    assert capsys.readouterr().err.count("\n") == 1


def test_fault_disturbs_a_running_chassis(running: Served, capsys: pytest.CaptureFixture[str]) -> None:
    place = f"{running.host}:{running.port}"
    assert in_process("fault", "--sim", place, "transmitter", "remote") == ExitCode.OK
    assert in_process("fault", "--sim", place, "sticks", "-0.5", "-10") == ExitCode.OK
    assert capsys.readouterr().out == "ok: transmitter remote\nok: sticks -0.5 -10\n"
    with running.bus() as bus:
        receive(bus, lambda message: message.arbitration_id == GEAR and message.data[1] == 2)


@pytest.mark.parametrize("speech", [b"", b"HTTP/1.1 400 Bad Request\r\n\r\n<html>", b"<" * 5000, b"< hi >"])
def test_another_server_is_not_taken_for_a_chassis(speech: bytes, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def speak() -> None:
            connection, _ = listener.accept()
            with connection, contextlib.suppress(OSError):
                connection.sendall(speech)
                connection.shutdown(socket.SHUT_WR)
                while connection.recv(1000):
                    pass

        speaker = threading.Thread(target=speak)
        speaker.start()
        port = listener.getsockname()[1]
        assert in_process("fault", "--sim", f"127.0.0.1:{port}", "clear") == ExitCode.UNREACHABLE
        speaker.join(DEADLINE_S)
    assert capsys.readouterr().err.count("\n") == 1

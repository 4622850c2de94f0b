"""The early stop on a real interface: alone after a power cut, and beside a gateway that starts meanwhile."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from gateway.chassis.cruiser import early_stop
from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.port import Actuation
from schemas.messages import GearPosition, Variant
from schemas.reasons import Reason
from tests.socketcan import commands
from tests.socketcan.can_utils import Candump, send
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, gateway, operator
from tests.support.fakes.peer import free_endpoint
from tests.support.waiting import wait_until

SPEED_MPS: Final = 1.0
MOTION_FRAMES: Final = 5
PARKING: Final = "Auto_ParkingFeedBack"


@pytest.fixture(autouse=True)
def places(vcan: Vcan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = tmp_path / "cruiser.toml"
    settings.write_text(f'[can]\nchannel = "{vcan.name}"\n', encoding="ascii")
    monkeypatch.setenv("CRUISER_CONFIG", str(settings))
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))


@contextmanager
def early(*words: str) -> Iterator[subprocess.Popen[str]]:
    """Run the early stop as its unit does, apart from the interpreter."""
    command = [sys.executable, "-I", "-S", "-E", early_stop.__file__, *words]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def left(vcan: Vcan, witness: Candump) -> Iterator[Vcan]:
    """A chassis that moves by the last command of a computer without power, and sends no parking feedback."""
    with chassis(vcan.name, "--variant", "fine", "--fault", f"silence {PARKING}"):
        told = Actuation(enabled=True, gear=GearPosition.DRIVE, speed_mps=SPEED_MPS, parking=False)
        for frame in FrameMaker().make(told, [], Variant.FINE):
            send(vcan.name, frame.identifier, frame.data)
        wait_until(lambda: moves(witness))
        yield vcan


def moves(witness: Candump) -> bool:
    """Report whether the last wheel speeds, of the fine variant, differ from 32768: they are at rest then."""
    wheels = [frame.data for frame in witness.frames if frame.can_id == commands.WHEEL_SPEEDS]
    return bool(wheels) and wheels[-1][1:5] != b"\0\x80\0\x80"


def check_stop(witness: Candump) -> None:
    told = commands.checked(commands.of(witness.frames)[MOTION_FRAMES:])
    assert {burst.speed_umps for burst in told} == {0}
    assert told[0].enables == "11111"
    assert any(burst.is_parked and burst.enables == "11111" for burst in told)
    assert told[-1].enables == "00000"


def test_a_robot_that_was_left_in_motion_is_stopped(left: Vcan, witness: Candump, tmp_path: Path) -> None:
    with early("--look", left.name) as looking:
        assert looking.wait(30) == early_stop.MOVES
    with early(left.name) as process:
        wait_until(lambda: "done: the robot stands" in note(tmp_path))
        assert process.poll() is None, "it watches on, until a gateway is there"
    check_stop(witness)
    assert not moves(witness)
    with early("--look", left.name) as looking:
        assert looking.wait(30) == 0


def test_a_gateway_that_starts_during_the_stop_leaves_it_to_it(
    left: Vcan, witness: Candump, tmp_path: Path
) -> None:
    endpoint = free_endpoint()
    with early(left.name) as process:
        # A gateway reads the note once, when it starts: the stop has begun by then.
        wait_until(lambda: note(tmp_path))
        with gateway(left.name, endpoint, "--log-level", "info") as running, operator(endpoint) as robot:
            wait_until(lambda: "done: the robot stands" in note(tmp_path))
            assert process.wait(30) == 0
            assert robot.wait_for(lambda state: Reason.GUARD in state.blocked_by, 30.0)
            assert Reason.OTHER_COMMANDER not in robot.state().state.blocked_by
            assert not [line for line in running.said if "other computer" in line]
    check_stop(witness)


def test_it_waits_for_an_interface_that_is_not_there_yet(vcan: Vcan) -> None:
    vcan.remove()
    with early(vcan.name) as process:
        vcan.create()
        with gateway(vcan.name, free_endpoint()):
            _, said = process.communicate(timeout=30)
        assert process.returncode == 0
        assert "a gateway is running" in said


def note(directory: Path) -> str:
    return "".join(path.read_text("utf-8") for path in directory.glob("*.guard-stop"))

"""A gateway that fails while it drives, on a real interface: what the guard sends, as candump sees it."""

import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import pytest

from tests.socketcan import commands
from tests.socketcan.can_utils import Candump, Dumped
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis, driving, gateway, operator
from tests.socketcan.turns import come_last
from tests.support.fakes.peer import free_endpoint
from tests.support.waiting import wait_until

SPEED_MPS: Final = 1.0
SPEED_RAW: Final = 1000
DISK_BYTES: Final = 256 * 1024
BURSTS_ON: Final = 300
SILENCE_US: Final = 1_000_000


def rests(witness: Candump) -> bool:
    """Somebody has told the chassis that nothing is enabled, which ends a stop, and has fallen silent."""
    sent = commands.of(witness.frames)
    disabled = [frame for frame in sent[-5:] if not frame.data[0] & 1]
    return len(disabled) == 5 and witness.frames[-1].at_us - sent[-1].at_us > SILENCE_US


def check_stop(sent: list[Dumped]) -> None:
    """The last of these commands are a whole stop, which went on where the gateway had left off."""
    commands.check_bytes(sent)
    commands.check_counters(sent)
    told = commands.bursts(sent, torn=1)
    speeds = [burst.speed_raw for burst in told]
    fastest = len(speeds) - 1 - speeds[::-1].index(SPEED_RAW)
    ramp = speeds[fastest:]
    assert ramp == sorted(ramp, reverse=True)
    assert len(set(ramp)) > 10, "it brakes by a ramp"
    assert ramp[-1] == 0
    parked = [burst.parking for burst in told[fastest:]]
    assert parked == sorted(parked), "the parking brake is not released again"
    assert any(burst.parking and all(burst.enables) for burst in told[fastest:])
    assert told[-1].enables == (False,) * 5


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=lambda number: number.name)
def test_the_guard_stops_the_robot_of_a_gateway_that_fails(
    vcan: Vcan, witness: Candump, number: signal.Signals
) -> None:
    """Killed or stopped at speed: the guard's frames go on with the counters, down to rest and silence.

    A gateway that was only stopped, and comes back, may end the burst in which it was stopped: the robot does
    not move again, and there is silence.
    """
    endpoint = free_endpoint()
    with (
        chassis(vcan.name, "--variant", "fine"),
        gateway(vcan.name, endpoint) as running,
        operator(endpoint) as robot,
    ):
        with driving(robot, SPEED_MPS):
            running.process.send_signal(number)
            wait_until(lambda: rests(witness))
        check_stop(commands.of(witness.frames))
        if number is signal.SIGSTOP:
            heard = len(witness.frames)
            running.process.send_signal(signal.SIGCONT)
            running.wait_says("the guard has stopped the robot")
            wait_until(lambda: len(witness.frames) > heard + 40 and rests(witness))
            wheels = [frame for frame in witness.frames[heard:] if frame.can_id == commands.WHEEL_SPEEDS]
            assert all(commands.stands(frame) for frame in wheels)


class SmallDisk:
    """A file system of its own with little room."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def fill(self) -> None:
        """Until not a byte more goes in."""
        with (
            (self.path / "filler").open("ab", buffering=0) as file,
            pytest.raises(OSError, match="No space left"),
        ):
            _write_for_ever(file)

    @property
    def is_full(self) -> bool:
        """Nothing has made room since."""
        return os.statvfs(self.path).f_bfree == 0


def _write_for_ever(file: io.FileIO) -> None:
    while True:
        file.write(bytes(512))


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[SmallDisk]:
    """Mounted."""
    path = tmp_path / "disk"
    path.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "small", str(path)], check=True)
    yield SmallDisk(path)
    subprocess.run(["umount", "--lazy", str(path)], check=True)


@contextmanager
def living_on(disk: SmallDisk, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A command of ours that has nothing but this disk: it works, logs and keeps its temporary files there."""
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": str(root), "TMPDIR": str(disk.path), "HOME": str(disk.path)}
    with (
        (disk.path / f"{words[0]}.log").open("wb") as log,
        subprocess.Popen(
            [sys.executable, "-m", "gateway", *words],
            cwd=disk.path,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        ) as process,
    ):
        try:
            yield process
        finally:
            process.kill()


def test_a_full_disk_does_not_stop_the_robot_and_the_guard_stops_it_all_the_same(
    vcan: Vcan, witness: Candump, disk: SmallDisk
) -> None:
    """The gateway's log has no room, nor has the recorder: it drives on, burst by burst; killed, it is stopped."""
    endpoint = free_endpoint()
    bus = ["--interface", "socketcan", "--channel", vcan.name, "--listen", endpoint, "--log-level", "debug"]
    with (
        chassis(vcan.name, "--variant", "fine"),
        living_on(disk, "gateway", *bus) as running,
        operator(endpoint) as robot,
        living_on(disk, "record", "--connect", endpoint, "-o", str(disk.path)) as recorder,
    ):
        wait_until(lambda: any(disk.path.glob("*.mcap*")))
        come_last(recorder.pid)
        with driving(robot, SPEED_MPS) as drive:
            disk.fill()
            full = len(commands.of(witness.frames))
            wait_until(lambda: len(commands.of(witness.frames)) > full + 5 * BURSTS_ON, drive.keep)
            # A file that the recorder began and gave up leaves room until it begins another.
            wait_until(lambda: disk.is_full, drive.keep)
            running.kill()
            wait_until(lambda: rests(witness))
    sent = commands.of(witness.frames)
    driven = commands.bursts(sent, torn=1)[full // 5 + 1 : full // 5 + BURSTS_ON]
    assert {burst.speed_raw for burst in driven} == {SPEED_RAW}
    check_stop(sent)

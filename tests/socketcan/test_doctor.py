"""``cruiser doctor`` and ``cruiser setup`` on an interface of the kernel's."""

import json
import os
from pathlib import Path

import pytest

from tests.socketcan.can_utils import Candump, send
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis
from tests.socketcan.test_controller import RECEIVE_PASSIVE
from tests.support.processes.gateway import Running, run


def findings(channel: str, *words: str) -> dict[str, str]:
    """By their names, with what cures them."""
    said = json.loads(run(["doctor", "--json", "--channel", channel, *words]).stdout)
    return {one["check"]: one["cure"] for one in said["findings"]}


def test_an_interface_is_missing_down_silent_and_well_in_turn(
    vcan: Vcan, candump: Candump, tmp_path: Path
) -> None:
    """Without a gateway; and nothing is sent meanwhile by anybody but the chassis."""
    logs = ["--logs", str(tmp_path)]
    assert "interface_missing" in findings("nowhere0", *logs)
    vcan.down()
    assert findings(vcan.name, *logs)["interface_down"] == f"ip link set {vcan.name} up"
    vcan.up()
    found = findings(vcan.name, *logs)
    assert "bus_silent" in found
    assert "queue_long" not in found
    assert candump.frames == []
    with chassis(vcan.name, "--variant", "fine"):
        found = findings(vcan.name, *logs)
    assert not {"bus_silent", "feedback_missing", "variant_unknown", "other_commander"} & set(found)
    assert "gateway_missing" in found


def test_error_frames_alone_are_another_bit_rate(vcan: Vcan, tmp_path: Path) -> None:
    """As a controller makes them that hears nothing it understands."""
    with Running("doctor", "--json", "--channel", vcan.name, "--logs", str(tmp_path)) as doctor:
        while doctor.process.poll() is None:
            send(vcan.name, *RECEIVE_PASSIVE)
        assert doctor.process.stdout is not None
        said = json.loads(doctor.process.stdout.read())
    assert "bit_rate" in {one["check"] for one in said["findings"]}


def test_setup_brings_an_interface_up_to_listen_and_leaves_it_as_it_was(vcan: Vcan, candump: Candump) -> None:
    """Nothing is on the bus: one line says so, and the interface is down again."""
    vcan.down()
    done = run(["setup", "--defaults", "--channel", vcan.name])
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "nothing is received on the bus" in done.stderr
    link = f"runs: ip link set {vcan.name}"
    assert [line for line in done.stdout.splitlines() if line.startswith("runs")] == [f"{link} up", f"{link} down"]
    assert "interface_down" in findings(vcan.name)
    assert candump.frames == []


def test_setup_refuses_a_read_only_file_system_before_it_writes(vcan: Vcan) -> None:
    """As this one is, wherever user-mode Linux runs the tests. The chassis is there, and that is said first."""
    if os.access("/var/lib", os.W_OK):
        pytest.skip("this file system can be written to")
    with chassis(vcan.name, "--variant", "fine"):
        done = run(["setup", "--defaults", "--channel", vcan.name])
    assert done.returncode == 1
    assert "the file system is mounted read-only: /var" in done.stderr
    assert done.stderr.count("\n") == 1

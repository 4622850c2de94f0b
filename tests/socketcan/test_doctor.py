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


@pytest.mark.skipif(os.access("/etc", os.W_OK), reason="it would set this computer up")
@pytest.mark.parametrize("is_up", [True, False])
def test_setup_says_what_it_cannot_write_and_leaves_the_bus_alone(
    vcan: Vcan, candump: Candump, *, is_up: bool
) -> None:
    """The file system is read-only where user-mode Linux runs the tests. An interface that is down stays so."""
    if not is_up:
        vcan.down()
    done = run(["setup", "--defaults", "--channel", vcan.name])
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "/etc/cruiser/cruiser.toml cannot be written: read-only file system" in done.stderr
    assert ("interface_down" in findings(vcan.name)) is not is_up
    assert candump.frames == []

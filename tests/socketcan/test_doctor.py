"""``cruiser doctor`` on an interface of the kernel's."""

import json
from pathlib import Path

from tests.socketcan.can_utils import Candump, send
from tests.socketcan.interface import Vcan
from tests.socketcan.road import chassis
from tests.socketcan.test_commands import RECEIVE_PASSIVE
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

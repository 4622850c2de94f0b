"""Modules of a robot's processes in open mode when their loops begin; no loop imports more."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Final

from gateway.client.robot import Robot
from schemas.settings import Settings, ZenohSettings
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import chassis
from tests.support.processes.holding import hold
from tests.support.waiting import wait_until

# Runs a command; notes the modules loaded when its loop is called, and imported until it ends.
PROBE: Final = """
import json, sys
from importlib import import_module
from gateway.cli.main import main

file, place, name, *words = sys.argv[1:]
command = import_module(place)
*owner, name = name.split(".")
for one in owner:
    command = getattr(command, one)
run = getattr(command, name)

def watched(*arguments):
    loaded, late = sorted(sys.modules), []
    sys.addaudithook(lambda event, seen: late.append(seen[0]) if event == "import" else None)
    try:
        return run(*arguments)
    finally:
        with open(file, "w", encoding="utf-8") as found:
            json.dump({"loaded": loaded, "late": list(late)}, found)

setattr(command, name, watched)
sys.exit(main(words))
"""
REVIEW: Final = {"numpy", "duckdb", "pyarrow", "foxglove", "can", "recorder.review", "recorder.reading"}
SIGNED: Final = {
    "cryptography",
    "gateway.authority",
    "gateway.host.signed_mode",
    "gateway.provisioning",
    "recorder.record.signed_mode",
    "schemas.authority.trust",
}
OTHERS: Final = {"asyncio", "can", "email", "http", "multiprocessing", "rich", "ssl"}


class Probe:
    """A command as a process, which writes the modules that it loaded to a file."""

    def __init__(self, file: Path, loop: tuple[str, str], words: list[str]) -> None:
        self._file = file
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROBE, str(file), *loop, *words],
            env=os.environ
            | {"CRUISER_GATEWAY_STATE_DIR": "", "CRUISER_COMMAND_SPEED_LIMIT_WITHOUT_REALTIME_MPS": "1"},
            stdout=subprocess.DEVNULL,
        )

    def ended(self) -> dict[str, Any]:
        self._process.terminate()
        self._process.wait(60)
        found: dict[str, Any] = json.loads(self._file.read_text("utf-8"))
        return found


def among(names: list[str], unwanted: set[str]) -> set[str]:
    return {one for one in names for name in unwanted if one == name or one.startswith(f"{name}.")}


def test_in_open_mode_only_what_it_takes_is_loaded_and_nothing_while_a_robot_is_driven(tmp_path: Path) -> None:
    """An import in the loop would delay the robot's commands."""
    endpoint = free_endpoint()
    with chassis() as (_, address):
        bus = ["--interface", "socketcand", "--channel", address]
        words = ["gateway", *bus, "--listen", endpoint]
        gateway = Probe(tmp_path / "gateway.json", ("gateway.cli.gateway", "run_loop"), words)
        words = ["record", "-o", str(tmp_path / "logs"), "--connect", endpoint]
        recorder = Probe(tmp_path / "recorder.json", ("recorder.loop", "RecorderLoop.run"), words)
        try:
            settings = Settings(zenoh=ZenohSettings(connect=[endpoint]))
            with Robot.connect("cruiser-1", "ann", settings, 60) as robot, robot.lease() as lease:
                driven = set()

                def drive() -> None:
                    hold(robot, lease, 0.3)
                    driven.add(round(robot.state().state.output_speed_mps, 1))

                wait_until(lambda: 0.3 in driven, drive)
        finally:
            found = {"gateway": gateway.ended(), "recorder": recorder.ended()}
    for name, one in found.items():
        assert not among(one["loaded"], SIGNED | REVIEW | OTHERS), name
    assert found["gateway"]["late"] == []

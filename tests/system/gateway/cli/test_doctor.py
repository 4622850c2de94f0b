"""``cruiser doctor`` with chassis, gateway and recorder, all as processes."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, chassis, gateway, run
from tests.support.waiting import wait_until

ELSEWHERE = {"realtime", "clock_unsynchronised"}  # findings that depend on the machine on which the tests run


@pytest.fixture
def bus() -> Iterator[str]:
    with chassis() as (_, address):
        yield address


def examine(address: str, *words: str, interface: str = "socketcand") -> tuple[int, dict[str, str], str]:
    """Return exit code, findings by name, and summary; for the settings' bus if the address is empty."""
    bus = ["--interface", interface, "--channel", address] if address else []
    done = run(["doctor", "--json", *bus, *words])
    said: dict[str, Any] = json.loads(done.stdout)
    found = {one["check"]: f"{one['text']} -> {one['cure']}" for one in said["findings"]}
    must = {one["check"] for one in said["findings"] if not one["is_note"]}
    assert said["ok"] == (not must) == (done.returncode == 0), done.stderr
    return done.returncode, {name: text for name, text in found.items() if name not in ELSEWHERE}, said["summary"]


def fault(address: str, *words: str) -> None:
    assert run(["fault", "--sim", address, *words]).returncode == 0


def test_a_robot_that_runs_and_is_recorded_is_well(bus: str, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    words = ["--connect", endpoint, "--logs", str(tmp_path)]
    with gateway(bus, endpoint), Running("record", "-o", str(tmp_path), "--connect", endpoint) as recorder:
        recorder.wait_says("record: ")
        done = run(["doctor", "--interface", "socketcand", "--channel", bus, *words])
        # The recorder of a busy machine may miss samples.
        elsewhere = [*ELSEWHERE, "note: losses"]
        lines = [line for line in done.stdout.splitlines() if not any(name in line for name in elsewhere)]
        reach, lines = lines[:5], lines[5:]
        assert reach[0].startswith("the settings allow 1.00 m/s")
        assert done.stderr == ""
        if done.returncode == 0:
            assert lines == ["standing, feedback complete, guarded, recording, open to this machine alone"]
        else:
            assert lines == []
            assert "realtime" in done.stdout


def test_the_bus_of_the_gateway_that_runs_is_looked_at(bus: str, tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with gateway(bus, endpoint):
        found = examine("", "--connect", endpoint, "--logs", str(tmp_path))[1]
        named = examine("can9", "--connect", endpoint, "--logs", str(tmp_path), interface="socketcan")[1]
    assert f"socketcand {bus}, and not socketcan can0" in found["other_bus"]
    assert not {"interface_missing", "bus_unreachable"} & set(found)
    assert "interface_missing" in named, "who names a bus wants to know of that one"


def test_without_a_gateway_the_bus_itself_is_listened_to(bus: str, tmp_path: Path) -> None:
    logs = ["--logs", str(tmp_path), "--timeout", "0.5"]

    def finds() -> tuple[int, list[str], str]:
        code, found, summary = examine(bus, *logs, "--timeout", "2")
        return code, list(found), summary

    # A busy machine may hold up the chassis, or who listens; then frames are missing indeed.
    wait_until(lambda: finds() == (1, ["gateway_missing"], ""))
    fault(bus, "silence", "Auto_GearFeedBack")
    assert "Auto_GearFeedBack" in examine(bus, *logs)[1]["feedback_missing"]

"""Commands to a large fleet, as processes."""

import json
import os
import subprocess
import sys

import pytest

from schemas.command_line import ExitCode
from tests.support.fakes.fleet import LEASE_MS, FakeFleet
from tests.support.processes.busy import burning

pytestmark = pytest.mark.night

ENDS_S = 100  # far beyond any timeout that is given here


def cruiser(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "gateway", *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=ENDS_S,
        env=os.environ | {"CRUISER_ZENOH_LEASE_MS": str(LEASE_MS)},
    )


def test_a_stop_of_a_large_fleet_ends_and_hears_every_robot() -> None:
    """Each answers. That they stand is not seen: these publish nothing."""
    with FakeFleet(400) as fleet:
        ended = cruiser("stop", "--all", "--json", "--timeout", "15", "--connect", fleet.listen)
        report = json.loads(ended.stdout)
    assert (sorted(report["unconfirmed"]), report["silent"], report["refused"]) == (fleet.names, [], {})
    assert (report["counted"], ended.returncode) == (True, ExitCode.PARTIAL)


def test_a_stop_of_a_large_fleet_is_seen_while_the_machine_is_busy() -> None:
    """All publish that they stand, at a robot's rate, while both processors are busy."""
    with FakeFleet(400, publishes=True) as fleet, burning():
        ended = cruiser("stop", "--all", "--json", "--timeout", "60", "--connect", fleet.listen)
        report = json.loads(ended.stdout)
    assert (report["stopped"], report["unconfirmed"], report["silent"]) == (fleet.names, {}, [])
    assert (report["counted"], ended.returncode) == (True, 0)


def test_a_large_fleet_is_listed_whole() -> None:
    """A line per robot, after one on all of them."""
    with FakeFleet(1000) as fleet:
        ended = cruiser("list", "--timeout", "8", "--connect", fleet.listen)
    told, *lines = ended.stdout.splitlines()
    assert told == "1000 offline"
    assert [line.split()[0] for line in lines] == fleet.names
    # They send no state.
    assert ended.returncode == 3
    assert ended.stderr.startswith("no contact with robot-0000, ")

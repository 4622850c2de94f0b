"""Commands to a whole fleet, as processes of their own, where the fleet is large."""

import json
import subprocess
import sys

import pytest

from tests.gateway.remote.fake_fleet import FakeFleet

ENDS_S = 60
"""Far beyond any timeout that is given here: what is still running then hangs."""


def cruiser(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        [sys.executable, "-m", "gateway", *words], capture_output=True, text=True, check=False, timeout=ENDS_S
    )


@pytest.mark.parametrize("count", [400, 1000])
def test_a_stop_of_a_large_fleet_ends_and_names_every_robot(count: int) -> None:
    """Each robot answers, and nobody is said to be silent."""
    with FakeFleet(count) as fleet:
        ended = cruiser("stop", "--all", "--json", "--timeout", "30", "--connect", fleet.listen)
        report = json.loads(ended.stdout)
    assert (report["stopped"], report["silent"], report["refused"]) == (fleet.names, [], {})
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_large_fleet_is_listed_whole() -> None:
    """Every robot that is connected has its line."""
    with FakeFleet(1000) as fleet:
        ended = cruiser("list", "--timeout", "8", "--connect", fleet.listen)
    assert [line.split()[0] for line in ended.stdout.splitlines()] == fleet.names
    assert (ended.returncode, ended.stderr) == (0, "")

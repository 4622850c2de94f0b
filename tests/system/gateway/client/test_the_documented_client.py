"""The client in docs/commands.md, as a program."""

import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from schemas.decisions import ArbiterState
from tests.support.fakes.robot import FakeRobot
from tests.support.processes.tcp_link import TcpLink
from tests.support.waiting import wait_until

PAGE = Path(__file__).parents[4] / "docs" / "commands.md"
ENDPOINT = "tcp/127.0.0.1:7447"
LINES_MAX = 39


def documented() -> str:
    section = PAGE.read_text(encoding="utf-8").partition("### A whole client\n")[2].partition("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("    ") or not line]
    return textwrap.dedent("\n".join(lines)).strip()


def test_it_is_short() -> None:
    assert len([line for line in documented().splitlines() if line]) <= LINES_MAX


@pytest.mark.parametrize("one_way_s", [0.0, 0.2])
def test_it_drives_near_and_far(one_way_s: float) -> None:
    """Row 'travel delay': 200 ms one way."""
    with FakeRobot() as fake:
        with TcpLink(fake.listen, lambda: one_way_s) as link:
            program = documented()
            assert ENDPOINT in program
            done = subprocess.run(
                [sys.executable, "-c", program.replace(ENDPOINT, link.endpoint)],
                capture_output=True,
                text=True,
                timeout=60,
                check=False,
            )
        assert (done.returncode, done.stderr) == (0, "")
        assert {one.requested_speed_mps for one in fake.accepted("drive")} == {0.0, 0.5}
        assert max(one.output_speed_mps for one in fake.accepted("drive")) == 0.5
        wait_until(lambda: fake.state is ArbiterState.STANDBY)
        assert fake.accepted("release")

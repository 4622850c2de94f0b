"""When files that were installed anew have a gateway started again."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway.host.signed_mode import WAITS, Renewal
from schemas.settings import AuthoritySettings, Settings
from tests.support.provisioning import ProvisionedFleet, run


class Robot:
    """A robot's files."""

    def __init__(self, place: Path) -> None:
        self.fleet = ProvisionedFleet(place)
        self.files = self.fleet.let_in("robot", "cruiser-1")
        self.settings = Settings(authority=AuthoritySettings(mode="signed", directory=str(self.files)))

    def renew(self) -> None:
        request = self.fleet.place / "again.request"
        run("renew", "robot", "--directory", self.files, "-o", request)
        run("install", self.fleet.sign(request), "--directory", self.files, "--replace")


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Robot:
    """A robot that was provisioned."""
    monkeypatch.chdir(tmp_path)
    return Robot(tmp_path)


def looks(renewal: Renewal, number: int = 3) -> list[bool]:
    return [renewal.look() for _ in range(number)]


def test_an_installation_ends_the_gateway_once_two_looks_agree(robot: Robot) -> None:
    """It writes several files. Whoever looks in between waits."""
    renewal = Renewal(robot.settings, is_managed=True)
    assert looks(renewal) == [False] * 3
    robot.renew()
    assert looks(renewal, 2) == [False, True]
    assert (renewal.is_taken, renewal.note) == (True, "")


def test_a_robot_that_gets_its_first_grant_is_started_again(robot: Robot) -> None:
    """Files that are missing have nothing started."""
    grant = robot.files / "robot.grant"
    text = grant.read_text()
    grant.unlink()
    renewal = Renewal(robot.settings, is_managed=True)
    assert looks(renewal) == [False] * 3
    grant.write_text(text)
    assert looks(renewal, 2) == [False, True]


def test_a_gateway_that_nobody_starts_again_stays_and_says_so(robot: Robot) -> None:
    """As in a terminal, or in a container."""
    renewal = Renewal(robot.settings, is_managed=False)
    robot.renew()
    assert looks(renewal) == [False] * 3
    assert (renewal.is_taken, renewal.note) == (False, WAITS)

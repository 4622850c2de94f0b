"""A fleet whose authority is replaced while its robot is driven: every process is renewed and restarted in turn.

In the order of docs/authority.md, "Lost and stolen". With Zenoh's own router too: ``make test-zenohd``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

import pytest

from gateway.cli.configuration_file import load_settings
from gateway.client.refusal import LeaseLost, Refused, Stopped, Unreachable, is_idle
from gateway.client.robot import Lease, Robot
from schemas.command_line import CommandError
from schemas.reasons import TEXTS, Reason
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Managed, chassis
from tests.support.provisioning import ProvisionedFleet, run
from tests.support.routers import router_process
from tests.support.signed_site import speed_of
from tests.support.waiting import wait_until

ROBOT: Final = "cruiser-1"
ROUTER: Final = "127.0.0.1"
WANTED_MPS: Final = 0.5
UNDRIVEN: Final = "stopping: "
"""By its deadman; on a busy machine another rule may have been first."""
UNGRANTED: Final = f"ann loses the lease: {TEXTS[Reason.GRANT_REVOKED].means}; its authority was replaced"
STARTED_AGAIN: Final = "the gateway ends, and is started again with them"


class Rotation:
    """A fleet, the authority that follows the first one, and the processes of router and robot."""

    def __init__(self, place: Path, stack: ExitStack) -> None:
        endpoint = free_endpoint().replace("tcp/", "tls/")
        self.first = ProvisionedFleet(place / "first", endpoint)
        self.second = ProvisionedFleet(place / "second", endpoint)
        self.machines = self.first.place
        for role, name in (("router", ROUTER), ("robot", ROBOT), ("operator", "ann"), ("operator", "bea")):
            self.first.let_in(role, name)
        self._router = stack.enter_context(ExitStack())
        self.start_router()
        _, address = stack.enter_context(chassis())
        bus = ("--interface", "socketcand", "--channel", address)
        settings = str(self.machines / ROBOT / "robot.toml")
        self.gateway = stack.enter_context(Managed("gateway", "--config", settings, *bus))
        self.gateway.wait_says("a Zenoh node is connected")

    def restart_router_in_drive(self, lease: Lease) -> None:
        """End the router, see the drive end, and start it from its files as they are now.

        A router that is back within the deadman's time ends no drive.
        """
        self._router.close()
        self.loses_drive(lease, UNDRIVEN)
        self.start_router()

    def start_router(self) -> None:
        """Start the router from its files as they are now."""
        self._router.enter_context(router_process(self.machines / ROUTER / "router.json5"))

    def renew(self, role: str, name: str) -> None:
        """Let somebody in anew, by the second authority: the same keys."""
        request = self.machines / f"{role}-{name}.request"
        run("renew", role, "--directory", self.machines / name, "-o", request, "--replace")
        limits = ("--speed-limit", WANTED_MPS) if role == "operator" else ()
        run("sign", request, "--directory", self.second.place / "authority", "--replace", *map(str, limits))
        compared = ("--replace", "--fingerprint", self.second.fingerprint)
        run("install", request.with_suffix(".bundle"), "--directory", self.machines / name, *compared)

    @contextmanager
    def showing(self) -> Iterator[subprocess.Popen[str]]:
        """The robot is shown meanwhile that the second authority follows, by whoever says the standby's words."""
        statement = self.machines / "rotation.statement"
        active = self.second.place / "authority" / "authority.json"
        run("rotate", active, "--directory", self.first.place / "standby", "-o", statement)
        with subprocess.Popen(
            [sys.executable, "-m", "gateway", "provision", "show", str(statement), "--all"],
            env=os.environ | {"CRUISER_CONFIG": str(self.machines / "ann" / "operator.toml")},
            stdout=subprocess.PIPE,
            text=True,
        ) as process:
            yield process

    def connect(self, operator: str = "ann") -> Robot:
        """An operator, with her files as they are now."""
        settings = load_settings(str(self.machines / operator / "operator.toml"), {}, {})
        return Robot.connect(ROBOT, settings=settings, timeout_s=10.0)

    @contextmanager
    def driving(self) -> Iterator[Lease]:
        """The robot drives. On a busy machine it may stop by its rules before: then it is engaged anew."""
        self.gateway.said.clear()
        with ExitStack() as stack:
            found: list[Lease] = []

            def begin() -> None:
                with suppress(Stopped, Unreachable, LeaseLost, Refused, CommandError):
                    found.append(stack.enter_context(self._driving()))

            wait_until(lambda: bool(found), begin, deadline_s=120)
            yield found[0]

    @contextmanager
    def _driving(self) -> Iterator[Lease]:
        with self.connect() as robot, robot.lease() as lease:
            robot.wait_for(lambda state: is_idle(state.blocked_by), 30)
            lease.engage()
            lease.unpark()
            wait_until(lambda: speed_of(robot) > WANTED_MPS / 2, lambda: lease.drive(WANTED_MPS))
            yield lease

    def loses_drive(self, lease: Lease, words: str) -> None:
        """The drive that is under way ends in a controlled stop, and the gateway says why."""

        def drive() -> None:
            with suppress(Stopped, Unreachable, LeaseLost, Refused):
                lease.drive(WANTED_MPS)

        try:
            wait_until(lambda: self.has_said(words), drive)
        except TimeoutError as error:
            raise AssertionError(self.gateway.said) from error
        self.gateway.wait_says("stopped: ")

    def has_said(self, words: str) -> bool:
        return any(words in line for line in list(self.gateway.said))


@pytest.fixture
def rotation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rotation]:
    """The fleet of this test; its robot is on the network."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with ExitStack() as stack:
        yield Rotation(tmp_path, stack)


@pytest.mark.night
@pytest.mark.timeout(400)
def test_a_fleet_is_driven_through_the_change_of_its_authority(rotation: Rotation) -> None:
    """Whatever is restarted or replaced in mid-drive, the robot stops by its rules, and is driven again."""
    router, authority = rotation.machines / ROUTER, rotation.second.place / "authority"
    old, new = ((place / "ca.pem").read_text() for place in (router, authority))
    with rotation.driving() as lease:
        (router / "ca.pem").write_text(old + new)
        (authority / "ca.pem").write_text(new + old)
        rotation.restart_router_in_drive(lease)
    with rotation.driving() as lease, rotation.showing() as showing:
        rotation.loses_drive(lease, UNGRANTED)
        assert "taken over" in showing.communicate(timeout=60)[0]
    rotation.renew("robot", ROBOT)
    rotation.gateway.wait_says(STARTED_AGAIN)
    rotation.renew("operator", "ann")
    (authority / "ca.pem").write_text(new)
    with rotation.driving() as lease:
        rotation.renew("router", ROUTER)
        rotation.restart_router_in_drive(lease)
    with rotation.driving():
        pass
    with pytest.raises(CommandError, match=r"lets this machine in"):
        # Whom nobody renewed is let in no more.
        rotation.connect("bea")

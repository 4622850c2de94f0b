"""A robot's own files, ``doctor`` against its router, and its renewal: real processes."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest

from gateway.cli.configuration_file import load_settings
from gateway.client.refusal import Refused, is_idle
from gateway.client.robot import Robot
from gateway.zenoh.inbox import AGAIN_S
from schemas.command_line import ExitCode
from schemas.decisions import ArbiterState
from schemas.messages import Mode
from schemas.reasons import Reason
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Managed, Running, chassis, run
from tests.support.processes.guard import listening
from tests.support.processes.other_computer import leave_rolling
from tests.support.provisioning import ProvisionedFleet
from tests.support.provisioning import run as provision
from tests.support.routers import router_process
from tests.support.waiting import wait_until

ROBOT: Final = "cruiser-1"
AGAIN: Final = "the gateway restarts to load them"

REFUSING: Final = {Reason.SELF_TEST, Reason.NO_LEASE, Reason.NOT_ENGAGED}

Damage = Callable[[Any], None]  # changes a Zenoh file


class Fleet(ProvisionedFleet):
    """A router, a robot and an operator on loopback."""

    def __init__(self, place: Path) -> None:
        super().__init__(place, free_endpoint().replace("tcp/", "tls/"))
        self.let_in("router", "127.0.0.1")
        self.let_in("robot", ROBOT)
        self.let_in("operator", "ann")

    @property
    def router_file(self) -> Path:
        return self.place / "127.0.0.1" / "router.json5"

    @property
    def robot_files(self) -> Path:
        return self.place / ROBOT

    @property
    def operator_file(self) -> Path:
        return self.place / "ann" / "operator.toml"

    def router(self) -> AbstractContextManager[None]:
        return router_process(self.router_file)

    @contextmanager
    def gateway(self, *words: str) -> Iterator[Running]:
        with chassis() as (_, address):
            bus = ["--interface", "socketcand", "--channel", address]
            with Managed("gateway", "--config", str(self.robot_files / "robot.toml"), *bus, *words) as running:
                running.wait_says("^gateway: ")
                yield running

    @contextmanager
    def running(self) -> Iterator[Running]:
        with self.router(), self.gateway() as running:
            yield running

    def connect(self) -> Robot:
        return Robot.connect(ROBOT, settings=load_settings(str(self.operator_file), {}, {}), timeout_s=10.0)

    def why(self) -> str:
        return run(["why", ROBOT, "--config", str(self.operator_file)]).stdout

    def engages(self) -> None:
        with self.connect() as robot:
            waits(robot)
            with robot.lease() as lease:
                lease.engage()

    def refuses(self) -> None:
        with self.connect() as robot:
            wait_until(lambda: set(robot.state().state.blocked_by) <= REFUSING)
            with robot.lease() as lease, pytest.raises(Refused) as refused:
                lease.engage()
        assert refused.value.reason is Reason.SELF_TEST


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fleet:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return Fleet(tmp_path)


def waits(robot: Robot) -> None:
    """Wait until the robot only lacks a driver: its guard watches."""
    wait_until(lambda: is_idle(robot.state().state.blocked_by))


def change(file: Path, damage: Damage) -> None:
    said = json.loads(file.read_text("utf-8"))
    damage(said)
    file.write_text(json.dumps(said), "utf-8")


def switched_off(said: Any) -> None:  # noqa: ANN401 - JSON
    said["access_control"]["enabled"] = False


@pytest.mark.parametrize("damage", [None, switched_off])
def test_doctor_tries_to_get_past_the_router(fleet: Fleet, damage: Damage | None) -> None:
    """Beside a running gateway: a sound router shuts it out; of an open one doctor names the file."""
    if damage is not None:
        change(fleet.router_file, damage)
    words = ["doctor", "--config", str(fleet.robot_files / "robot.toml"), "--intrude", "--json"]
    with fleet.running():
        found = {one["check"]: one["text"] for one in json.loads(run(words).stdout)["findings"]}
        fleet.engages()
    if damage is None:
        assert ("hole" in found, "shut_out" in found) == (False, True), found
    else:
        assert found["hole"].startswith("a certificate without rights gets past the router: "), found


def test_a_robot_whose_own_file_lets_anybody_in_is_not_engaged(fleet: Fleet) -> None:
    """The file alone is read; all its faults: tests/unit/gateway/host."""
    file, words = fleet.robot_files / "robot.json5", "access_control.enabled is not true"
    change(file, switched_off)
    cure = "'cruiser provision install --replace' writes it"
    with fleet.running() as process:
        process.wait_says(words)
        fleet.refuses()
        assert f"needs attention: self_test: {file}: {words}; {cure}" in fleet.why()


def test_a_gateway_whose_router_is_away_starts_and_joins_it_later(fleet: Fleet) -> None:
    """It logs once what it waits for."""
    with fleet.gateway() as process:
        away = r"no connection to tls/127\.0\.0\.1:\d+: .*; the robot is off the network"
        process.wait_says(away)
        # The chassis is seen: the loop runs.
        process.wait_says("the bus is up")
        time.sleep(3 * AGAIN_S)
        assert len([line for line in process.said if re.search(away, line)]) == 1, process.said
        with fleet.router():
            process.wait_says("the robot is on the network")
            fleet.engages()


def test_a_robot_whose_router_is_away_is_stopped_all_the_same(fleet: Fleet) -> None:
    """It was left rolling: safety on the robot needs no network."""
    words = ["--config", str(fleet.robot_files / "robot.toml"), "--interface", "socketcand", "--channel"]
    with chassis() as (_, address), listening(address) as listener:
        leave_rolling(address, listener)
        with Running("gateway", *words, address) as process:
            process.wait_says("the robot is off the network")
            wait_until(lambda: listener.stands() and listener.mode() is Mode.STOP)
            assert process.stop() == ExitCode.OK


def test_renewed_files_are_taken_over_while_the_robot_stands_and_nobody_holds_its_lease(fleet: Fleet) -> None:
    """Not before: a restart would release the robot."""
    certificate = fleet.robot_files / "robot-tls.pem"
    with fleet.running() as process:
        with fleet.connect() as robot:
            waits(robot)
            with robot.lease() as lease:
                lease.engage()
                before = certificate.read_text()
                renew(fleet)
                assert certificate.read_text() != before
                if not robot.state().state.engaged:
                    # A busy machine held it up while its files were renewed, and it obeyed no more by its rules.
                    if robot.state().state.latched:
                        wait_until(lambda: robot.state().state.state is ArbiterState.STANDBY)
                        lease.reset()
                    waits(robot)
                    lease.engage()
                lease.unpark()
                began_s = time.monotonic()
                wait_until(lambda: time.monotonic() - began_s > 3, lambda: lease.drive(0.3))
                assert robot.state().state.engaged
        assert not any(AGAIN in line for line in process.said)
        process.wait_says(AGAIN)
        fleet.engages()
        assert process.stop() == 0


@pytest.mark.night
def test_a_latched_stop_outlives_a_renewal(fleet: Fleet) -> None:
    """It delays no renewal, and stays latched, with its reason, until a reset."""
    with fleet.running() as process:
        with fleet.connect() as robot:
            waits(robot)
            robot.stop()
        renew(fleet)
        process.wait_says(AGAIN)
        process.wait_says("latched until a reset: a remote stop was received")
        with fleet.connect() as robot:
            wait_until(lambda: is_idle({*robot.state().state.blocked_by} - {Reason.REMOTE_STOP}))
            assert robot.state().state.latched == [Reason.REMOTE_STOP]
            with robot.lease() as lease:
                with pytest.raises(Refused) as refused:
                    lease.engage()
                assert refused.value.reason is Reason.REMOTE_STOP
                lease.reset()
        fleet.engages()


def renew(fleet: Fleet) -> None:
    """Renew the robot's certificates and its grant, as docs/authority.md says."""
    request = fleet.place / "again.request"
    provision("renew", "robot", "--directory", fleet.robot_files, "-o", request)
    bundle = fleet.sign(request)
    provision("install", bundle, "--directory", fleet.robot_files, "--replace")

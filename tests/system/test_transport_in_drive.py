"""A drive whose connection is attacked, or ends: real processes, mutual TLS, a witness on the bus."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import pairwise
from pathlib import Path
from typing import Final

import msgspec
import pytest

from gateway.authority.enrolment import TransportRole
from gateway.chassis.frame import EXTENDED
from gateway.client import remote_stop
from gateway.client.refusal import LeaseLost, Stopped, Unreachable
from gateway.client.robot import Robot
from gateway.provisioning.key_files import LEAF_DAYS
from schemas.command_line import CommandError
from schemas.reasons import TEXTS, Reason
from schemas.settings import AuthoritySettings, ZenohSettings
from tests.support import bus_rules
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, chassis
from tests.support.processes.guard import Listener, listening
from tests.support.provisioned import write_authority
from tests.support.routers import router_process
from tests.support.secured import Network
from tests.support.signed_site import LIMIT_MPS, ROBOT, WANTED_MPS, Site, driving
from tests.support.waiting import wait_until

LIFE_S: Final = 25  # of the certificate that expires; the drive begins within it, also on a busy machine
BIT_MPS: Final = bus_rules.COARSE_UMPS / 1e6  # of the virtual chassis
FLOODERS: Final = 3
HANDSHAKES: Final = 120  # of each flooder; one without an answer within half a second stays open
# Handshakes without a certificate, with garbage, and unfinished ones; 50 at a time.
FLOODER: Final = """
import os, socket, ssl, sys
host, port, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
context = ssl.create_default_context()
context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
opened = []
for number in range(count):
    try:
        link = socket.create_connection((host, port), 0.5)
        if number % 3 == 0:
            link = context.wrap_socket(link)
        elif number % 3 == 1:
            link.sendall(b"\\x16\\x03\\x01\\x02\\x00" + os.urandom(200))
        opened.append(link)
    except OSError:
        pass
    if len(opened) > 50:
        opened.pop(0).close()
print("done", flush=True)
"""


def speeds_on(listener: Listener) -> list[int]:
    """The commanded speeds so far, signed, in ``BIT_MPS``."""
    frames = [one for burst in list(listener.bursts) for one in list(burst.frames)]
    drives = [one.data for one in frames if one.can_id == bus_rules.DRIVE | EXTENDED]
    raws = [bus_rules.value(bus_rules.DRIVE, "v", data) for data in drives]
    return [raw - 2**16 if raw >= 2**15 else raw for raw in raws]


class SecuredSite(Site):
    def __init__(self, directory: Path) -> None:
        super().__init__(directory)
        self.network = Network(directory, free_endpoint().replace("tcp/", "tls/"))
        self.router_file = self.network.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5"
        robot = self.network.node(TransportRole.ROBOT, ROBOT, ROBOT) / "robot.json5"
        with Path(self.robot_settings).open("a") as file:
            file.write(f'[zenoh]\nconfig = "{robot}"\n')
        self.connect_operator("ann", int(time.time()))

    def connect_operator(self, name: str, born_s: int) -> None:
        node = self.network.node(TransportRole.OPERATOR, name, born_s=born_s)
        self.settings = msgspec.structs.replace(
            self.settings, zenoh=ZenohSettings(config=str(node / "operator.json5"))
        )


@contextmanager
def running(site: SecuredSite) -> Iterator[tuple[Running, Listener]]:
    with ExitStack() as stack:
        stack.enter_context(router_process(site.router_file))
        _, address = stack.enter_context(chassis())
        bus = ("--interface", "socketcand", "--channel", address)
        gateway = stack.enter_context(Running("gateway", *bus, "--config", site.robot_settings))
        gateway.wait_says("^gateway: ")
        yield gateway, stack.enter_context(listening(address))


@pytest.fixture
def site(tmp_path: Path) -> SecuredSite:
    return SecuredSite(tmp_path)


def assert_lawful(speeds: list[int]) -> None:
    """No speed exceeds the grant's, and none rises by more than one bit per burst."""
    limit = round(LIMIT_MPS / BIT_MPS)
    assert speeds
    assert 0 <= min(speeds) <= max(speeds) <= limit
    assert all(later - former <= 1 for former, later in pairwise(speeds))


@pytest.mark.long
@pytest.mark.night
def test_a_certificate_that_ends_in_mid_drive_ends_the_drive_in_a_controlled_stop(site: SecuredSite) -> None:
    """The deadman stops the robot along its ramp, and the operator cannot reconnect."""
    with running(site) as (gateway, witness):
        ends_s = int(time.time()) + LIFE_S
        site.connect_operator("ends-soon", ends_s - LEAF_DAYS * 86_400)
        with driving(site) as (_, lease):
            gateway.said.clear()
            with pytest.raises((Stopped, Unreachable, LeaseLost)):
                wait_until(lambda: False, lambda: lease.drive(WANTED_MPS))
            is_early = time.time() < ends_s
            # On a busy machine another rule, or the guard, may end the drive before the certificate ends.
            why = gateway.wait_says("stopping: .*|the guard has stopped the robot")[0]
            assert is_early or TEXTS[Reason.DEADMAN].means in why
            gateway.wait_says("stopped: at standstill, no commands sent|the guard's stop has ended: .* stands")
        wait_until(lambda: time.time() > ends_s + 1)
        told = speeds_on(witness)
        assert_lawful(told)
        assert max(told) * BIT_MPS > LIMIT_MPS / 2
        ramp = told[len(told) - told[::-1].index(max(told)) :]
        assert ramp == sorted(ramp, reverse=True)
        assert len({speed for speed in ramp if speed}) > 2
        assert ramp[-1] == 0
        with pytest.raises(CommandError, match=r"operator-tls\.pem ended .* days ago; 'cruiser provision renew"):
            Robot.connect(ROBOT, settings=site.settings, timeout_s=2.0)


@pytest.mark.long
@pytest.mark.night
def test_a_flood_of_handshakes_moves_no_robot_and_ends_no_fleet(site: SecuredSite) -> None:
    """The robot drives, or stands by its rules; afterwards it drives again."""
    host, _, port = site.network.endpoint.removeprefix("tls/").partition(":")
    with running(site) as (_, witness), ExitStack() as stack:
        flooders: list[subprocess.Popen[str]] = []
        before = [0]

        def is_over() -> bool:
            """Flood once it drives; over when it drives again after the flood."""
            is_fast = max(speeds_on(witness)[before[0] :], default=0) * BIT_MPS > LIMIT_MPS * 0.9
            if is_fast and not flooders:
                command = [sys.executable, "-c", FLOODER, host, port, str(HANDSHAKES)]
                for _ in range(FLOODERS):
                    flooder = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
                    stack.callback(flooder.kill)
                    flooders.append(stack.enter_context(flooder))
            if not flooders or any(one.poll() is None for one in flooders):
                before[0] = len(speeds_on(witness)) if flooders else 0
                return False
            return is_fast

        drive_until(site, is_over)
        assert [flooder.communicate()[0] for flooder in flooders] == ["done\n"] * FLOODERS
        assert_lawful(speeds_on(witness))


def test_a_viewers_stop_is_seen_to_be_carried_out(site: SecuredSite) -> None:
    """Without a key, by the robot's signed states."""
    node = site.network.node(TransportRole.VIEWER, "vic")
    write_authority(node, site.fleet)
    settings = msgspec.structs.replace(
        site.settings,
        zenoh=ZenohSettings(config=str(node / "viewer.json5")),
        authority=AuthoritySettings(mode="signed", directory=str(node)),
    )
    with running(site) as (gateway, _), driving(site):
        report = remote_stop.stop_from_here(settings, ROBOT, "vic", 30)
        gateway.wait_says(r"a remote stop was received; by vic \(unproven\)")
    assert (report.stopped, report.silent) == ([ROBOT], [])


def drive_until(site: SecuredSite, is_over: Callable[[], bool]) -> None:
    """Drive, and engage again after a stop by the rules, or when a flooded router does not answer."""
    while not is_over():
        with suppress(Stopped, Unreachable, LeaseLost, CommandError), driving(site) as (_, lease):
            while not is_over():
                lease.drive(WANTED_MPS)
                time.sleep(0.02)

"""Somebody else has a robot's name on the network, before the robot's own gateway starts."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import msgpack
import pytest
import zenoh

from schemas.command_line import ExitCode
from schemas.settings import ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night
from tests.support.processes.gateway import Managed, chassis, gateway, run
from tests.support.signed_site import Site
from tests.support.waiting import wait_until

INFO: Final = "fleet/cruiser-1/gateway/info"


@contextmanager
def stranger() -> Iterator[tuple[zenoh.Session, str]]:
    """A node that is there first, and where it listens."""
    endpoint = free_endpoint()
    session = open_session(ZenohSettings(), [], [endpoint])
    yield session, endpoint
    close_session(session)


def test_a_squatted_token_keeps_no_robot_from_starting() -> None:
    """The gateway starts, serves its robot, and says in its log and as an event that its name was taken."""
    with stranger() as (session, endpoint), chassis() as (_, address):
        events = session.declare_subscriber("fleet/cruiser-1/safety/event", zenoh.handlers.RingChannel(100))
        states = session.declare_subscriber("fleet/cruiser-1/safety/state", zenoh.handlers.RingChannel(1))
        told: list[dict[str, Any]] = []

        def hear() -> None:
            while (sample := events.try_recv()) is not None:
                told.append(msgpack.unpackb(sample.payload.to_bytes()))

        with (
            session.liveliness().declare_token("fleet/cruiser-1/gateway"),
            gateway(address, free_endpoint(), "--connect", endpoint) as running,
        ):
            running.wait_says("somebody else has declared the liveliness token of cruiser-1")
            wait_until(lambda: states.try_recv() is not None)
            wait_until(lambda: bool(told), hear)
            assert running.stop() == ExitCode.OK
    assert (told[0]["kind"], told[0]["severity"]) == ("fault", "warning")
    assert "no gateway answers there" in told[0]["text"]


@pytest.mark.parametrize("listen_only", [[], by_night(["--listen-only"])])
def test_a_gateway_that_lives_keeps_its_name(listen_only: list[str]) -> None:
    """One name is one robot: the second says so and ends, with exit code 5; the first serves on."""
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint, *listen_only) as first:
        bus = ["--interface", "socketcand", "--channel", address]
        second = run(["gateway", *bus, "--listen", free_endpoint(), "--connect", endpoint])
        assert second.returncode == ExitCode.REFUSED
        assert "a gateway of the name cruiser-1 is connected already" in second.stderr
        assert first.stop() == ExitCode.OK


@contextmanager
def squatting(session: zenoh.Session) -> Iterator[None]:
    """Somebody has the robot's token, and answers in its place."""

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(INFO, b"\x80", attachment=bytes(73))

    with (
        session.liveliness().declare_token("fleet/cruiser-1/gateway"),
        session.declare_queryable(INFO, answer, complete=True),
    ):
        yield


def test_in_signed_mode_who_answers_without_a_grant_for_the_name_keeps_no_robot_from_starting(
    tmp_path: Path,
) -> None:
    """Another robot's certificate lets it: the gateway starts, and goes on when it takes over renewed files."""
    site = Site(tmp_path)
    with (
        stranger() as (session, endpoint),
        chassis() as (_, address),
        squatting(session),
        gateway(
            address, site.endpoint, "--connect", endpoint, "--config", site.robot_settings, kind=Managed
        ) as running,
    ):
        running.wait_says("what answers there does not prove that it was granted this name")
        grant = Path(site.robot_settings).with_name("robot.grant")
        grant.write_bytes(grant.read_bytes())
        running.wait_says("the gateway ends, and is started again with them")
        wait_until(lambda: len([line for line in running.said if "does not prove" in line]) >= 2)
        states = session.declare_subscriber("fleet/cruiser-1/safety/state", zenoh.handlers.RingChannel(1))
        wait_until(lambda: states.try_recv() is not None)
        assert running.stop() == ExitCode.OK


def test_in_signed_mode_a_second_gateway_with_the_same_keys_is_refused(tmp_path: Path) -> None:
    """It proves itself, although somebody else answers too; the first serves on."""
    site = Site(tmp_path)
    with stranger() as (session, endpoint), chassis() as (_, address):
        files = ["--config", site.robot_settings, "--connect", endpoint]
        with gateway(address, site.endpoint, *files) as first, squatting(session):
            bus = ["--interface", "socketcand", "--channel", address]
            second = run(["gateway", *bus, "--listen", free_endpoint(), *files])
            assert second.returncode == ExitCode.REFUSED
            assert "a gateway of the name cruiser-1 is connected already" in second.stderr
            assert first.stop() == ExitCode.OK

"""Somebody else has a robot's name on the network, before the robot's own gateway starts."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgpack
import pytest
import zenoh

from gateway.zenoh.client import close_session, open_session
from schemas.exit_codes import ExitCode
from schemas.settings import ZenohSettings
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import chassis, gateway, run
from tests.support.waiting import wait_until


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


@pytest.mark.parametrize("listen_only", [[], ["--listen-only"]])
def test_a_gateway_that_lives_keeps_its_name(listen_only: list[str]) -> None:
    """One name is one robot: the second says so and ends, with exit code 5; the first serves on."""
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint, *listen_only) as first:
        bus = ["--interface", "socketcand", "--channel", address]
        second = run(["gateway", *bus, "--listen", free_endpoint(), "--connect", endpoint])
        assert second.returncode == ExitCode.REFUSED
        assert "a gateway of the name cruiser-1 is connected already" in second.stderr
        assert first.stop() == ExitCode.OK

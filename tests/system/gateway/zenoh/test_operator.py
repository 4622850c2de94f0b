from functools import partial

import pytest

from gateway.telemetry.samples import Received
from gateway.zenoh.client import PendingQuery
from gateway.zenoh.operator import CommandPort, SafetyListener
from schemas import keys
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings, ZenohSettings
from tests.support.fakes.fleet import FakeFleet
from tests.support.fakes.gateway import FakeGateway
from tests.support.fakes.peer import free_endpoint
from tests.support.fakes.robot import FakeRobot
from tests.support.waiting import wait_until

VOLLEYS, VOLLEY = 40, 5


def settings_for(endpoint: str) -> Settings:
    return Settings(zenoh=ZenohSettings(connect=[endpoint]))


def test_a_port_reaches_a_robot_only_while_it_takes_commands() -> None:
    """A gateway without commands is connected, but not reached; a robot is until it goes."""
    with (
        FakeGateway("cruiser-1") as gateway,
        CommandPort.open(settings_for(gateway.listen), "cruiser-1", "first") as port,
    ):
        wait_until(port.connected)
        assert not port.reaches()
    endpoint = free_endpoint()
    with CommandPort.open(settings_for(endpoint), "cruiser-1", "first") as port:
        with FakeRobot(listen=endpoint):
            wait_until(port.reaches)
        wait_until(lambda: not port.reaches())


def test_commands_that_follow_each_other_closely_all_arrive() -> None:
    """A command finds room although the one before it is still being sent; Zenoh's own start values drop most."""
    with FakeRobot() as fake, CommandPort.open(settings_for(fake.listen), fake.name, "first") as port:
        wait_until(port.reaches)
        for volley in range(1, VOLLEYS + 1):
            for _ in range(VOLLEY):
                port.put("drive", b"")
            wait_until(partial(fake.has_heard, VOLLEY * volley))


def test_of_a_large_fleet_every_reply_arrives() -> None:
    """Replies come in one burst and share Zenoh's batches: none is dropped for want of room."""
    with FakeFleet(1000) as fleet, CommandPort.open(settings_for(fleet.listen), keys.ALL, "first") as port:
        wait_until(lambda: count_replies(port.call_roll(20)) == len(fleet.names))
        assert count_replies(port.begin("stop", b"", 20)) == len(fleet.names)


def count_replies(question: PendingQuery) -> int:
    """Wait for the end, and count."""
    found: list[Received] = []
    wait_until(lambda: question.is_over, lambda: found.extend(question.poll()))
    return len(found)


def test_a_closed_port_neither_hangs_nor_raises_anything_of_zenoh() -> None:
    """A put is lost, a question is one clear error, nothing more is heard."""
    with FakeRobot() as fake:
        port = CommandPort.open(settings_for(fake.listen), fake.name, "first")
        listener = SafetyListener.open(settings_for(fake.listen), fake.name)
        port.close()
        listener.close()
        port.put("stop", b"")
        with pytest.raises(CommandError) as caught:
            port.ask("stop", b"", 1)
        assert caught.value.code is ExitCode.UNREACHABLE
        assert list(listener.drain()) == []

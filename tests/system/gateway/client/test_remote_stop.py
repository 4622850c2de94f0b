import argparse

import pytest

from gateway.cli import stop
from gateway.client import remote_stop
from gateway.client.refusal import Refused
from gateway.client.robot import Robot, stop_all
from gateway.zenoh.client import PendingQuery
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.command_line import ExitCode
from schemas.reasons import Reason
from schemas.settings import Settings, ZenohSettings
from tests.support.fakes.fleet import FakeFleet
from tests.support.fakes.peer import free_endpoint
from tests.support.fakes.robot import FakeRobot
from tests.support.messages import ROOT
from tests.support.processes.tcp_proxy import TcpProxy
from tests.support.waiting import wait_until


def settings_for(endpoint: str) -> Settings:
    """Settings that connect there."""
    return Settings(zenoh=ZenohSettings(connect=[endpoint]))


def test_a_robot_that_hears_it_is_said_to_stop() -> None:
    """One robot stops, the other is not meant."""
    with FakeRobot("cruiser-1") as fake, FakeRobot("cruiser-2", connect=fake.listen) as other:
        report = remote_stop.stop_from_here(settings_for(fake.listen), "cruiser-1", "first", 20)
        assert (report.stopped, report.refused, report.silent, report.linked) == (["cruiser-1"], {}, [], True)
        assert Reason.REMOTE_STOP in fake.flow.arbiter.latches.details
        assert not other.flow.arbiter.latches.details


def test_a_robot_that_answers_nothing_is_told_all_the_same() -> None:
    """The puts stop it although no query is answered; the report says that it is silent."""
    with FakeRobot(deaf=True) as fake:
        report = remote_stop.stop_from_here(settings_for(fake.listen), fake.name, "first", 3)
        assert (report.stopped, report.silent) == ([], [fake.name])
        assert Reason.REMOTE_STOP in fake.flow.arbiter.latches.details
        assert fake.puts.count("stop") > 5


def test_a_fleet_is_stopped_and_who_is_silent_is_named() -> None:
    """Robots behind another are reached, and those that are connected and do not answer are named."""
    with (
        FakeRobot("cruiser-1") as first,
        FakeRobot("cruiser-2", connect=first.listen) as second,
        FakeRobot("cruiser-3", connect=first.listen, deaf=True) as third,
    ):
        report = stop_all("first", settings_for(first.listen), 4)
        assert report.stopped == ["cruiser-1", "cruiser-2"]
        assert report.silent == ["cruiser-3"]
        for robot in (first, second, third):
            assert Reason.REMOTE_STOP in robot.flow.arbiter.latches.details


def test_a_fleet_that_is_not_counted_in_time_is_not_said_to_be_all() -> None:
    """Over a slow way back the tokens of many robots do not come in time: there may be more than those named."""
    with FakeFleet(400) as fleet, TcpProxy(fleet.listen, slowness_s=0.05) as proxy:
        report = stop_all("first", settings_for(proxy.endpoint), 3)
    assert (report.linked, report.counted) == (True, False)


def test_who_may_be_missing_makes_a_stop_partial(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A robot stops, and whether it is the only one was not answered: exit code 3, and a line that says so."""
    monkeypatch.setattr(CommandPort, "call_roll", lambda _port, _timeout_s: PendingQuery())
    with FakeRobot() as fake:
        parser = argparse.ArgumentParser()
        stop.add_arguments(parser)
        arguments = parser.parse_args(["--all", "--timeout", "3"])
        assert stop.run(arguments, settings_for(fake.listen), lambda: False) == ExitCode.PARTIAL
    captured = capsys.readouterr()
    assert captured.out == f"{fake.name}: stops, latched until a reset\n"
    assert captured.err == "there may be more robots: who is connected was not said in time\n"


def test_nobody_is_nobody() -> None:
    """Without a node nothing is said to have stopped, and the end comes with the timeout."""
    report = stop_all("first", settings_for(free_endpoint()), 0.3)
    assert (report.stopped, report.silent, report.linked) == ([], [], False)


def test_it_reaches_a_robot_that_comes_later() -> None:
    """It is said again and again: a robot whose link returns within the time hears it."""
    endpoint = free_endpoint()
    with CommandPort.open(settings_for(endpoint), keys.ALL, "first") as port:
        stopping = remote_stop._Stopping(port, ROOT, keys.ALL, list)
        stopping.step(0.0)
        with FakeRobot(listen=endpoint) as fake:
            seconds = iter(range(1, 10_000))
            wait_until(lambda: stopping.all_answered, lambda: stopping.step(float(next(seconds))))
            assert stopping.report().unconfirmed.keys() == {fake.name}


def test_a_robot_that_goes_on_moving_is_not_said_to_stop() -> None:
    """It answers that it stops, and is latched; what its wheels do counts."""
    with FakeRobot(moves_mps=-0.5) as fake:
        report = remote_stop.stop_from_here(settings_for(fake.listen), fake.name, "first", 2)
        assert (report.stopped, report.refused, report.silent) == ([], {}, [])
        assert report.unconfirmed == {fake.name: "it replied that it stops, but it is seen to move at 0.50 m/s"}


def test_a_robot_that_says_nothing_is_not_said_to_stop() -> None:
    """It answers, and what it does is not seen."""
    with FakeRobot(mute=True) as fake:
        report = remote_stop.stop_from_here(settings_for(fake.listen), fake.name, "first", 2)
        assert report.stopped == []
        assert report.unconfirmed == {fake.name: "it replied that it stops, but its safety/state does not say so"}


def test_the_library_stops_a_robot_by_what_it_sees() -> None:
    """With the sessions that it has; the call returns once the robot stands, and raises if it does not."""
    with FakeRobot() as fake, Robot.connect(fake.name, "first", settings_for(fake.listen), 20) as robot:
        robot.stop(20)
        assert Reason.REMOTE_STOP in fake.flow.arbiter.latches.details
        fake.moves_mps = 0.3
        with pytest.raises(Refused, match=r"not seen to stop.*0\.30 m/s"):
            robot.stop(2)

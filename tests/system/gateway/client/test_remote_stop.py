import pytest

from gateway.client import remote_stop
from gateway.client.robot import stop_all
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.reasons import Reason
from tests.support.fakes.fleet import FakeFleet
from tests.support.fakes.peer import free_endpoint
from tests.support.fakes.robot import FakeRobot, settings_for
from tests.support.messages import ROOT
from tests.support.processes.tcp_link import TcpLink
from tests.support.waiting import wait_until


@pytest.mark.parametrize("deaf", [False, True])
def test_a_robot_stops_whether_it_answers_or_not(*, deaf: bool) -> None:
    """The puts stop a robot that answers no query. Another robot is not affected."""
    with FakeRobot(deaf=deaf) as fake, FakeRobot("cruiser-2", connect=fake.listen) as other:
        report = remote_stop.stop_from_here(fake.there, "cruiser-1", "first", 3 if deaf else 20)
        stopped, silent = ([], ["cruiser-1"]) if deaf else (["cruiser-1"], [])
        assert report == remote_stop.StopReport(stopped, {}, {}, silent, linked=True)
        assert Reason.REMOTE_STOP in fake.latched
        assert not deaf or fake.puts.count("stop") > 5
        assert not other.latched


def test_a_fleet_that_is_not_counted_in_time_is_not_said_to_be_all() -> None:
    with FakeFleet(400) as fleet, TcpLink(fleet.listen, down_bytes_per_s=1280) as proxy:
        report = stop_all("first", settings_for(proxy.endpoint), 3)
    assert (report.linked, report.counted) == (True, False)


def test_it_reaches_a_robot_that_comes_later() -> None:
    endpoint = free_endpoint()
    with CommandPort.open(settings_for(endpoint), keys.ALL, "first") as port:
        stopping = remote_stop._Stopping(port, ROOT, keys.ALL, list)
        stopping.step(0.0)
        with FakeRobot(listen=endpoint) as fake:
            seconds = iter(range(1, 10_000))
            wait_until(lambda: stopping.all_answered, lambda: stopping.step(float(next(seconds))))
            assert stopping.report().unconfirmed.keys() == {fake.name}

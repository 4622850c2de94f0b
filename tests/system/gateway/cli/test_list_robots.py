import json
from collections.abc import Callable

import msgspec
import pytest

from gateway.cli import list_robots as list_command
from gateway.zenoh.client import PendingQuery, RobotListener
from schemas.command_line import CommandError, ExitCode
from schemas.reasons import Reason
from schemas.settings import RobotSettings, Settings, ZenohSettings
from tests.support.commands import run_command
from tests.support.fakes.fleet import FakeFleet
from tests.support.fakes.gateway import FakeGateway, speech
from tests.support.messages import HEALTH, STANDBY, STATE
from tests.support.processes.tcp_proxy import TcpProxy
from tests.support.waiting import StopWhen, nothing

WELL = [STATE, HEALTH]
SILENT = "cruiser-1  OFFLINE: no state yet; its gateway is connected, but sends no health\n"

Capture = pytest.CaptureFixture[str]


def list_robots(
    endpoint: str,
    *words: str,
    root: str = "fleet",
    meanwhile: Callable[[], None] = nothing,
    until: Callable[[], bool] = lambda: False,
) -> int:
    """Run the command in this process. ``meanwhile`` is done again and again until it ends."""
    settings = Settings(robot=RobotSettings(root=root), zenoh=ZenohSettings(connect=[endpoint]))
    return run_command(list_command, *words, settings=settings, stopped=StopWhen(until, meanwhile))


def test_robots_are_listed_with_their_health(capsys: Capture) -> None:
    """Both robots of a bench are found through the first one's node, each with what its health says."""
    with FakeGateway("cruiser-1") as first, FakeGateway("cruiser-2", connect=first.listen) as second:

        def speak() -> None:
            first.say(msgspec.structs.replace(STANDBY, lease_holder="ann", blocked_by=[]))
            speech(first, second, says=WELL)()

        assert list_robots(first.listen, "--timeout", "20", meanwhile=speak) == 0
    told, *lines = capsys.readouterr().out.splitlines()
    assert told == "1 telemetry only, 1 in control"
    assert lines[0].startswith("cruiser-1  in control  +1.25 m/s  driver ann  ")
    assert lines[1].startswith("cruiser-2  telemetry only  +1.25 m/s  ")
    assert all("630/s" in line for line in lines)


def test_a_robot_that_is_lost_is_listed_until_it_is_forgotten(capsys: Capture) -> None:
    """Also by the next command, and by the live list: exit code 3, with its name. A pattern asks for others."""
    with FakeGateway("cruiser-1") as first:
        speak = speech(first, says=WELL)
        with FakeGateway("cruiser-2", connect=first.listen) as second:
            both = speech(first, second, says=WELL)
            assert list_robots(first.listen, "--timeout", "20", meanwhile=both) == 0
        capsys.readouterr()
        assert list_robots(first.listen, "--timeout", "1", meanwhile=speak) == ExitCode.PARTIAL
        out, errors = capsys.readouterr()
        assert out.splitlines()[0] == "1 telemetry only, 1 offline"
        assert out.splitlines()[2] == "cruiser-2  OFFLINE: no state yet; its gateway is not connected"
        assert errors.startswith("no contact with cruiser-2: look at it, it may be moving; ")
        assert list_robots(first.listen, "cruiser-1", "--timeout", "20", meanwhile=speak) == 0
        assert list_robots(first.listen, "--forget", "cruiser-2", "--timeout", "20", meanwhile=speak) == 0
        assert "cruiser-2" not in capsys.readouterr().out


def test_some_robots_are_listed_by_a_pattern_in_the_order_of_their_numbers(capsys: Capture) -> None:
    """2 comes before 10; of a name that nobody has there is none, and it is named."""
    with (
        FakeGateway("cruiser-10") as first,
        FakeGateway("cruiser-2", connect=first.listen) as second,
        FakeGateway("other-1", connect=first.listen) as other,
    ):
        speak = speech(first, second, other, says=WELL)
        assert list_robots(first.listen, "cruiser-*", "--timeout", "20", meanwhile=speak) == 0
        lines = capsys.readouterr().out.splitlines()
        assert [line.split()[0] for line in lines] == ["2", "cruiser-2", "cruiser-10"]
        assert list_robots(first.listen, "cruiser-3", "--timeout", "20", meanwhile=speak) == 1
    assert capsys.readouterr().err == f"no robot called cruiser-3 is connected at {first.listen}\n"


def test_what_is_latched_is_listed(capsys: Capture) -> None:
    """A robot that cannot be engaged until a reset is not shown as one that is well."""
    latched = msgspec.structs.replace(STANDBY, latched=[Reason.REMOTE_STOP, Reason.FRONT_BUMPER])
    with FakeGateway("cruiser-1") as gateway:
        speak = speech(gateway, says=[STATE, latched, HEALTH])
        assert list_robots(gateway.listen, "--timeout", "20", meanwhile=speak) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "  needs attention: remote stop, front bumper, reset required" in lines


def test_a_robot_that_sends_no_health_is_said_to_send_none(capsys: Capture) -> None:
    """A liveliness token is no proof of health, and the list says so."""
    with FakeGateway("cruiser-1") as gateway:
        assert list_robots(gateway.listen, "--timeout", "2") == ExitCode.PARTIAL
    assert capsys.readouterr().out == SILENT


@pytest.mark.parametrize("caches_health", [False, True])
def test_a_gateway_that_hangs_is_not_shown_as_well(capsys: Capture, caches_health: bool) -> None:  # noqa: FBT001
    """What it said before it hung is no health now, although Zenoh's threads still answer for it."""
    with FakeGateway("cruiser-1", caches_health=caches_health) as gateway:
        gateway.say(HEALTH)
        assert list_robots(gateway.listen, "--timeout", "2") == ExitCode.PARTIAL
    assert capsys.readouterr().out == SILENT


def test_a_robot_without_a_token_is_listed_by_its_health(capsys: Capture) -> None:
    """Health without a token is odd, and the list says so too."""
    with FakeGateway("cruiser-1", token=False) as gateway:
        assert list_robots(gateway.listen, "--timeout", "20", meanwhile=speech(gateway, says=WELL)) == 0
    assert "no liveliness token" in capsys.readouterr().out


def test_the_list_as_json_has_an_object_a_line(capsys: Capture) -> None:
    """--json writes the report of each robot."""
    with FakeGateway("cruiser-1") as gateway:
        assert list_robots(gateway.listen, "--json", "--timeout", "20", meanwhile=speech(gateway, says=WELL)) == 0
    record = json.loads(capsys.readouterr().out)
    assert (record["robot"], record["connected"]) == ("cruiser-1", True)
    assert record["health"]["frames_per_s"] == 630.0


def test_a_node_without_robots_is_a_failure(capsys: Capture) -> None:
    """Somebody answers, but no robot is there under this root: exit code 1, and nothing on standard output."""
    with FakeGateway("cruiser-1") as gateway:
        assert list_robots(gateway.listen, "--timeout", "20", root="elsewhere") == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == f"no robot is connected at {gateway.listen}\n"


def test_a_node_that_does_not_say_who_is_there_is_not_taken_for_an_empty_one(capsys: Capture) -> None:
    """Over a slow way back the tokens of many robots do not come in time: silence is no answer."""
    with (
        FakeFleet(400) as fleet,
        TcpProxy(fleet.listen, slowness_s=0.05) as proxy,
        pytest.raises(CommandError, match="did not say within 3 s which robots are connected") as caught,
    ):
        list_robots(proxy.endpoint, "--timeout", "3")
    assert caught.value.code is ExitCode.UNREACHABLE
    assert capsys.readouterr().out == ""


def test_a_list_that_may_not_be_whole_says_so(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot is there, and who else is was not answered in time: exit code 3, and a line that says so."""
    monkeypatch.setattr(RobotListener, "call_roll", lambda _listener, _timeout_s: PendingQuery())
    with FakeGateway("cruiser-1") as gateway:
        assert list_robots(gateway.listen, "--timeout", "2") == ExitCode.PARTIAL
    captured = capsys.readouterr()
    assert captured.out == SILENT
    assert (
        captured.err.partition("\n")[2]
        == f"there may be more: not everybody answered within 2 s at {gateway.listen}\n"
    )


def test_a_list_that_is_ended_early_says_nothing_of_who_had_no_time_to_answer(capsys: Capture) -> None:
    """A robot that is well would be one without health, and a node that is there would not have answered."""
    with FakeGateway("cruiser-1") as fake, pytest.raises(KeyboardInterrupt):
        list_robots(fake.listen, "--timeout", "20", until=lambda: True)
    assert capsys.readouterr() == ("", "")

"""``cruiser list`` and ``watch`` on loopback. What a view shows: tests/unit/gateway/client/test_fleet.py."""

import json
from collections.abc import Callable

import msgspec
import pytest

from gateway.cli import list_robots as list_command
from gateway.cli import watch as watch_command
from gateway.zenoh.client import PendingQuery, RobotListener
from schemas.command_line import CommandError, ExitCode
from schemas.messages import RobotState
from schemas.settings import RobotSettings, Settings, ZenohSettings
from tests.support.commands import run_command
from tests.support.fakes.fleet import FakeFleet
from tests.support.fakes.gateway import FakeGateway, speech
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import HEALTH, STANDBY, STATE
from tests.support.processes.tcp_link import TcpLink
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
    """Run the command in this process, and call ``meanwhile`` repeatedly until it ends."""
    settings = Settings(robot=RobotSettings(root=root), zenoh=ZenohSettings(connect=[endpoint]))
    words = words if "--timeout" in words else (*words, "--timeout", "20")
    return run_command(list_command, *words, settings=settings, stopped=StopWhen(until, meanwhile))


def test_some_robots_are_listed_in_the_order_of_their_numbers(capsys: Capture) -> None:
    with (
        FakeGateway("cruiser-10") as first,
        FakeGateway("cruiser-2", connect=first.listen) as second,
        FakeGateway("other-1", connect=first.listen) as other,
    ):
        all_speak = speech(first, second, other, says=WELL)

        def speak() -> None:
            second.say(msgspec.structs.replace(STANDBY, lease_holder="ann", blocked_by=[]))
            all_speak()

        assert list_robots(first.listen, "cruiser-*", meanwhile=speak) == 0
        told, *lines = capsys.readouterr().out.splitlines()
        assert told == "1 telemetry only, 1 in control"
        assert lines[0].startswith("cruiser-2  in control  +1.25 m/s  driver ann  ")
        assert lines[1].startswith("cruiser-10  telemetry only  +1.25 m/s  ")
        assert all("630/s" in line for line in lines)
        assert list_robots(first.listen, "cruiser-3", meanwhile=speak) == 1
        assert capsys.readouterr().err == f"no robot called cruiser-3 is connected at {first.listen}\n"
        assert list_robots(first.listen, "cruiser-10", "--json", meanwhile=speak) == 0
        record = json.loads(capsys.readouterr().out)
        assert (record["robot"], record["connected"]) == ("cruiser-10", True)
        assert record["health"]["frames_per_s"] == 630.0
        assert list_robots(first.listen, root="elsewhere") == 1
        assert capsys.readouterr() == ("", f"no robot is connected at {first.listen}\n")


def test_a_robot_that_is_lost_is_listed_until_it_is_forgotten(capsys: Capture) -> None:
    with FakeGateway("cruiser-1") as first:
        speak = speech(first, says=WELL)
        with FakeGateway("cruiser-2", connect=first.listen) as second:
            both = speech(first, second, says=WELL)
            assert list_robots(first.listen, meanwhile=both) == 0
        capsys.readouterr()
        assert list_robots(first.listen, "--timeout", "1", meanwhile=speak) == ExitCode.PARTIAL
        out, errors = capsys.readouterr()
        assert out.splitlines()[0] == "1 telemetry only, 1 offline"
        assert out.splitlines()[2] == "cruiser-2  OFFLINE: no state yet; its gateway is not connected"
        assert errors.startswith("no contact with cruiser-2: look at it, it may be moving; ")
        assert list_robots(first.listen, "cruiser-1", meanwhile=speak) == 0
        assert list_robots(first.listen, "--forget", "cruiser-2", meanwhile=speak) == 0
        assert "cruiser-2" not in capsys.readouterr().out


@pytest.mark.parametrize("said_before", [False, True])
def test_a_robot_that_sends_no_health_is_said_to_send_none(capsys: Capture, *, said_before: bool) -> None:
    with FakeGateway("cruiser-1", caches_health=said_before) as gateway:
        if said_before:
            gateway.say(HEALTH)
        assert list_robots(gateway.listen, "--timeout", "2") == ExitCode.PARTIAL
    assert capsys.readouterr().out == SILENT


def test_a_node_that_does_not_say_who_is_there_is_not_taken_for_an_empty_one(capsys: Capture) -> None:
    with (
        FakeFleet(400) as fleet,
        TcpLink(fleet.listen, down_bytes_per_s=1280) as proxy,
        pytest.raises(CommandError, match=r"did not list its robots within 3 s") as caught,
    ):
        list_robots(proxy.endpoint, "--timeout", "3")
    assert caught.value.code is ExitCode.UNREACHABLE
    assert capsys.readouterr().out == ""


def test_a_list_that_may_not_be_whole_says_so(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RobotListener, "call_roll", lambda _listener, _timeout_s: PendingQuery())
    with FakeGateway("cruiser-1") as gateway:
        assert list_robots(gateway.listen, "--timeout", "2") == ExitCode.PARTIAL
        out, errors = capsys.readouterr()
        with pytest.raises(KeyboardInterrupt):
            list_robots(gateway.listen, until=lambda: True)
    assert out == SILENT
    more = f"there may be more robots: not every node answered within 2 s at {gateway.listen}\n"
    assert errors.partition("\n")[2] == more
    assert capsys.readouterr() == ("", "")


def watch(endpoint: str, *words: str, stopped: Callable[[], bool]) -> int:
    return run_command(
        watch_command, *words, settings=Settings(zenoh=ZenohSettings(connect=[endpoint])), stopped=stopped
    )


class Output:
    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self.text = ""

    def __call__(self) -> str:
        self.text += self._capture.readouterr().out
        return self.text


def test_some_robots_are_shown_as_lines_without_a_terminal(capsys: Capture) -> None:
    output = Output(capsys)
    with (
        FakeGateway("cruiser-10") as first,
        FakeGateway("cruiser-2", connect=first.listen) as second,
        FakeGateway("other-1", connect=first.listen) as other,
    ):
        speak = speech(first, second, other, says=[STATE])
        stopped = StopWhen(lambda: "\n2 telemetry only\ncruiser-2 " in f"\n{output()}", speak)
        assert watch(first.listen, "cruiser-*", stopped=stopped) == 0
    assert [line.split()[0] for line in output.text.splitlines()[-3:]] == ["2", "cruiser-2", "cruiser-10"]
    assert "other-1" not in output.text


def test_all_robots_are_shown_as_json(capsys: Capture) -> None:
    output = Output(capsys)
    with FakeGateway("cruiser-1") as first, FakeGateway("cruiser-2", connect=first.listen) as second:

        def speak() -> None:
            first.say(STATE)
            second.say(HEALTH)

        stopped = StopWhen(lambda: '"cruiser-2"' in output(), speak)
        assert watch(first.listen, "--json", stopped=stopped) == 0
    records = {record["robot"]: record for record in map(json.loads, output.text.splitlines())}
    assert set(records["cruiser-1"]["state"]) == set(RobotState.__struct_fields__)
    assert records["cruiser-1"]["state"]["speed_mps"] == 1.25
    assert (records["cruiser-2"]["state"], records["cruiser-2"]["connected"]) == (None, True)


@pytest.mark.parametrize(("words", "shown"), [(["cruiser-1"], "mileage"), ([], "telemetry only")])
def test_a_terminal_gets_a_live_view(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, words: list[str], shown: str
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    output = Output(capsys)
    with FakeGateway("cruiser-1") as gateway:
        stopped = StopWhen(lambda: output().count("+1.25 m/s") >= 3, lambda: gateway.say(STATE))
        assert watch(gateway.listen, *words, stopped=stopped) == 0
    assert shown in output()
    assert output.text.index("\x1b[?1049h") < output.text.index("+1.25 m/s") < output.text.index("\x1b[?1049l")


def test_it_ends_after_its_seconds_and_where_the_robot_is_not_there(capsys: Capture) -> None:
    with FakeGateway("cruiser-1") as gateway:
        stopped = StopWhen(lambda: False, lambda: gateway.say(STATE))
        assert watch(gateway.listen, "cruiser-1", "--seconds", "1.5", stopped=stopped) == 0
        assert "+1.25 m/s" in capsys.readouterr().out
        with pytest.raises(CommandError, match=r"'cruiser-2' did not appear") as caught:
            watch(gateway.listen, "cruiser-2", "--timeout", "0.5", stopped=StopWhen(lambda: False))
    assert caught.value.code is ExitCode.UNREACHABLE
    assert watch(free_endpoint(), "cruiser-1", stopped=lambda: True) == 0

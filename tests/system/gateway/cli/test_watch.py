"""``cruiser watch`` against gateways on loopback. What a view shows: tests/unit/gateway/client/test_fleet.py."""

import json
from collections.abc import Callable

import pytest

from gateway.cli import watch as watch_command
from schemas.command_line import CommandError, ExitCode
from schemas.messages import RobotState
from schemas.settings import Settings, ZenohSettings
from tests.support.commands import run_command
from tests.support.fakes.gateway import FakeGateway, speech
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import HEALTH, STATE
from tests.support.waiting import StopWhen

Capture = pytest.CaptureFixture[str]


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
    """Each second, in the order of their numbers, after a line on all of them; others are not heard."""
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
    """--json writes one object a robot and a line, with the messages' own field names."""
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


def test_a_robot_that_falls_silent_is_stale_and_one_that_leaves_is_gone(capsys: Capture) -> None:
    """No old value is shown; when states come again, so do the values; the view stays."""
    output = Output(capsys)
    with FakeGateway("cruiser-1") as gateway:
        is_gone = False

        def speak() -> None:
            nonlocal is_gone
            before, _, after = output().partition("no contact")
            if is_gone:
                return
            if "+1.25 m/s" in after:
                is_gone = True
                gateway.__exit__(None, None, None)
            elif "+1.25 m/s" not in before or "no contact" in output.text:
                gateway.say(STATE)

        stopped = StopWhen(lambda: "this end is not connected to Zenoh" in output(), speak)
        assert watch(gateway.listen, "cruiser-1", stopped=stopped) == 0
    stale = next(line for line in output.text.splitlines() if "no contact" in line)
    assert "its gateway is connected" in stale
    assert "1.25" not in stale


@pytest.mark.parametrize(("words", "shown"), [(["cruiser-1"], "mileage"), ([], "telemetry only")])
def test_a_terminal_gets_a_live_view(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, words: list[str], shown: str
) -> None:
    """On the terminal's other screen, which is left at the end."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    output = Output(capsys)
    with FakeGateway("cruiser-1") as gateway:
        stopped = StopWhen(lambda: output().count("+1.25 m/s") >= 3, lambda: gateway.say(STATE))
        assert watch(gateway.listen, *words, stopped=stopped) == 0
    assert shown in output()
    assert output.text.index("\x1b[?1049h") < output.text.index("+1.25 m/s") < output.text.index("\x1b[?1049l")


def test_it_ends_after_its_seconds_and_where_the_robot_is_not_there(capsys: Capture) -> None:
    """With exit code 0 and 4; a signal while it waits is no error."""
    with FakeGateway("cruiser-1") as gateway:
        stopped = StopWhen(lambda: False, lambda: gateway.say(STATE))
        assert watch(gateway.listen, "cruiser-1", "--seconds", "1.5", stopped=stopped) == 0
        assert "+1.25 m/s" in capsys.readouterr().out
        with pytest.raises(CommandError, match=r"'cruiser-2' did not appear") as caught:
            watch(gateway.listen, "cruiser-2", "--timeout", "0.5", stopped=StopWhen(lambda: False))
    assert caught.value.code is ExitCode.UNREACHABLE
    assert watch(free_endpoint(), "cruiser-1", stopped=lambda: True) == 0

import json
from collections.abc import Callable

import pytest

from gateway.cli import watch as watch_command
from schemas.command_line import CommandError, ExitCode
from schemas.messages import RobotState
from schemas.settings import RobotSettings, Settings, ZenohSettings
from tests.support.commands import run_command
from tests.support.fakes.gateway import FakeGateway, speech
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import HEALTH, STATE
from tests.support.waiting import StopWhen

Capture = pytest.CaptureFixture[str]


def watch(endpoint: str, *words: str, stopped: Callable[[], bool], root: str = "fleet") -> int:
    """Run the command in this process."""
    settings = Settings(robot=RobotSettings(root=root), zenoh=ZenohSettings(connect=[endpoint]))
    return run_command(watch_command, *words, settings=settings, stopped=stopped)


class Output:
    """What was written so far."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self.text = ""

    def __call__(self) -> str:
        """Everything that was written until now."""
        self.text += self._capture.readouterr().out
        return self.text


def test_one_robot_is_shown_as_lines_without_a_terminal(capsys: Capture) -> None:
    """Each second a line says what the robot does."""
    output = Output(capsys)
    with FakeGateway("cruiser-1") as gateway:
        stopped = StopWhen(lambda: output().count("\n") >= 2, speech(gateway, says=[HEALTH, STATE]))
        assert watch(gateway.listen, "cruiser-1", stopped=stopped) == 0
    for line in output.text.splitlines():
        assert line.startswith("cruiser-1  telemetry only  mode auto  gear drive  +1.25 m/s  -3.5 deg")
        assert line.endswith("faults none")


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
    assert records["cruiser-2"]["state"] is None
    assert records["cruiser-2"]["connected"] is True


def test_a_robot_that_falls_silent_is_shown_as_stale(capsys: Capture) -> None:
    """When states cease, lines say so and show no old value; when they come again, so do the values."""
    output = Output(capsys)
    with FakeGateway("cruiser-1") as gateway:

        def speak() -> None:
            text = output()
            if "mode auto" not in text or "OFFLINE" in text:
                gateway.say(STATE)

        stopped = StopWhen(lambda: "mode auto" in output().partition("OFFLINE")[2], speak)
        assert watch(gateway.listen, "cruiser-1", stopped=stopped) == 0
    stale = next(line for line in output.text.splitlines() if "OFFLINE" in line)
    assert "its gateway is connected" in stale
    assert "1.25" not in stale


def test_a_gateway_that_leaves_is_shown_as_gone(capsys: Capture) -> None:
    """When the gateway goes, the view stays and says that nothing is connected."""
    output = Output(capsys)
    with FakeGateway("cruiser-1") as gateway:

        def speak() -> None:
            if "mode auto" in output():
                gateway.__exit__(None, None, None)
            else:
                gateway.say(STATE)

        stopped = StopWhen(lambda: "this end is not connected to Zenoh" in output(), speak)
        assert watch(gateway.listen, "cruiser-1", stopped=stopped) == 0


@pytest.mark.parametrize(("words", "shown"), [(["cruiser-1"], "mileage"), ([], "telemetry only")])
def test_a_terminal_gets_a_live_view(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, words: list[str], shown: str
) -> None:
    """On a terminal the view is drawn again and again, and wiped when it ends."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    output = Output(capsys)
    with FakeGateway("cruiser-1") as gateway:
        stopped = StopWhen(lambda: output().count("+1.25 m/s") >= 3, lambda: gateway.say(STATE))
        assert watch(gateway.listen, *words, stopped=stopped) == 0
    assert shown in output()
    # It was drawn on the terminal's other screen, which is left at the end.
    assert output.text.index("\x1b[?1049h") < output.text.index("+1.25 m/s") < output.text.index("\x1b[?1049l")


def test_it_ends_after_the_seconds_it_was_given(capsys: Capture) -> None:
    """--seconds ends the view by itself with exit code 0."""
    with FakeGateway("cruiser-1") as gateway:
        stopped = StopWhen(lambda: False, lambda: gateway.say(STATE))
        assert watch(gateway.listen, "cruiser-1", "--seconds", "1.5", stopped=stopped) == 0
    assert "mode auto" in capsys.readouterr().out


def test_a_robot_that_does_not_appear_is_unreachable() -> None:
    """A node answers, but the robot is not there: exit code 4, and the line names the robot."""
    with (
        FakeGateway("cruiser-1") as gateway,
        pytest.raises(CommandError, match=r"'cruiser-2' did not appear") as caught,
    ):
        watch(gateway.listen, "cruiser-2", "--timeout", "0.5", stopped=StopWhen(lambda: False))
    assert caught.value.code is ExitCode.UNREACHABLE


def test_some_robots_are_shown_by_a_pattern(capsys: Capture) -> None:
    """In the order of their numbers, after a line on all of them; others are not heard."""
    output = Output(capsys)
    with (
        FakeGateway("cruiser-10") as first,
        FakeGateway("cruiser-2", connect=first.listen) as second,
        FakeGateway("other-1", connect=first.listen) as other,
    ):
        speak = speech(first, second, other, says=[STATE])
        stopped = StopWhen(lambda: "\n2 telemetry only\ncruiser-2 " in f"\n{output()}", speak)
        assert watch(first.listen, "cruiser-*", stopped=stopped) == 0
    last = output.text.splitlines()[-3:]
    assert [line.split()[0] for line in last] == ["2", "cruiser-2", "cruiser-10"]
    assert "other-1" not in output.text


def test_a_signal_while_waiting_ends_it_without_an_error() -> None:
    """Whoever stops the command before the robot appears gets no complaint."""
    assert watch(free_endpoint(), "cruiser-1", stopped=lambda: True) == 0

"""``cruiser shadow`` beside a gateway that is driven: real processes on the virtual chassis."""

import json
import signal
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from gateway.client.refusal import Refused, Stopped, Unreachable
from gateway.client.robot import Robot
from recorder.cli import shadow
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings, ZenohSettings
from tests.support.commands import run_command
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.processes.gateway import Running, chassis, gateway, wait_for_chassis
from tests.support.waiting import DEADLINE_S, wait_until


class Scene(NamedTuple):
    """A robot, whose gateway can be started again, and where it is."""

    endpoint: str
    address: str
    stack: ExitStack


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    """A virtual chassis, without a gateway yet."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with ExitStack() as stack:
        _, address = stack.enter_context(chassis())
        yield Scene(free_endpoint(), address, stack)


def shadowing(scene: Scene, *words: str) -> Running:
    """A shadow of the robot from the start of its run, once it has begun."""
    running = Running("shadow", "cruiser-1", "--connect", scene.endpoint, "--from-start", "--json", *words)
    scene.stack.enter_context(running)
    running.wait_says("shadow: begins at .* at the start of its run")
    return running


def drive(endpoint: str, speed_mps: float) -> None:
    """Engage, drive until the robot has this speed, and give it back; again where a busy machine stopped it."""

    def has_driven() -> bool:
        with (
            suppress(Refused, Stopped, Unreachable),
            Robot.connect("cruiser-1", settings=settings(endpoint), timeout_s=DEADLINE_S) as robot,
            robot.lease() as lease,
        ):
            lease.engage()
            lease.unpark()
            wait_until(
                lambda: robot.state().state.output_speed_mps >= speed_mps,
                lambda: lease.drive(speed_mps, angle_deg=5.0),
            )
            lease.disengage()
            return True
        return False

    wait_until(has_driven)


class Told(NamedTuple):
    """All that a shadow printed: differences, runs, and the sum."""

    differences: list[dict[str, Any]]
    runs: list[dict[str, Any]]
    total: dict[str, Any]


def end(running: Running) -> tuple[int, Told]:
    """Ctrl-C; the exit code, and what it printed."""
    code = running.stop(signal.SIGINT)
    assert running.process.stdout is not None
    lines = [json.loads(line) for line in running.process.stdout]
    return code, Told(
        [line for line in lines if "what" in line], [line for line in lines if "changes" in line], lines[-1]
    )


def test_a_lower_limit_shows_and_one_that_is_not_reached_does_not_also_across_a_restart(scene: Scene) -> None:
    """Both see the drive, the end of the gateway and its next run; only one of them finds a difference."""
    with gateway(scene.address, scene.endpoint) as robot:
        limited = shadowing(scene, "--set", "command.speed_limit_mps=0.3")
        unbound = shadowing(scene, "--set", "command.steering_limit_deg=23")
        drive(scene.endpoint, 0.6)
        assert robot.stop() == ExitCode.OK, robot.said
    with gateway(scene.address, scene.endpoint):
        for running in (limited, unbound):
            running.wait_says("the gateway was started again; it begins again")
            wait_until(lambda one=running: sum("begins at" in line for line in one.said) == 2)  # type: ignore[misc]
        code, found = end(limited)
        assert code == ExitCode.FAILURE
        assert found.total["otherwise"] >= 1
        assert found.total["run"] >= 2
        drives = [one for one in found.differences if one["what"].startswith("drive of ")]
        assert any("bound by speed (0.30 m/s)" in one["other"] for one in drives)
        assert not any("speed" in one["recorded"].replace("m/s", "") for one in drives)
        assert any(one["what"] == "the commands to the chassis" for one in found.differences)
        first, last = found.runs[0], found.runs[-1]
        assert first["settings"] == {"command.speed_limit_mps": [1.0, 0.3]}
        assert first["other"]["top_speed_mps"] < 0.4 < first["recorded"]["top_speed_mps"]
        assert first["run"] != last["run"]
        assert (last["decisions"], last["changes"]) == (0, [])
        code, found = end(unbound)
        # On a busy machine a journal may be missing, which is told, and makes no difference of it.
        assert code in {ExitCode.OK, ExitCode.PARTIAL}
        assert (found.differences, found.total["otherwise"]) == ([], 0)
        assert found.runs[0]["decisions"] > 0


def test_without_the_past_it_waits_for_a_checkpoint_and_says_so(scene: Scene) -> None:
    """Ended before one came, nothing is claimed."""
    with gateway(scene.address, scene.endpoint):
        # Its beginning is past.
        wait_for_chassis(scene.endpoint)
        words = ("cruiser-1", "--connect", scene.endpoint, "--set", "command.deadman_s=0.2", "--json")
        running = scene.stack.enter_context(Running("shadow", *words))
        running.wait_says("shadow: command.deadman_s is .*, tried 0.2")
        code, found = end(running)
        assert (code, found.differences, found.runs) == (ExitCode.PARTIAL, [], [])
        assert found.total["run"] == 0


def test_a_robot_that_falls_silent_is_named(scene: Scene) -> None:
    """And when it is back."""
    with gateway(scene.address, scene.endpoint) as robot:
        running = shadowing(scene, "--set", "command.lease_s=4")
        robot.process.send_signal(signal.SIGSTOP)
        running.wait_says("nothing comes from cruiser-1")
        robot.process.send_signal(signal.SIGCONT)
        running.wait_says("cruiser-1 is back")


def test_a_journal_that_a_profile_leaves_out_is_told(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot answers who it is, and nothing else comes."""
    monkeypatch.setenv("CRUISER_ZENOH_PROFILES", "lo=operator")
    with gateway(scene.address, scene.endpoint):
        monkeypatch.delenv("CRUISER_ZENOH_PROFILES")
        words = ("cruiser-1", "--connect", scene.endpoint, "--set", "command.lease_s=4", "--from-start")
        running = scene.stack.enter_context(Running("shadow", *words))
        running.wait_says(r"nothing comes from cruiser-1; .*zenoh\.profiles is \['lo=operator'\]")


def settings(endpoint: str) -> Settings:
    """Of a shadow of the robots there."""
    return Settings(zenoh=ZenohSettings(connect=[endpoint]))


def test_a_robot_that_is_not_there_is_one_line() -> None:
    """Which says which, where, and who knows more; without any node it says that."""
    endpoint = free_endpoint()
    words = ("cruiser-9", "--set", "command.lease_s=4", "--timeout", "1")
    with pytest.raises(CommandError, match=f"no Zenoh node answers within 1 s at {endpoint}") as error:
        run_command(shadow, *words, settings=settings(endpoint))
    assert error.value.code is ExitCode.UNREACHABLE
    with (
        Peer(endpoint),
        pytest.raises(CommandError, match=r"cruiser-9 does not answer .*'cruiser list' says") as error,
    ):
        run_command(shadow, *words, settings=settings(endpoint))
    assert error.value.code is ExitCode.UNREACHABLE


def test_a_robot_that_only_listens_has_nothing_to_shadow(scene: Scene) -> None:
    """It decides nothing."""
    with (
        gateway(scene.address, scene.endpoint, "--listen-only"),
        pytest.raises(CommandError, match="cruiser-1 listens only"),
    ):
        run_command(shadow, "cruiser-1", "--set", "command.lease_s=4", settings=settings(scene.endpoint))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), "say what to try"),
        (("--set", "command.no_such=1"), "no_such"),
        (("--set", "command.lease_s=99"), "lease_s"),
    ],
)
def test_a_wrong_setting_is_told_before_anybody_is_asked(words: tuple[str, ...], says: str) -> None:
    """Nothing needs to be there for it."""
    with pytest.raises(CommandError, match=says) as error:
        run_command(shadow, "cruiser-1", *words, settings=settings(free_endpoint()))
    assert error.value.code is ExitCode.USAGE

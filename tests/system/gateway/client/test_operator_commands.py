import argparse
import json
import re
from collections.abc import Callable

import msgspec
import pytest

from gateway.cli import drive, lease, reset, stop, watch, why
from gateway.cli.verbs import HORN, LIGHT, ODOMETER, PARK, UNPARK
from schemas.command_line import CommandError, ExitCode
from schemas.decisions import ArbiterState
from schemas.messages import Mode
from schemas.reasons import TEXTS, Reason
from schemas.settings import RESET_MIN_NS, CommandSettings, Settings
from schemas.subjects import BY_VERB
from tests.support.fakes.peer import free_endpoint
from tests.support.fakes.robot import FakeRobot, settings_for
from tests.support.messages import HEALTH
from tests.support.waiting import StopWhen, wait_until

Capture = pytest.CaptureFixture[str]
ACTIONS = {
    "park": (PARK, []),
    "unpark": (UNPARK, []),
    "light": (LIGHT, ["--headlamp"]),
    "horn": (HORN, ["on"]),
    "clear_odometer": (ODOMETER, ["--clear"]),
    "reset_odometry": (ODOMETER, ["--reset-pose"]),
}
DRIVE = ("cruiser-1", "--speed", "1", "--seconds", "100")
STOPPED = "cruiser-1: stopped, latched until a reset"


def run(module: object, endpoint: str, *words: str, until: Callable[[], bool] = lambda: False) -> int:
    parser = argparse.ArgumentParser()
    module.add_arguments(parser)  # type: ignore[attr-defined]  # each is a command's module
    if module is not watch:
        words = (*words, "--operator", "first")
    arguments = parser.parse_args(["--timeout", "10", *words])
    code = module.run(arguments, settings_for(endpoint), StopWhen(until))  # type: ignore[attr-defined]
    assert isinstance(code, int)
    return code


def fails(
    code: ExitCode, says: str, module: object, endpoint: str, *words: str, **more: Callable[[], bool]
) -> str:
    """Run a command that ends with this code and such a line; return the line."""
    with pytest.raises(CommandError, match=says or None) as caught:
        run(module, endpoint, *words, **more)
    assert caught.value.code is code
    return str(caught.value)


def test_drive_for_a_script_drives_and_leaves_the_robot_at_rest(capsys: Capture) -> None:
    with FakeRobot() as fake:
        words = ("cruiser-1", "--speed", "-0.2", "--angle", "3", "--seconds", "1", "--deadman", "0.9")
        assert run(drive, fake.listen, *words) == 0
        assert {one.deadman_s for one in fake.said if one.engaged} == {0.9}
        assert fake.state is ArbiterState.STANDBY
        verbs = list(dict.fromkeys(one.request for one in fake.decisions if one.request not in {"drive", "renew"}))
        assert verbs == ["acquire", "engage", "unpark", "disengage", "release"]
        asked = {(one.requested_speed_mps, one.requested_angle_deg) for one in fake.accepted("drive")}
        assert (-0.2, 3.0) in asked
    driven, link = capsys.readouterr().out.splitlines()
    assert driven == "cruiser-1: driven for 1 s, top speed 0.20 m/s"
    assert re.fullmatch(r"  command latency \d+ ms .*, timeout 900 ms, .* speed limit [\d.]+ m/s", link)


def test_drive_is_ended_early_at_rest(capsys: Capture) -> None:
    limits = Settings(command=CommandSettings(speed_limit_mps=0.25))
    with FakeRobot(settings=limits) as fake:
        moves = lambda: abs(fake.speed_mps) >= 0.2  # noqa: E731 - it reads as a condition
        words = ("cruiser-1", "--speed", "-2", "--angle", "15", "--seconds", "100")
        assert run(drive, fake.listen, *words, until=moves) == ExitCode.PARTIAL
        assert fake.state is ArbiterState.STANDBY
        shown = capsys.readouterr()
        assert shown.err == "cruiser-1: ended before 100 s were over\n"
        assert re.search(r"driven for [\d.]+ s, top speed 0\.2\d m/s", shown.out)


def hit(fake: FakeRobot) -> None:
    fake.front_bumper = True


def loosen(fake: FakeRobot) -> None:
    fake.loose = True


def vanish(fake: FakeRobot) -> None:
    fake.mute = fake.deaf = True


@pytest.mark.parametrize(
    ("fault", "is_told_to_end", "says", "code"),
    [
        pytest.param(hit, False, "front_bumper", ExitCode.FAILURE, id="hit as it drives"),
        pytest.param(hit, True, "front_bumper", ExitCode.FAILURE, id="hit as it comes to rest"),
        pytest.param(loosen, True, "not seen to come to rest within 3 s", ExitCode.FAILURE, id="not at rest"),
        pytest.param(
            vanish, False, "no state from cruiser-1.*use its button", ExitCode.UNREACHABLE, id="not heard"
        ),
    ],
)
def test_a_drive_that_does_not_end_well_says_why(
    monkeypatch: pytest.MonkeyPatch,
    capsys: Capture,
    fault: Callable[[FakeRobot], None],
    is_told_to_end: bool,  # noqa: FBT001 - a column
    says: str,
    code: ExitCode,
) -> None:
    if fault is loosen:
        monkeypatch.setattr("gateway.client.robot.REST_S", 3.0)
    begun: list[bool] = []
    with FakeRobot() as fake:

        def until() -> bool:
            if fake.speed_mps > 0.1:
                fault(fake)
                begun.append(True)
            return is_told_to_end and bool(begun)

        fails(code, says, drive, fake.listen, *DRIVE, until=until)
    assert "driven" not in capsys.readouterr().out


@pytest.mark.parametrize("verb", ACTIONS)
def test_an_action_engages_does_it_and_rests(verb: str, capsys: Capture) -> None:
    """Without a lease; afterwards the lease is released."""
    module, words = ACTIONS[verb]
    with FakeRobot() as fake:
        assert run(module, fake.listen, "cruiser-1", *words, until=lambda: bool(fake.accepted(verb))) == 0
        assert len(fake.accepted(verb)) == 1
        assert fake.state is ArbiterState.STANDBY
        assert fake.flow.arbiter.leases.held is None
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("cruiser-1: engaging the robot;") is BY_VERB[verb].engaged_only


def test_an_action_uses_the_lease_of_another_terminal(capsys: Capture) -> None:
    with FakeRobot() as fake, fake.seen_by() as robot, robot.lease() as held:
        held.engage()
        for verb, (module, words) in ACTIONS.items():
            before = len(fake.accepted(verb))
            assert run(module, fake.listen, "cruiser-1", *words, "--lease", str(held.number), "--json") == 0
            done = json.loads(capsys.readouterr().out)
            assert (done["robot"], done["verb"], done["ok"]) == ("cruiser-1", verb, True)
            assert len(fake.accepted(verb)) == before + 1
            held.check()
            assert held.is_engaged
            fails(ExitCode.REFUSED, "", module, fake.listen, "cruiser-1", *words, "--lease", "1")


def test_stop_and_reset(capsys: Capture) -> None:
    with FakeRobot() as fake:
        with fake.engaged() as (robot, held):
            wait_until(lambda: fake.speed_mps > 0.2, lambda: held.drive(1.0))
            assert run(stop, fake.listen, "cruiser-1", "--no-wait") == 0
            assert robot.state().state.state is ArbiterState.STOPPING
            assert run(stop, fake.listen, "cruiser-1") == 0
            assert fake.state is ArbiterState.STANDBY
            fails(ExitCode.REFUSED, "lease_held", reset, fake.listen, "cruiser-1")
            assert run(reset, fake.listen, "cruiser-1", "--lease", str(held.number)) == 0
        assert run(drive, fake.listen, "cruiser-1", "--speed", "0.2", "--seconds", "0.3") == 0
        assert capsys.readouterr().out.splitlines()[:3] == [STOPPED, STOPPED, "cruiser-1: cleared remote_stop"]
        assert run(stop, fake.listen, "cruiser-1") == 0
        assert run(stop, fake.listen, "--all", "--json") == 0
        assert Reason.REMOTE_STOP in fake.latched
        with pytest.raises(CommandError, match="remote_stop"):
            run(PARK, fake.listen, "cruiser-1")
        assert run(reset, fake.listen, "cruiser-1") == 0
        assert not fake.latched
        assert run(reset, fake.listen, "cruiser-1") == 0
        fake.flow.arbiter.engagement.latch(Reason.GUARD, "", fake.now_ns - RESET_MIN_NS)
        assert run(reset, fake.listen, "cruiser-1", "--json") == 0
        assert run(reset, fake.listen, "cruiser-1", "--json") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == STOPPED
    assert json.loads(lines[1])["stopped"] == ["cruiser-1"]
    assert lines[2:4] == ["cruiser-1: cleared remote_stop", "cruiser-1: nothing was latched"]
    assert [json.loads(line)["cleared"] for line in lines[4:]] == [["guard"], []]


def test_a_stop_of_somebody_elses_is_reset_by_name(capsys: Capture) -> None:
    """Row 'reset of a stop by somebody else': whoever stopped the robot may stand before it."""
    with FakeRobot("cruiser-1") as fake:
        with fake.seen_by("bob") as robot:
            robot.stop()
            assert robot.state().state.stopped_by == ["bob"]
        line = fails(ExitCode.REFUSED, "bob", reset, fake.listen, "cruiser-1")
        assert "'cruiser reset cruiser-1 --of NAME'" in line
        assert run(why, fake.listen, "cruiser-1") == ExitCode.FAILURE
        assert "stopped by bob" in capsys.readouterr().out
        assert run(reset, fake.listen, "cruiser-1", "--of", "bob") == ExitCode.OK


def test_stop_takes_several_names_and_patterns(capsys: Capture) -> None:
    with (
        FakeRobot("depot-1") as fake,
        FakeRobot("depot-2", connect=fake.listen) as second,
        FakeRobot("yard-1", connect=fake.listen) as third,
        FakeRobot("yard-2", connect=fake.listen) as other,
    ):
        assert run(stop, fake.listen, "depot-*", "yard-1", "--json") == 0
        assert json.loads(capsys.readouterr().out)["stopped"] == ["depot-1", "depot-2", "yard-1"]
        assert all(Reason.REMOTE_STOP in one.latched for one in (fake, second, third))
        assert not other.latched
        assert run(stop, fake.listen, "yard-2", "hall-*", "--timeout", "3") == ExitCode.PARTIAL
        said = capsys.readouterr()
    assert said.out == "yard-2: stopped, latched until a reset\n"
    assert said.err == "hall-*: NO REPLY; the stop was sent. Use the button on the robot\n"


def test_stop_that_nobody_answers_is_an_error(capsys: Capture) -> None:
    with FakeRobot("cruiser-1") as fake, FakeRobot("cruiser-2", connect=fake.listen, deaf=True) as deaf:
        nobody = "no robot replied"
        fails(ExitCode.UNREACHABLE, nobody, stop, fake.listen, "cruiser-2", "--timeout", "2")
        assert Reason.REMOTE_STOP in deaf.latched
        assert "cruiser-2: NO REPLY" in capsys.readouterr().err
        before = len(deaf.puts)
        with pytest.raises(CommandError, match="no robot replied before Ctrl-C"):
            run(stop, fake.listen, "cruiser-2", until=lambda: deaf.has_heard(before + 1))
        assert "cruiser-2: NO REPLY" in capsys.readouterr().err
        assert run(stop, fake.listen, "--all", "--timeout", "3") == ExitCode.PARTIAL
        said = capsys.readouterr()
    assert said.out == "cruiser-1: stopped, latched until a reset\n"
    assert said.err.startswith("cruiser-2: NO REPLY")
    for words in ([], ["cruiser-1", "--all"]):
        fails(ExitCode.USAGE, "", stop, free_endpoint(), *words)


def test_who_names_a_robot_that_is_not_there_learns_which_are() -> None:
    with FakeRobot("cruiser-1") as fake, FakeRobot("cruiser-2", connect=fake.listen):
        for module in (why, stop, watch):
            says = r"; connected: cruiser-1, cruiser-2$"
            fails(ExitCode.UNREACHABLE, says, module, fake.listen, "cruiser-9", "--timeout", "1")
    with FakeRobot("cruiser-1", mute=True) as fake:
        line = fails(ExitCode.UNREACHABLE, "no state received", why, fake.listen, "cruiser-1", "--timeout", "1")
        assert "connected" not in line


def test_a_stop_that_cannot_be_carried_out_is_no_success(capsys: Capture) -> None:
    """Row 'a stop that cannot be carried out: reason, what it does now; exit 3'."""
    with FakeRobot("cruiser-1") as fake, FakeRobot("cruiser-2", connect=fake.listen) as other:
        other.mode = Mode.REMOTE
        assert run(stop, fake.listen, "cruiser-2") == 3
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err == (
            "cruiser-2: NOT STOPPED: hand_transmitter: the remote control has the robot; latched; not "
            "carried out: the robot stands. Use the button on the robot\n"
        )
        assert run(stop, fake.listen, "--all", "--json") == ExitCode.PARTIAL
        report = json.loads(capsys.readouterr().out)
        assert (report["stopped"], list(report["refused"])) == (["cruiser-1"], ["cruiser-2"])
        assert Reason.REMOTE_STOP in other.latched


def test_why_says_each_reason_with_its_cure(capsys: Capture) -> None:
    with FakeRobot() as fake:

        def says(code: int, *texts: str, but: str = "\0") -> None:
            assert run(why, fake.listen, "cruiser-1") == code
            text = capsys.readouterr().out
            assert [one for one in texts if one not in text] == []
            assert but not in text

        idle = [Reason.NO_LEASE, Reason.NOT_ENGAGED]
        wait_until(lambda: bool(fake.said) and fake.said[-1].blocked_by == idle)
        says(0, "nothing is wrong: no operator is driving")
        assert run(stop, fake.listen, "cruiser-1") == 0
        capsys.readouterr()
        says(
            1,
            "no_lease: no operator holds the lease -> acquire it with 'cruiser drive cruiser-1'",
            "remote_stop: a remote stop was received -> reset with 'cruiser reset cruiser-1'",
            "last events:",
            "latched until a reset",
            but="nothing is wrong",
        )
        assert run(reset, fake.listen, "cruiser-1") == 0
        capsys.readouterr()
        with fake.seen_by() as robot, robot.lease() as held:
            held.engage()
            assert run(why, fake.listen, "cruiser-1", "--json") == 1
            assert [one["reason"] for one in json.loads(capsys.readouterr().out)["blocked_by"]] == ["parked"]
            held.unpark()
            assert robot.wait_for(lambda state: state.blocked_by == [], 20)
            says(0, "blockers: none")


def test_why_says_that_the_gateway_has_no_real_time_priority(capsys: Capture) -> None:
    """Row 'a gateway without real-time priority says so in why'."""
    slow = msgspec.structs.replace(HEALTH, realtime=False)
    with FakeRobot(health=slow) as fake:
        run(why, fake.listen, "cruiser-1")
        text = TEXTS[Reason.NO_REALTIME]
        assert f"  slowed by no_realtime: {text.means} -> {text.cure}\n" in capsys.readouterr().out
        run(why, fake.listen, "cruiser-1", "--json")
        assert [one["reason"] for one in json.loads(capsys.readouterr().out)["slowed_by"]] == ["no_realtime"]
        fake.health = HEALTH
        run(why, fake.listen, "cruiser-1")
        assert "slowed" not in capsys.readouterr().out


def test_lease_shows_the_holder_and_can_be_held(capsys: Capture) -> None:
    with FakeRobot() as fake:
        assert run(lease, fake.listen, "cruiser-1") == 0
        assert capsys.readouterr().out == "cruiser-1: no operator holds the lease\n"
        engaged = lambda: fake.state is ArbiterState.ENGAGED  # noqa: E731 - it reads as a condition
        assert run(lease, fake.listen, "cruiser-1", "--hold", "--engage", until=engaged) == 0
        assert int(capsys.readouterr().out) > 0
        assert fake.flow.arbiter.leases.held is None
        with fake.seen_by("second") as robot, robot.lease() as held:
            assert run(lease, fake.listen, "cruiser-1", "--json") == 0
            assert json.loads(capsys.readouterr().out)["lease_holder"] == "second"
            with pytest.raises(CommandError, match="role_too_low"):
                run(lease, fake.listen, "cruiser-1", "--take", "--role", "program")
            assert run(lease, fake.listen, "cruiser-1", "--take", "--seconds", "0.2") == 0
            # By what it has heard meanwhile, or by the robot's answer.
            with pytest.raises(CommandError, match=r"is lost|someone else has taken the lease"):
                held.engage()

"""A recorded run beside the one that it would have been."""

from collections.abc import Callable, Iterator

import msgspec
import pytest

from gateway.rerun import GivenOutput, what_if
from schemas import codec
from schemas.decisions import Decision, EventKind, Journal, SafetyEvent, Verdict
from schemas.messages import Message, Mode, RobotState, Variant
from schemas.reasons import Reason
from schemas.settings import CommandSettings, Settings
from schemas.subjects import BY_NAME
from tests.support.nights import by_night
from tests.support.rigs.day import Day
from tests.support.rigs.gateway import GatewayRig, Operator

Recorded = tuple[Settings, list[Journal]]


def drive_out(act: Callable[[GatewayRig, Operator], None] = lambda _rig, _operator: None) -> Recorded:
    """Somebody drives with 1.5 m/s, something happens, and the robot is brought to rest."""
    day = Day(1, Variant.COARSE, ticks=0)
    rig = day.rig
    rig.run(0.6)
    operator = Operator(rig)
    operator.engage()
    operator.drive(1.5, 4.0, 3.0)
    act(rig, operator)
    operator.ask("disengage")
    rig.run(5)
    return rig.settings, day.rig.journals


def other(settings: Settings, **command: object) -> Settings:
    """The same settings but for some of the command flow."""
    changed = msgspec.structs.replace(settings.command, **command)
    return msgspec.structs.replace(settings, command=changed)


def said(recorded: Recorded, **command: object) -> tuple[list[Message], list[Message]]:
    """What the two runs say: the recorded one, and the one with other settings."""
    settings, run = recorded
    sides: tuple[list[Message], list[Message]] = ([], [])
    for one in what_if(settings, other(settings, **command), run):
        message = codec.decode(BY_NAME[one.sample.subject], one.sample.payload)
        assert isinstance(message, Message)
        sides[one.is_other].append(message)
    return sides


def of(messages: list[Message], kind: type[Message]) -> Iterator[Message]:
    """Those of a class."""
    return (message for message in messages if isinstance(message, kind))


def stops(messages: list[Message]) -> list[Reason]:
    """Why the robot was stopped."""
    return [event.reason for event in messages if isinstance(event, SafetyEvent) and event.kind is EventKind.STOP]


def top_speed_mps(messages: list[Message]) -> float:
    """The highest speed that the robot showed."""
    return max(abs(state.speed_mps or 0.0) for state in messages if isinstance(state, RobotState))


def test_with_the_same_settings_both_runs_are_the_same() -> None:
    """Every sample, whatever happens in between."""
    day = Day(1, Variant.FINE, ticks=1500)
    day.live()
    pairs: tuple[list[GivenOutput], list[GivenOutput]] = ([], [])
    for one in what_if(day.rig.settings, day.rig.settings, day.rig.journals):
        pairs[one.is_other].append(one)
    assert len(pairs[0]) > 1000
    assert [one.sample for one in pairs[0]] == [one.sample for one in pairs[1]]


def test_a_lower_limit_slows_the_robot_and_stops_nothing() -> None:
    """The chassis follows the other commands: no plausibility check takes the recorded speed for a fault."""
    then, now = said(drive_out(), speed_limit_mps=0.5)
    assert top_speed_mps(then) == pytest.approx(1.5, abs=0.1)
    assert top_speed_mps(now) == pytest.approx(0.5, abs=0.05)
    assert stops(now) == stops(then) == [Reason.DISENGAGED]


def test_the_commands_are_still_good_for_the_other_arbiter() -> None:
    """It published in other ticks, and whoever had heard it would have echoed those challenges."""
    then, now = said(drive_out(), speed_limit_mps=0.5)
    judged = [decision for decision in of(now, Decision) if isinstance(decision, Decision)]
    assert len(judged) == len(list(of(then, Decision))) > 100
    assert {decision.verdict for decision in judged} == {Verdict.ACCEPTED}


def test_a_shorter_deadman_adds_a_stop() -> None:
    """A pause that the recorded run bore; what is asked after the stop is refused."""

    def pause(rig: GatewayRig, operator: Operator) -> None:
        rig.run(0.2)
        operator.drive(1.5, 4.0, 0.5)

    then, now = said(drive_out(pause), deadman_s=0.1)
    assert Reason.DEADMAN not in stops(then)
    assert stops(now)[0] is Reason.DEADMAN
    assert top_speed_mps(then) > 1.4


def test_what_people_did_stays() -> None:
    """A bumper that was hit is hit, and latches."""

    def hit(rig: GatewayRig, _operator: Operator) -> None:
        rig.fault("bumper front on for 500ms")
        rig.run(3)

    then, now = said(drive_out(hit), speed_limit_mps=0.5)
    assert Reason.FRONT_BUMPER in stops(then)
    assert Reason.FRONT_BUMPER in stops(now)


def test_the_hand_transmitter_drives_as_recorded() -> None:
    """While it has the robot, the recorded speed is the speed."""

    def take_over(rig: GatewayRig, _operator: Operator) -> None:
        rig.fault("transmitter remote for 3s")
        rig.fault("sticks 0.8 5")
        rig.run(2.5)

    then, now = said(drive_out(take_over), speed_limit_mps=0.3)
    states = [[one for one in messages if isinstance(one, RobotState)] for messages in (then, now)]
    driven = [
        (recorded.speed_mps, tried.speed_mps)
        for recorded, tried in zip(*states, strict=True)
        if recorded.mode is tried.mode is Mode.REMOTE
    ]
    assert len(driven) > 20
    assert driven[-1][0] == driven[-1][1] == pytest.approx(0.8, abs=0.05)


def test_afterwards_the_recorded_chassis_is_believed_again() -> None:
    """Once both stand with nobody in command, the two see the same."""
    then, now = said(drive_out(), speed_limit_mps=0.5)
    last_then, last_now = (
        [state for state in messages if isinstance(state, RobotState)][-1] for messages in (then, now)
    )
    assert last_then == last_now


def test_nothing_comes_of_nothing() -> None:
    """A run without inputs."""
    assert not list(what_if(Settings(), Settings(command=CommandSettings()), []))


NESTED = b"\x91" * 1000 + b"\x01"


@pytest.mark.parametrize(
    "payload", [NESTED, *map(by_night, [b"\x81\x91\x01\x01", b"\xc1", b"\x81\xa9challenge\x91\x01"])]
)
def test_whatever_somebody_asked_is_asked_of_both(payload: bytes) -> None:
    """A request is anybody's bytes, nested as deep as it may be."""

    def ask(rig: GatewayRig, _operator: Operator) -> None:
        rig.put("stranger", "drive", payload)
        rig.run(0.1)

    for side in said(drive_out(ask), speed_limit_mps=0.5):
        strangers = [one for one in side if isinstance(one, Decision) and one.operator == "stranger"]
        assert [one.reason for one in strangers] == [Reason.MALFORMED]

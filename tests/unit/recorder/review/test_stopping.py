"""What became of the robot: of this stop, and of no other."""

from functools import cache
from pathlib import Path

import msgspec
import pytest

from recorder.review.window import Step
from schemas.codec import Sample
from schemas.decisions import ArbiterState
from schemas.reasons import Reason
from tests.support.messages import MS, SECOND
from tests.support.rigs import scenarios
from tests.support.rigs.gateway import Operator
from tests.support.rigs.recorded import RecordedRig, ask, texts
from tests.support.rigs.scenarios import acted


@cache
def _taken_over() -> tuple[RecordedRig, int, int]:
    """The hand transmitter takes the robot, drives it on with its sticks, and gives it back while it moves.

    Returns:
        the rig, and the robot's time of the takeover and of the stop that follows.
    """
    rig, operator = RecordedRig.driving()
    rig.fault("transmitter remote for 3s")
    operator.drive(0.6, 0.0, 0.6)
    rig.fault("sticks 0.4 5")
    rig.until(lambda: rig.says.state is ArbiterState.STOPPING, 5)
    rig.rest()
    times = [next(one.time_ns for one in rig.events if one.reason is reason) for reason in _REASONS]
    return rig, times[0], times[1]


_REASONS = (Reason.HAND_TRANSMITTER, Reason.FOUND_MOVING)


@pytest.mark.parametrize("before_stop_ns", [0, 100 * MS])
def test_after_a_takeover_the_sticks_move_the_robot_on(before_stop_ns: int, tmp_path: Path) -> None:
    """That it stood for a while is no end, and the stop that came later is none of the takeover's."""
    rig, taken_ns, stop_ns = _taken_over()
    at_ns = stop_ns - before_stop_ns if before_stop_ns else taken_ns + 20 * MS
    explanation = ask(tmp_path / "log.mcap", rig.log(), at_ns)
    assert explanation.reason is Reason.HAND_TRANSMITTER
    done = texts(explanation, Step.ACTION)
    assert "the gateway sends nothing" in done
    assert "later, at up to 0.4" in done
    assert "it moved again" in done
    assert "stopped: the robot is told nothing" not in done


def test_a_robot_that_the_sticks_move_is_not_kept_from_moving(tmp_path: Path) -> None:
    """That it moves keeps it from being engaged, and from nothing else."""
    rig, _, stop_ns = _taken_over()
    explanation = ask(tmp_path / "log.mcap", rig.log(), stop_ns - 100 * MS)
    assert explanation.state is ArbiterState.STANDBY
    assert explanation.headline.startswith("It was not engaged. The last stop was")
    causes = texts(explanation, Step.CAUSE)
    assert "it could not be engaged: the robot moves" in causes
    assert "kept from moving" not in causes


def test_a_takeover_is_called_no_stop(tmp_path: Path) -> None:
    """Nor is it timed as one."""
    rig, taken_ns, _ = _taken_over()
    explanation = ask(tmp_path / "log.mcap", rig.log(), taken_ns - 100 * MS)
    assert "100 ms later it was let go: the hand transmitter has the robot" in explanation.headline
    assert "said Mode = remote, at the takeover; the one" in texts(explanation, Step.EVIDENCE)


def test_right_before_a_stop_of_a_robot_that_nobody_engaged_it_is_told_as_to_come(tmp_path: Path) -> None:
    """It is not the last one yet. What blocked it until then is shown by the frame that said so."""
    rig, _, stop_ns = _taken_over()
    explanation = ask(tmp_path / "log.mcap", rig.log(), stop_ns - 5 * MS)
    assert explanation.headline.startswith("It was not engaged; 5.0 ms later a stop began: found moving at 0.3")
    assert "it could not be engaged: the hand transmitter has the robot" in texts(explanation, Step.CAUSE)
    assert "said Mode = remote" in texts(explanation, Step.EVIDENCE)
    assert texts(explanation, Step.MISSING) == ""


def test_commands_of_before_a_takeover_are_none_of_the_next_stop(tmp_path: Path) -> None:
    """Nobody commanded the robot then."""
    rig, _, stop_ns = _taken_over()
    explanation = ask(tmp_path / "log.mcap", rig.log(), stop_ns + 100 * MS)
    assert explanation.reason is Reason.FOUND_MOVING
    assert "acceptable drive command" not in texts(explanation, Step.COMMAND)


@pytest.mark.parametrize("without", [(), ("safety/state",)])
def test_a_stop_ends_with_the_next_engagement(without: tuple[str, ...], tmp_path: Path) -> None:
    """A second stop soon after: neither its request nor its end is told of the first."""
    rig, operator = RecordedRig.driving()
    operator.reason("disengage")
    first_ns = next(one.time_ns for one in rig.events if one.reason is Reason.DISENGAGED)
    rig.rest()
    again = Operator(rig, "operator-1")
    again.engage()
    again.drive(0.6, 0.0, 1.0)
    again.reason("disengage")
    rig.rest()
    explanation = ask(tmp_path / "log.mcap", rig.log(without=without), first_ns + 50 * MS)
    assert "the request was disengage, of operator-1" in texts(explanation, Step.EVIDENCE)
    assert "came after it" not in texts(explanation, Step.EVIDENCE)
    done = texts(explanation, Step.ACTION)
    assert done.count("stopped: the robot is told nothing, and stands") == 1
    assert "moved again" not in done


def test_a_stop_that_the_hand_transmitter_cuts_short_keeps_its_cause(tmp_path: Path) -> None:
    """While it was being stopped, nobody had taken it over yet."""
    rig, operator = RecordedRig.driving()
    operator.reason("disengage")
    rig.run(0.2)
    rig.fault("transmitter remote for 9s")
    rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 5)
    taken_ns = next(one.time_ns for one in rig.events if one.reason is Reason.HAND_TRANSMITTER)
    rig.run(1.0)
    explanation = ask(tmp_path / "log.mcap", rig.log(), taken_ns - 20 * MS)
    assert explanation.headline == "It was being stopped: the holder of the lease disengaged."
    assert "stopped: the robot is told nothing" not in texts(explanation, Step.ACTION)


def test_the_arbiter_s_own_count_stands_beside_the_time_of_a_decision(tmp_path: Path) -> None:
    """A decision is told some time into its tick: its age alone would read as too little."""
    rig = acted(scenarios.deadman)
    at_once = texts(ask(tmp_path / "log.mcap", rig.log()), Step.EVIDENCE)
    assert "310 ms before the stop: 0.60 m/s" in at_once
    explanation = ask(tmp_path / "log.mcap", _later_decisions(rig, 12 * MS))
    assert "298 ms before the stop, 310 ms as the arbiter counts: 0.60 m/s" in texts(explanation, Step.EVIDENCE)
    (shown,) = (one.data for one in explanation.chain if "counted_ms" in one.data)
    assert (shown["counted_ms"], shown["limit_ms"]) == (310.0, 300.0)


def _later_decisions(rig: RecordedRig, ns: int) -> bytes:
    """The log of a rig whose decisions are told so much later."""

    def later(sample: Sample) -> Sample:
        if sample.subject != "safety/decision":
            return sample
        fields = msgspec.msgpack.decode(sample.payload)
        payload = msgspec.msgpack.encode({**fields, "time_ns": fields["time_ns"] + ns})
        return msgspec.structs.replace(sample, payload=payload)

    kept = rig.recorded
    rig.recorded = [(at_ns, later(sample)) for at_ns, sample in kept]
    try:
        return rig.log()
    finally:
        rig.recorded = kept


def test_a_new_engagement_has_no_command_yet(tmp_path: Path) -> None:
    """What was asked for before it is no command of it."""
    rig, operator = RecordedRig.driving()
    operator.reason("disengage")
    rig.rest()
    assert operator.take_lease() is Reason.NONE
    handle = operator.ask("engage")
    rig.until(lambda: handle in rig.replies)
    rig.run(0.1)
    explanation = ask(tmp_path / "log.mcap", rig.log(), rig.at_ns)
    assert explanation.state is ArbiterState.ENGAGED
    assert "no drive command was accepted since it was engaged" in texts(explanation, Step.COMMAND)
    assert "0.60" not in texts(explanation, Step.COMMAND) + explanation.headline


def test_of_another_run_nothing_is_told_as_of_this_one(tmp_path: Path) -> None:
    """A gateway that has just begun knows no scale yet, whatever the one before it took it for."""
    first, _ = RecordedRig.driving(run=1)
    second = RecordedRig.beginning(first.at_ns + 3 * SECOND, run=2)
    begun_ns = second.at_ns
    second.run(1.0)
    # It has not told what it makes of the robot yet.
    first.recorded += [(at_ns, one) for at_ns, one in second.recorded if one.subject != "state"]
    explanation = ask(tmp_path / "log.mcap", first.log(), begun_ns + 15 * MS)
    assert explanation.state is ArbiterState.STANDBY
    assert "the firmware variant" in texts(explanation, Step.CAUSE)
    assert "the gateway took the firmware variant for coarse" not in texts(explanation, Step.EVIDENCE)

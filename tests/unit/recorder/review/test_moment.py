"""What is in the way of a robot, and what is not."""

from pathlib import Path

import pytest

from recorder.review.why import Explanation
from recorder.review.window import Step
from schemas.decisions import ArbiterState
from schemas.reasons import Reason
from tests.support.messages import MS
from tests.support.rigs.gateway import Operator
from tests.support.rigs.recorded import RecordedRig, ask, texts

PRESSED = "it could not be driven forward: the front bumper was hit, and was pressed still"


def _acknowledged() -> tuple[RecordedRig, Operator]:
    """The front bumper was hit, and is pressed still; the robot is reset and engaged again."""
    rig, operator = RecordedRig.driving()
    rig.fault("bumper front on for 60s")
    operator.drive(0.6, 0.0, 0.2)
    rig.rest()
    assert operator.take_lease() is Reason.NONE
    assert operator.reason("reset") is Reason.NONE
    operator.engage()
    return rig, operator


@pytest.mark.parametrize(
    ("speed_mps", "seconds", "headline", "said"),
    [
        # It speeds up backward, as the cure says: nothing blocks it, and nothing is to be cured.
        (-0.5, 0.2, "It was engaged, commanded -0.0", {}),
        (-0.5, 0.28, "It was engaged, commanded -0.10 m/s, and hardly moved, at 0.04 m/s.", {}),
        (-0.5, 0.7, "It was engaged and moved, at 0.", {}),
        # It stands for its operator; what it could not have done is told besides.
        (0.0, 0.3, "It was engaged and stood: operator-1 requested zero speed.", {Step.CAUSE: PRESSED}),
        # What was reset need not be reset.
        (
            0.5,
            0.5,
            "It was engaged and stood: the front bumper was hit.",
            {
                Step.CAUSE: PRESSED,
                Step.EVIDENCE: "FrontBumper = 1",
                Step.CURE: "to cure front_bumper: drive backward",
            },
        ),
    ],
)
def test_a_bumper_is_in_the_way_of_a_robot_that_is_to_go_there(
    speed_mps: float, seconds: float, headline: str, said: dict[Step, str], tmp_path: Path
) -> None:
    """And not of one that goes away from it, or is asked for nothing."""
    rig, operator = _acknowledged()
    operator.drive(speed_mps, 0.0, seconds)
    explanation = ask(tmp_path / "log.mcap", rig.log(), rig.at_ns)
    assert explanation.headline.startswith(headline)
    assert (texts(explanation, Step.CAUSE) == "") is (speed_mps < 0)
    assert speed_mps >= 0 or "front_bumper" not in texts(explanation, Step.CURE)
    for step, words in said.items():
        assert words in texts(explanation, step)


def _remotely_stopped() -> tuple[RecordedRig, Operator]:
    rig, operator = RecordedRig.driving()
    rig.put("desk", "stop", b"")
    rig.tick()
    rig.rest()
    return rig, operator


def _cures(explanation: Explanation) -> str:
    return texts(explanation, Step.CURE)


def test_what_was_reset_is_not_to_be_reset(tmp_path: Path) -> None:
    """Before the reset the cure begins with it, behind it does not; and whose reset it was is told."""
    rig, operator = _remotely_stopped()
    latched_ns = rig.at_ns
    assert operator.take_lease() is Reason.NONE
    assert operator.reset() is Reason.NONE
    rig.run(0.3)
    before = ask(tmp_path / "log.mcap", rig.log(), latched_ns)
    after = ask(tmp_path / "log.mcap", rig.log(), rig.at_ns)
    assert "to cure remote_stop: reset with 'cruiser reset cruiser-1'" in _cures(before)
    assert "to cure remote_stop: engage with 'cruiser drive cruiser-1'" in _cures(after)
    assert "reset by operator-1" in texts(after, Step.LATCH)


def test_a_reset_of_nothing_resets_no_latch(tmp_path: Path) -> None:
    """That of the next gateway, which does not know of the latch, is none of it."""
    rig, _ = _remotely_stopped()
    latched_ns = rig.at_ns
    second = RecordedRig.beginning(rig.at_ns + 1000 * MS, run=2)
    second.run(0.6)
    operator = Operator(second, "operator-2")
    assert operator.take_lease() is Reason.NONE
    assert operator.reason("reset") is Reason.NONE
    second.run(0.3)
    rig.recorded += second.recorded
    explanation = ask(tmp_path / "log.mcap", rig.log(), latched_ns)
    assert explanation.state is ArbiterState.STANDBY
    assert "remote_stop, and no reset of it is in the log" in texts(explanation, Step.LATCH)

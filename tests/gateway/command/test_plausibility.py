"""Row 'plausibility: wheel speeds against the command and against drive feedback: over by 0.3 m/s and 1.5 x'."""

import pytest

from gateway.command.plausibility import Plausibility, exceeds, fits, fitting_scale

MS = 1_000_000


def watched(
    wheel_mps: float | None, drive_mps: float | None, commanded_mps: float, for_ms: int, start_mps: float = 0.0
) -> Plausibility | None:
    """What it says after so long; None if all fits."""
    made = Plausibility()
    made.forget(start_mps)
    found = False
    for at_ms in range(0, for_ms + 1, 10):
        found = made.observe(wheel_mps, drive_mps, commanded_mps, at_ms * MS)
    return made if found else None


@pytest.mark.parametrize(
    ("larger", "smaller", "over"),
    [
        (0.3, 0.0, False),
        (0.301, 0.0, True),
        (1.5, 1.0, False),
        (1.51, 1.0, True),
        (0.8, 0.5, False),
        (0.7, 0.3, True),
    ],
)
def test_over_by_both_the_difference_and_the_factor(larger: float, smaller: float, over: bool) -> None:  # noqa: FBT001
    """Row 'plausibility: over by 0.3 m/s and 1.5 x': each boundary."""
    assert exceeds(larger, smaller) is over
    assert not exceeds(smaller, larger)
    assert fits(larger, smaller) is fits(smaller, larger) is not over


@pytest.mark.parametrize("sign", [1, -1])
def test_wheels_that_turn_faster_than_commanded_are_found_after_300_ms(sign: int) -> None:
    """Row 'plausibility: for 300 ms: stop': at 300 ms, and not at 290; in either direction."""
    assert watched(sign * 1.0, 1.0, sign * 0.5, 290) is None
    found = watched(sign * 1.0, 1.0, sign * 0.5, 300)
    assert found is not None
    assert "at 1.00 m/s, commanded is 0.50" in found.detail


@pytest.mark.parametrize("sign", [1, -1])
def test_wheels_that_turn_the_other_way_are_found(sign: int) -> None:
    """A robot that rolls back down a slope, or has the wrong gear in."""
    found = watched(-sign * 0.5, 0.5, sign * 0.5, 300)
    assert found is not None
    assert ("backward" if sign > 0 else "forward") in found.detail
    assert watched(-sign * 0.3, 0.3, sign * 0.5, 900) is None


@pytest.mark.parametrize(("wheel_mps", "drive_mps"), [(0.0, 1.0), (1.0, 0.5), (-1.0, 0.5)])
def test_wheels_and_drive_feedback_that_differ_are_found(wheel_mps: float, drive_mps: float) -> None:
    """Whichever is the larger, while the command fits."""
    commanded_mps = 1.0 if wheel_mps >= 0 else -1.0
    assert watched(wheel_mps, drive_mps, commanded_mps, 290) is None
    found = watched(wheel_mps, drive_mps, commanded_mps, 300)
    assert found is not None
    assert f"at {abs(wheel_mps):.2f} m/s, the drive feedback says {drive_mps:.2f}" in found.detail


def test_what_fits_in_between_begins_anew() -> None:
    """300 ms without a break."""
    made = Plausibility()
    for at_ms in range(0, 2_000, 10):
        wheel_mps = 0.5 if at_ms % 300 == 290 else 1.0
        assert not made.observe(wheel_mps, wheel_mps, 0.5, at_ms * MS)


def test_a_robot_that_slows_down_lags() -> None:
    """A command that falls to zero is held against the wheels no faster than by 0.8 m/s2."""
    made = Plausibility()
    made.observe(1.0, 1.0, 1.0, 0)
    for at_ms in range(10, 1_300, 10):
        wheel_mps = max(0.0, 1.0 - 0.8 * at_ms / 1000)
        assert not made.observe(wheel_mps, wheel_mps, 0.0, at_ms * MS)
    made.forget()
    made.observe(1.0, 1.0, 1.0, 0)
    found = [made.observe(1.0, 1.0, 0.0, at_ms * MS) for at_ms in range(10, 1_300, 10)]
    assert True in found


@pytest.mark.parametrize("speed_mps", [1.5, -1.5])
def test_a_robot_that_is_found_moving_has_its_speed(speed_mps: float) -> None:
    """It was not commanded by us."""
    assert watched(speed_mps, 1.5, 0.0, 600, start_mps=speed_mps) is None
    assert watched(speed_mps, 1.5, 0.0, 300) is not None


@pytest.mark.parametrize(("wheel_mps", "drive_mps"), [(None, 2.0), (2.0, None)])
def test_what_is_not_known_does_not_misfit(wheel_mps: float | None, drive_mps: float | None) -> None:
    """Missing feedback is a cause of its own."""
    assert watched(wheel_mps, drive_mps, 0.0, 900) is None


@pytest.mark.parametrize(
    ("drive_mps", "wheel_mps", "words"),
    [
        (0.025, 1.0, "; the coarse scale of the drive frames would fit"),
        (1.0, 0.025, "; the fine scale of the drive frames would fit"),
        (1.0, 0.0, "; the fine scale of the drive frames would fit"),
        (1.0, 1.0, ""),
        (0.3, 0.3, ""),
        (1.0, 3.0, ""),
        (0.0, 1.0, ""),
    ],
)
def test_which_scale_fits(drive_mps: float, wheel_mps: float, words: str) -> None:
    """Row 'plausibility: and say which scale fits'."""
    assert fitting_scale(drive_mps, wheel_mps) == words


def test_the_scale_of_the_command_is_told_too() -> None:
    """A coarse chassis that is told speeds in fine bits, while its feedback is right."""
    found = watched(2.0, 2.0, 0.05, 300)
    assert found is not None
    assert found.detail.endswith("the coarse scale of the drive frames would fit")

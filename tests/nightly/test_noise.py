"""An hour on a bus that loses and damages frames (``make nightly``)."""

import pytest

from tests.system.scenarios.test_noise import causeless_stops

HOUR_S = 3600.0


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", [1, 2])
def test_an_hour_of_lost_and_damaged_frames_has_no_stop_without_a_cause(seed: int) -> None:
    """1 % lost, 0.1 % damaged; both scales of the speed."""
    assert causeless_stops(seed, HOUR_S) == []

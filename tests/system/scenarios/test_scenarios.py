"""Random scenarios, judged by the table "Command rules" of the design."""

import pytest

from tests.support.nights import seeds
from tests.system.scenarios.scenario import run

SEEDS = seeds(6, 70)
RUN_AGAIN_EVERY = 10


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_scenario_breaks_no_rule(seed: int) -> None:
    """With any hill, load, operator and faults; its rerun is equal."""
    result = run(seed, runs_again=seed % RUN_AGAIN_EVERY == 0)
    again = f"again: python -m tests.system.scenarios --seed {seed} --trace"
    assert result.violations == [], "\n".join([again, *map(str, result.violations)])

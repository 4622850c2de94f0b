"""Random scenarios, judged by the table "Command rules" of the design.

Many more of them: ``python -m tests.system.scenarios --count 10000 --jobs 2``.
"""

import pytest

from tests.support.nights import seeds
from tests.system.scenarios.scenario import run, scenario

SEEDS = seeds(6, 70)
RUN_AGAIN_EVERY = 10


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_scenario_breaks_no_rule(seed: int) -> None:
    """Whatever the hill, the load, the operator and the faults: every command rule holds, and so does a re-run."""
    result = run(seed, runs_again=seed % RUN_AGAIN_EVERY == 0)
    again = f"again: python -m tests.system.scenarios --seed {seed} --trace"
    assert result.violations == [], "\n".join([again, *map(str, result.violations)])


def test_a_seed_is_the_same_scenario_each_time() -> None:
    """What one seed found can be looked at again."""
    assert scenario(7) == scenario(7)
    assert run(7) == run(7)


def test_the_scenarios_are_worth_playing() -> None:
    """Together they drive, on hills both ways, loaded and empty, with every kind of fault."""
    plans = [scenario(seed) for seed in range(1, 301)]
    assert {plan.build.stop_mode for plan in plans} == {"brakes", "coasts", "parks"}
    assert min(plan.slope_deg for plan in plans) < -15 < 15 < max(plan.slope_deg for plan in plans)
    assert len({name for plan in plans for name in plan.disturbances}) >= 18
    assert sum(plan.is_undisturbed for plan in plans) > 50
    assert sum(run(seed).driven_m for seed in range(1, 7)) > 20

"""Behaviour that is frozen stays as it is; all of it is tried by ``python -m tests.system.scenarios --frozen``."""

import pytest

from tests.system.scenarios import early_stops, frozen
from tests.system.scenarios.deaths import DEATHS

BY_DAY = (*frozen.NAMES[: frozen.SEEDS : 50], *list(DEATHS)[::13])


@pytest.fixture(scope="module", name="rows")
def read_rows() -> dict[str, str]:
    return frozen.frozen()


def test_the_plans_are_the_frozen_ones(rows: dict[str, str]) -> None:
    """The generator must not change, or no hash proves anything."""
    assert list(rows) == list(frozen.NAMES)
    assert [name for name in rows if frozen.hash_of_plan(frozen.plan_of(name)) != rows[name].split()[1]] == []


@pytest.mark.parametrize("name", BY_DAY)
def test_the_same_frames_and_samples_as_when_it_was_frozen(name: str, rows: dict[str, str]) -> None:
    assert frozen.difference(frozen.row_of(name), rows[name]) == ""


@pytest.mark.parametrize("name", early_stops.SITUATIONS)
def test_the_early_stop_sends_the_same_bytes(name: str) -> None:
    assert early_stops.told(name) in early_stops.FILE.read_text(encoding="utf-8")

"""Matrices of tests: by day some of their rows, all of them in ``make nightly`` (see ``tests/conftest.py``)."""

from collections.abc import Sequence
from itertools import combinations, product
from typing import Any

import pytest


def by_night(*values: Any) -> Any:  # noqa: ANN401 - whatever a test is given, and what pytest makes of it
    """A row that runs by night only."""
    return pytest.param(*values, marks=pytest.mark.night)


def seeds(by_day: int, in_all: int) -> list[Any]:
    """So many seeds; by day the first few."""
    return [seed if seed < by_day else by_night(seed) for seed in range(in_all)]


def some_by_day(values: Sequence[Any], step: int) -> list[Any]:
    """All values; by day every ``step``-th."""
    return [by_night(value) if number % step else value for number, value in enumerate(values)]


def every_value(*factors: Sequence[Any]) -> list[Any]:
    """Every combination of these values; by day as few as cover each value."""
    return _covering(1, factors)


def every_pair(*factors: Sequence[Any]) -> list[Any]:
    """Every combination of these values; by day as few as cover each pair of values."""
    return _covering(2, factors)


def _covering(strength: int, factors: Sequence[Sequence[Any]]) -> list[Any]:
    rows = list(product(*map(range, map(len, factors))))
    missing = {part for row in rows for part in _parts(row, strength)}
    by_day = set()
    while missing:
        best = max(rows, key=lambda row: len(missing & _parts(row, strength)))
        by_day.add(best)
        missing -= _parts(best, strength)
    return [
        values if row in by_day else by_night(*values) for row, values in zip(rows, product(*factors), strict=True)
    ]


def _parts(row: tuple[int, ...], strength: int) -> set[tuple[tuple[int, int], ...]]:
    """Every ``strength`` factors of a row with their values, such as ``((0, 2), (1, 0))``."""
    return set(combinations(enumerate(row), strength))

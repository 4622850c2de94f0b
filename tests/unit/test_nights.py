"""What is left for the night."""

from itertools import combinations, product

import pytest

from tests.support.nights import by_night, every_pair, every_value


def is_by_day(row: object) -> bool:
    """It is not marked."""
    return not getattr(row, "marks", ())


def test_by_day_each_two_values_are_tried_together() -> None:
    """And by night every combination."""
    factors = (range(6), "ab", (0.0, 0.3, 1.0), (True, False))
    rows = every_pair(*factors)
    assert [tuple(getattr(row, "values", row)) for row in rows] == list(product(*factors))
    by_day = [row for row in rows if is_by_day(row)]
    assert len(by_day) <= 24
    for first, second in combinations(range(4), 2):
        tried = {(row[first], row[second]) for row in by_day}
        assert tried == set(product(factors[first], factors[second]))


def test_by_day_each_value_is_tried() -> None:
    """In as few rows as the longest factor has values, and by night every combination."""
    factors = (range(4), "ab", (True, False))
    rows = every_value(*factors)
    assert [tuple(getattr(row, "values", row)) for row in rows] == list(product(*factors))
    by_day = [row for row in rows if is_by_day(row)]
    assert len(by_day) == 4
    assert [set(tried) for tried in zip(*by_day, strict=True)] == [set(factor) for factor in factors]


@pytest.mark.parametrize("row", [1, by_night(2)])
def test_a_row_of_the_night_is_left_out_by_day(row: int, pytestconfig: pytest.Config) -> None:
    """See tests/conftest.py."""
    assert row == 1 or pytestconfig.getoption("--hypothesis-profile") == "nightly"

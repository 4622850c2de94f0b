"""The time as far as it is proven."""

from __future__ import annotations

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from gateway.authority.robot_authority import Kept, TimeFloor
from tests.support.authority import S


def test_time_counts_on_from_the_floor() -> None:
    """By the time since the machine's start."""
    floor = TimeFloor(1000, 5 * S)
    assert floor.least_s(5 * S) == 1000
    assert floor.least_s(9 * S) == 1004


def test_a_clock_that_is_set_back_revives_nothing_and_one_set_forward_only_ends_things() -> None:
    """The later of both counts, each time."""
    floor = TimeFloor(1000, 0)
    assert floor.now_s(7 * S, wall_s=0) == 1007
    assert floor.now_s(7 * S, wall_s=5000) == 5000
    assert floor.now_s(8 * S, wall_s=0) == 1008


def test_a_statement_lifts_the_floor_and_an_older_one_does_not_lower_it() -> None:
    """The newest statement counts."""
    floor = TimeFloor(1000, 0)
    floor.lift(2000, 10 * S)
    assert floor.least_s(11 * S) == 2001
    floor.lift(1500, 12 * S)
    assert floor.least_s(12 * S) == 2002


@given(st.lists(st.tuples(st.integers(0, 100), st.integers(0, 5000), st.integers(0, 5000)), max_size=20))
def test_it_never_falls_while_the_machine_runs(steps: list[tuple[int, int, int]]) -> None:
    """Whatever was stated, and whatever the wall clock says."""
    floor, boot_ns, before_s = TimeFloor(1000, 0), 0, 0
    for elapsed_s, stated_s, wall_s in steps:
        boot_ns += elapsed_s * S
        floor.lift(stated_s, boot_ns)
        assert floor.now_s(boot_ns, wall_s) >= floor.least_s(boot_ns) >= before_s
        before_s = floor.least_s(boot_ns)


def test_a_new_authority_may_lower_it() -> None:
    """And nothing else does: what it says is counted on from then."""
    floor = TimeFloor(5000, 0)
    floor.restart(1000, 3 * S)
    assert floor.least_s(4 * S) == 1001


def test_a_note_of_before_is_read_without_the_word_of_sites() -> None:
    """The floor is the authority's; of the silence nothing is asked."""
    note = (
        b'{"floor_s": 4000, "silent_on_s": 5, "words": [{"witness": {"revocable": [], "epoch": 0}, "at_s": 9000}]}'
    )
    assert msgspec.json.decode(note, type=Kept).floor_s == 4000

"""What is alike is told once."""

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.review.entries import LATE_NS, NAMES_MAX, SPELL_NS, SPELLS_MAX, Entry, EntryKind, Spells
from tests.support.reading import entry


def refusal(time_ns: int, count: int = 1) -> Entry:
    """An entry whose text is its time."""
    return entry(EntryKind.REFUSAL, time_ns, str(time_ns), count=count)


@given(times=st.lists(st.integers(0, 100), min_size=1, max_size=50))
def test_nothing_is_lost_in_whatever_order_it_comes(times: list[int]) -> None:
    """The counts add up, and each spell reaches from its first to its last."""
    spells = Spells()
    step_ns = SPELL_NS // 2
    for time in times:
        spells.add("key", refusal(time * step_ns), time * step_ns)
    told = spells.take()
    assert sum(one.count for one in told) == len(times)
    assert min(one.time_ns for one in told) == min(times) * step_ns
    assert max(one.last_ns for one in told) == max(times) * step_ns


def test_a_spell_has_the_text_of_its_last() -> None:
    """Also where an earlier one comes later."""
    spells = Spells()
    for time_ns in (10, 30, 20):
        spells.add("key", refusal(time_ns), time_ns)
    (told,) = spells.take()
    assert (told.time_ns, told.last_ns, told.count, told.text) == (10, 30, 3, "30")


def test_a_spell_names_all_that_it_is_about() -> None:
    """Each once, in the order in which they came; one alone is not counted."""
    spells = Spells()
    for time_ns, about in ((0, ["a"]), (1, ["b", "a"]), (2, ["c"])):
        spells.add("many", refusal(time_ns), time_ns, about)
    spells.add("one", refusal(7), 7, ["a"])
    assert [one.text for one in spells.take()] == ["3 frames (a, b, c): 2", "a: 7"]


def test_names_without_end_take_no_memory_without_end() -> None:
    """A log of others may name anything."""
    spells = Spells()
    for number in range(10 * NAMES_MAX):
        spells.add("key", refusal(0), 0, [f"<{number}>"])
    (told,) = spells.take()
    assert told.text.startswith(f"at least {NAMES_MAX} frames (<0>, <1>,")
    assert told.text.count("<") == NAMES_MAX
    assert told.count == 10 * NAMES_MAX


def test_a_spell_is_told_when_nothing_comes_any_more() -> None:
    """Not sooner: what is late may belong to it."""
    spells = Spells()
    spells.add("key", refusal(0, count=5), 0)
    spells.add("key", refusal(0, count=3), 0)
    assert spells.take(LATE_NS) == []
    assert [one.count for one in spells.take(LATE_NS + 1)] == [8]
    assert spells.take() == []


def test_other_keys_are_other_spells() -> None:
    """However near in time."""
    spells = Spells()
    for key in ("one", "two"):
        spells.add(key, refusal(0), 0)
    assert len(spells.take()) == 2


def test_keys_without_end_take_no_memory_without_end() -> None:
    """The oldest is told when there is no room."""
    spells = Spells()
    for number in range(SPELLS_MAX + 5):
        spells.add(number, msgspec.structs.replace(refusal(0), text=str(number)), 0)
    assert [one.text for one in spells.take(0)] == [str(number) for number in range(5)]

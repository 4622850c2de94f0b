"""Journals as they come over a network: in order, without gaps, from the past or not."""

from collections.abc import Sequence

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.shadow.journal_feed import ANSWER_NS, RESTARTED, TRIES, JournalFeed
from schemas.decisions import Journal
from schemas.subjects import KEPT_PIECE

COUNT = 5


def journal(sequence: int, run: int = 1) -> Journal:
    """A journal of some inputs, none of which is looked at."""
    return Journal(
        time_ns=sequence, sequence=sequence, run=run, first=sequence * COUNT, count=COUNT, inputs=b"\x90"
    )


def drained(feed: JournalFeed) -> list[int]:
    """The sequences of the journals that come out now."""
    return [one.sequence for one in iter(feed.next, None)]


def fed(feed: JournalFeed, sequences: Sequence[int], run: int = 1) -> list[int]:
    """The sequences that come out of what comes by itself."""
    for sequence in sequences:
        feed.receive(journal(sequence, run), is_reply=False)
    return drained(feed)


def test_it_begins_with_what_comes_first() -> None:
    """What came before is not asked for, and what comes twice is given once."""
    feed = JournalFeed(from_start=False)
    assert fed(feed, [7, 8, 8, 7, 9]) == [7, 8, 9]
    assert feed.query(0) is None
    assert not feed.ended


def test_a_gap_ends_a_part_and_the_next_one_begins_behind_it() -> None:
    """It is named by the inputs that are missing."""
    feed = JournalFeed(from_start=False)
    assert fed(feed, [7, 8, 11, 12]) == [7, 8]
    assert feed.ended == "inputs 45 to 54 are missing"
    assert drained(feed) == []
    feed.begin_part()
    assert drained(feed) == [11, 12]


def test_another_run_ends_a_part_and_none_of_it_is_lost() -> None:
    """Also where both come in one go."""
    feed = JournalFeed(from_start=False)
    assert fed(feed, [7, 8]) == [7, 8]
    assert fed(feed, [0, 1, 2], run=2) == []
    assert (feed.ended, feed.run) == (RESTARTED, 1)
    feed.begin_part()
    assert drained(feed) == [0, 1, 2]
    assert feed.run == 2


def fetch(feed: JournalFeed, kept: Sequence[int], live: int, *, run: int = 1) -> list[int]:
    """What comes out while a gateway answers with what it keeps, up to what came by itself."""
    found = drained(feed)
    for time_ns in range(10_000):
        asked = feed.query(time_ns)
        if asked is None:
            break
        for sequence in [one for one in kept if asked <= one <= live][:KEPT_PIECE]:
            feed.receive(journal(sequence, run), is_reply=True)
        found += drained(feed)
    return found


@given(oldest=st.integers(0, 40), newest=st.integers(40, 120), more=st.integers(1, 5))
def test_the_past_comes_whole_and_goes_over_into_the_present(oldest: int, newest: int, more: int) -> None:
    """From the oldest that is kept, in pieces; then nothing more is asked for."""
    feed = JournalFeed(from_start=True)
    live = range(newest, newest + more)
    assert fed(feed, live) in ([], list(live))
    found = fetch(feed, range(oldest, newest + more), newest + more) if newest else []
    assert found == list(range(oldest, newest + more))
    assert feed.query(ANSWER_NS) is None
    assert fed(feed, [newest + more]) == [newest + more]
    assert not feed.ended


def test_a_gateway_that_keeps_nothing_is_given_up() -> None:
    """Then the present is enough."""
    feed = JournalFeed(from_start=True)
    assert fed(feed, [7]) == []
    asked = [feed.query(tick * ANSWER_NS) for tick in range(TRIES)]
    assert asked == [0] * TRIES
    assert feed.query(TRIES * ANSWER_NS) is None
    assert fed(feed, [8]) == [7, 8]


def test_a_new_run_is_fetched_from_its_start_too() -> None:
    """Replies that are still of the former run are left out."""
    feed = JournalFeed(from_start=True)
    assert fed(feed, [0, 1]) == [0, 1]
    assert fed(feed, [3], run=2) == []
    feed.begin_part()
    assert drained(feed) == []
    feed.receive(journal(0), is_reply=True)
    assert drained(feed) == []
    assert fetch(feed, range(4), 3, run=2) == [0, 1, 2, 3]


def test_an_empty_journal_is_nothing() -> None:
    """It has no place in the order."""
    feed = JournalFeed(from_start=False)
    feed.receive(msgspec.structs.replace(journal(3), count=0), is_reply=False)
    assert feed.next() is None
    assert feed.run is None

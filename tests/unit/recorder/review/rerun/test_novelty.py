"""The order of minutes by what is rare in them."""

from collections import Counter

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.review.rerun.novelty import by_novelty, happenings
from schemas.decisions import Bound, Verdict
from schemas.reasons import Reason
from tests.support.messages import gear, refusal

MINUTES = st.lists(st.frozensets(st.sampled_from(["stop", "refusal", "reset", "light"])), max_size=30)


@given(MINUTES)
def test_the_rarest_comes_first_and_one_of_each_before_the_second(minutes: list[frozenset[str]]) -> None:
    """Every minute once, and each round in the order of rarity; minutes in which nothing happened last."""
    order = by_novelty(minutes)
    assert sorted(one.minute for one in order) == list(range(len(minutes)))
    counts = Counter(thing for minute in minutes for thing in minute)
    for one in order:
        assert one.minutes == min((counts[thing] for thing in minutes[one.minute]), default=0)
    first = list(dict.fromkeys(one.rarest for one in order if one.rarest))
    assert [one.rarest for one in order[: len(first)]] == first
    assert [counts[thing] for thing in first] == sorted(counts[thing] for thing in first)
    empty = sum(not minute for minute in minutes)
    assert all(not one.rarest for one in order[len(order) - empty :])


def test_what_happens_has_a_name_that_alike_things_share() -> None:
    """A refusal by its reason, a bound command by its limit; a drive that was carried out is nothing."""
    decision = refusal(0)
    assert list(happenings(decision)) == [f"{decision.request} refused: {decision.reason.value}"]
    drive = msgspec.structs.replace(decision, request="drive", verdict=Verdict.ACCEPTED, reason=Reason.NONE)
    assert list(happenings(drive)) == []
    bound = msgspec.structs.replace(drive, bound_by=[Bound.SPEED, Bound.ACCELERATION])
    assert list(happenings(bound)) == ["drive bound by speed", f"drive bound by {Bound.ACCELERATION.value}"]
    assert list(happenings(msgspec.structs.replace(drive, request="park"))) == ["park"]
    assert list(happenings(gear(0))) == []

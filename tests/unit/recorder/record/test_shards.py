"""Which robots a recorder records where several share a fleet."""

from collections import Counter
from hashlib import blake2b

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.record.shards import OVERLAP_NS, ROBOTS_MAX, SILENT_NS, START_NS, Shard, Shards, preference, shard_of
from schemas.exit_codes import CommandError, ExitCode
from tests.support.messages import SECOND

ROBOTS = [f"cruiser-{number}" for number in range(200)]
TOTAL = 4


def fleet(now_ns: int = 0, robots: list[str] = ROBOTS) -> dict[int, Shards]:
    """Four recorders that see each other and all robots."""
    shards = {number: Shards(Shard(number, TOTAL), now_ns) for number in range(1, TOTAL + 1)}
    for one in shards.values():
        for robot in robots:
            one.meet(robot)
        for number in shards:
            one.see(number, f"depot-{number}", is_there=True, now_ns=now_ns)
    return shards


def lose(shards: dict[int, Shards], number: int, now_ns: int) -> None:
    """Take a recorder away, and have the others see it."""
    del shards[number]
    for one in shards.values():
        one.see(number, f"depot-{number}", is_there=False, now_ns=now_ns)


def test_each_robot_is_recorded_once() -> None:
    """As long as all see the same, no robot is recorded twice, and none by nobody; each has its share."""
    parts = [one.recorded(10 * SECOND) for one in fleet().values()]
    counted = Counter(robot for part in parts for robot in part)
    assert counted == Counter(ROBOTS)
    assert all(30 <= len(part) <= 70 for part in parts)


def test_the_order_is_the_documented_one() -> None:
    """Others may reckon it: by the digest of number and name, the greatest first."""
    digests = {number: blake2b(f"{number}/cruiser-7".encode(), digest_size=8).hexdigest() for number in (1, 2, 3)}
    assert list(preference("cruiser-7", 3)) == sorted(digests, key=lambda number: digests[number], reverse=True)


@given(st.sets(st.from_regex(r"[a-z0-9-]{1,12}", fullmatch=True), max_size=30), st.integers(1, TOTAL))
def test_when_a_shard_goes_its_robots_move_and_no_others(robots: set[str], gone: int) -> None:
    """Each of them to exactly one of the others, once the shard has been silent for long enough."""
    shards = fleet(robots=sorted(robots))
    before = {number: one.recorded(SECOND) for number, one in shards.items()}
    lose(shards, gone, SECOND)
    early = {number: one.recorded(SECOND + SILENT_NS - 1) for number, one in shards.items()}
    assert early == {number: before[number] for number in shards}
    after = {number: one.recorded(SECOND + SILENT_NS) for number, one in shards.items()}
    assert all(before[number] <= after[number] for number in shards)
    assert Counter(robot for part in after.values() for robot in part) == Counter(robots)


def test_when_a_shard_comes_back_both_record_for_a_while() -> None:
    """The one that had its robots lets go of them only after the overlap."""
    shards = fleet()
    own = shards[2].recorded(SECOND)
    lose(shards, 2, SECOND)
    held = {number: one.recorded(5 * SECOND) for number, one in shards.items()}
    for one in shards.values():
        one.see(2, "depot-2", is_there=True, now_ns=6 * SECOND)
        one.recorded(6 * SECOND)
    last_ns = 6 * SECOND + OVERLAP_NS
    assert {number: one.recorded(last_ns - 1) for number, one in shards.items()} == held
    after = {number: one.recorded(last_ns) for number, one in shards.items()}
    assert all(after[number] == held[number] - own for number in shards)


def test_a_shard_that_comes_back_and_goes_again_leaves_its_robots_here() -> None:
    """The overlap begins anew each time."""
    shards = fleet()
    lose(shards, 2, SECOND)
    held = shards[1].recorded(5 * SECOND)
    shards[1].see(2, "depot-2", is_there=True, now_ns=6 * SECOND)
    shards[1].recorded(6 * SECOND)
    shards[1].see(2, "depot-2", is_there=False, now_ns=7 * SECOND)
    shards[1].recorded(7 * SECOND + SILENT_NS)
    assert shards[1].recorded(20 * SECOND) == held


def test_at_the_start_the_others_are_waited_for() -> None:
    """One that begins alone takes its own robots at once, and those of others that do not come a little later."""
    alone = Shards(Shard(1, TOTAL), 0)
    for robot in ROBOTS:
        alone.meet(robot)
    assert alone.recorded(0) == fleet()[1].recorded(0)
    assert alone.recorded(START_NS - 1) == fleet()[1].recorded(0)
    assert alone.recorded(START_NS) == frozenset(ROBOTS)


def test_one_that_is_cut_off_judges_nobody() -> None:
    """It takes no other's robots, nor at once when the link is back: the tokens take a moment."""
    shards = fleet()
    own = shards[1].recorded(SECOND)
    for number in (2, 3, 4):
        shards[1].see(number, f"depot-{number}", is_there=False, now_ns=SECOND)
    for now_s in range(1, 60):
        shards[1].wait(now_s * SECOND)
        assert shards[1].recorded(now_s * SECOND) == own
    assert shards[1].recorded(59 * SECOND + SILENT_NS - 1) == own
    assert shards[1].recorded(59 * SECOND + SILENT_NS) == frozenset(ROBOTS)


def test_of_two_recorders_of_one_shard_one_may_go() -> None:
    """The shard is there as long as one of them is."""
    shards = fleet()
    own = shards[1].recorded(0)
    shards[1].see(2, "spare", is_there=True, now_ns=0)
    shards[1].see(2, "depot-2", is_there=False, now_ns=SECOND)
    assert shards[1].recorded(60 * SECOND) == own
    assert shards[1].namesakes() == ["depot-1"]
    assert shards[2].namesakes() == ["depot-2"]


@given(st.lists(st.tuples(st.integers(0, 29), st.integers(2, TOTAL), st.booleans()), max_size=40))
def test_whenever_it_is_asked_the_answer_is_the_same(steps: list[tuple[int, int, bool]]) -> None:
    """Robots and shards come and go in between: who was asked all the time knows what somebody new finds."""
    asked, fresh = Shards(Shard(1, TOTAL), 0), Shards(Shard(1, TOTAL), 0)
    now_ns = START_NS
    for robot, number, is_there in steps:
        for one in (asked, fresh):
            one.meet(ROBOTS[robot])
            one.see(number, "depot", is_there=is_there, now_ns=now_ns)
        asked.recorded(now_ns)
        now_ns += SECOND
    now_ns += SILENT_NS
    asked.recorded(now_ns)
    assert asked.recorded(now_ns + OVERLAP_NS) == fresh.recorded(now_ns + OVERLAP_NS)


def test_robots_that_anybody_makes_up_are_bounded() -> None:
    """Beyond the limit none is added, and those that are known stay."""
    one = Shards(Shard(1, 1), 0)
    for number in range(ROBOTS_MAX + 10):
        one.meet(f"made-up-{number}")
    one.see(9, "of-another-division", is_there=True, now_ns=0)
    assert len(one.recorded(0)) == ROBOTS_MAX
    assert one.there(0) == [1]


def test_a_shard_is_read_as_it_is_written() -> None:
    """Number and total, and the chunk of its token's key."""
    assert shard_of("2/4") == Shard(2, 4)
    assert shard_of("2/4").chunk == "2-of-4"


@pytest.mark.parametrize("text", ["5/4", "0/4", "2", "2/", "a/b", "2/4/", "-1/4", "1/1000"])
def test_a_shard_that_is_none_is_refused(text: str) -> None:
    """What is wrong is said, with an example."""
    with pytest.raises(CommandError, match="such as 2/4") as refused:
        shard_of(text)
    assert refused.value.code is ExitCode.USAGE

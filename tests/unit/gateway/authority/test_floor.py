"""The time as far as it is proven."""

from __future__ import annotations

from typing import Any

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.authority.floor import WITNESSES_KEPT, TimeFloor, Witness
from gateway.authority.robot_authority import Kept
from schemas.authority.statement import chain_text
from tests.support.authority import DAY_S, NOW_S, AuthorityBench, Party, S


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


# What is attested, by whom. The rules, in words:
#
# - the authority attests a time by each list, rotation and grant that it signs; a site by each of its grants;
# - from each of them the time goes on while the machine is on; what is unplugged counts no seconds;
# - the floor is the newest of all, but those of sites that the authority has revoked; a restart changes nothing.

SITES = 3

Step = tuple[str, int, int]

steps = st.lists(
    st.one_of(
        st.tuples(st.just("site grants"), st.integers(0, SITES - 1), st.integers(-DAY_S // 2, DAY_S)),
        st.tuples(st.just("revoke"), st.integers(0, SITES - 1), st.integers(-DAY_S // 2, DAY_S)),
        st.tuples(st.just("revoke all below an epoch"), st.just(0), st.integers(-DAY_S // 2, DAY_S)),
        st.tuples(st.just("restart"), st.just(0), st.just(0)),
        st.tuples(st.just("wait"), st.just(0), st.integers(1, DAY_S)),
    ),
    max_size=12,
)


class Attested:
    """A robot without a clock, sites, and what each has attested, kept by the rules above."""

    def __init__(self) -> None:
        self.bench = AuthorityBench()
        self.bench.wall_s = 0
        self.bench.tick(0)
        self.on_s = 0
        self.words: list[tuple[int, int, int]] = []  # who (-1: the authority), when, which time
        self.revoked: set[int] = set()
        self.named: set[int] = set()
        self.serial = self.epoch = self.granted = 0
        self.ends_s = NOW_S + 90 * DAY_S
        self.sites = [self.bench.fleet.site(not_after=self.ends_s) for _ in range(SITES)]
        self.attests(-1, NOW_S - DAY_S)  # the robot's own grant

    def attests(self, who: int, at_s: int) -> None:
        self.words.append((who, self.on_s, at_s))

    @property
    def floor_s(self) -> int:
        return max(at_s + self.on_s - on_s for who, on_s, at_s in self.words if who not in self.revoked)

    def step(self, step: Step) -> None:
        name, who, offset_s = step
        at_s = NOW_S + offset_s
        getattr(self, name.replace(" ", "_"))(who, at_s)
        self.bench.tick(0)

    def site_grants(self, who: int, at_s: int) -> None:
        site, person = self.sites[who], Party("ann")
        self.granted += 1
        site.grant(person, serial=self.granted, not_before=at_s, not_after=self.ends_s)
        now_s = self.floor_s
        accepted = self.bench.show(chain_text(person.chain)).ok
        # One that begins later is none yet: nobody lifts the floor by a grant to come.
        assert accepted == (who not in self.revoked and at_s <= now_s <= self.ends_s)
        if accepted:
            self.attests(who, at_s)

    def revoke(self, who: int, at_s: int) -> None:
        self.revoked.add(who)
        self.named.add(who)
        self._list(at_s)

    def revoke_all_below_an_epoch(self, _who: int, at_s: int) -> None:
        self.revoked |= set(range(SITES))
        self.epoch += 1
        self._list(at_s)

    def restart(self, _who: int, _at_s: int) -> None:
        self.wait(0, NOW_S + 61)
        kept = self.kept
        trust = self.bench.authority.admission.trust
        again = AuthorityBench(self.bench.fleet, kept)
        again.authority.admission.trust = trust
        again.wall_s = 0
        self.on_s += 1  # the tick of its start
        self.bench = again

    def wait(self, _who: int, until_s: int) -> None:
        time_s = max(until_s - NOW_S, 1)
        self.on_s += time_s
        effects = self.bench.tick(time_s * S)
        if effects.kept is not None:
            self.kept = msgspec.json.decode(msgspec.json.encode(effects.kept), type=Kept)

    def _list(self, at_s: int) -> None:
        self.serial += 1
        authority = self.bench.fleet.authority
        named = tuple(self.sites[one].key for one in self.named)
        signed = authority.revoke(self.serial, keys=named, epoch=self.epoch, at=at_s)
        assert self.bench.show(signed.text()).ok
        self.attests(-1, at_s)


@given(steps)
@settings(max_examples=5 * settings().max_examples)
def test_the_floor_is_the_newest_time_that_nobody_attested_who_is_revoked(taken: list[Step]) -> None:
    """Whatever is stated, granted and revoked, in whatever order, and however often the robot is restarted."""
    robot = Attested()
    for step in taken:
        robot.step(step)
        assert robot.bench.authority._floor.least_s(robot.bench.now_ns) == robot.floor_s


def test_of_too_many_sites_those_that_stated_the_latest_times_count() -> None:
    """The floor is the same as if all were kept, until one of them is revoked."""
    floor = TimeFloor(1000, 0)
    for number in range(WITNESSES_KEPT + 5):
        floor.lift(2000 - number, 0, Witness((f"{number:016x}",), 0))
    assert floor.least_s(0) == 2000
    assert len(floor.kept(0)[1]) == WITNESSES_KEPT


def test_a_site_says_nothing_by_an_earlier_time() -> None:
    """Neither against another's word, nor against its own of before."""
    floor, site = TimeFloor(1000, 0), Witness(("0" * 16,), 0)
    floor.lift(3000, 0, site)
    floor.lift(2000, 5 * S, site)
    floor.lift(2500, 5 * S)
    assert floor.least_s(6 * S) == 3006
    assert floor.kept(6 * S) == (2501, floor.kept(6 * S)[1])


def test_a_note_of_before_holds_the_authoritys_word() -> None:
    """It did not say who attested its floor."""
    kept: Any = msgspec.json.decode(b'{"floor_s": 4000, "silent_on_s": 5}', type=Kept)
    assert TimeFloor(kept.floor_s, 0, kept.words).kept(0) == (4000, [])
    assert kept.newest_s == 4000

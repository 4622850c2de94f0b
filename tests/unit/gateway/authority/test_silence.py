"""The time since the last word of the authority, across restarts, by clocks that are right and wrong."""

from __future__ import annotations

from typing import Final

import msgspec
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.authority.robot_authority import Kept
from schemas.authority.statement import GrantRole, TimeStatement
from schemas.reasons import Reason
from tests.support.authority import CHALLENGE, DAY_S, NOW_S, AuthorityBench, Fleet, S

HOUR_S = 3600

MAX_S = 24 * HOUR_S

# The rules, of which the test below keeps account by itself:
# - an answer to the robot's challenge is a word of now, a newer list of revocations one of when it was signed;
# - whatever a clock says: who was on for longer than the bound since the last word is barred, restarts or not;
# - in the run that heard the word it is barred no earlier than that;
# - by clocks that were right ever since it is barred exactly when the bound is over, time off included;
# - clocks that stand, or are behind, bar nobody early: they hide time off, and the age of a list kept back.
# A robot that never heard a word counts from its first start.

CLOCKS: Final = {"right": 0, "behind": -5 * DAY_S, "ahead": 3 * DAY_S, "none": None}

Step = tuple[str, int, str]

steps = st.lists(
    st.tuples(
        st.sampled_from(["word", "list", "on", "gateway restarts", "machine restarts"]),
        st.integers(0, 30 * HOUR_S),
        st.sampled_from(sorted(CLOCKS)),
    ),
    max_size=12,
)


class Robot:
    """A robot through restarts, what the time really is, and what follows from the rules."""

    def __init__(self, clock: str, boot_s: int = 10) -> None:
        self.time_s = self.since_s = NOW_S
        self.fleet = Fleet()
        self.clock, self.clocks = clock, {clock}
        self.on_s = 0  # since the last word
        self.in_run = True  # it is of this run, or the run is the robot's first
        self.was_word = False
        self.serial = 0
        self.start(boot_s, Kept())

    def start(self, boot_s: int, kept: Kept) -> None:
        self.bench = AuthorityBench(self.fleet, kept, boot_ns=boot_s * S, wall_s=self.wall_s)
        own = {"role": GrantRole.ROBOT, "robots": ["cruiser-1"], "not_after": NOW_S + 999 * DAY_S}
        self.bench.robot.chain.clear()
        self.bench.robot.chain += self.fleet.authority.grant(self.bench.robot, **own)
        self.pass_time(1)  # the bench's own first tick

    @property
    def wall_s(self) -> int:
        offset_s = CLOCKS[self.clock]
        return 0 if offset_s is None else self.time_s + offset_s

    def pass_time(self, time_s: int) -> None:
        self.time_s += time_s
        self.on_s += time_s

    def tick(self, time_s: int) -> None:
        self.pass_time(time_s)
        self.bench.wall_s = self.wall_s
        self.bench.tick(time_s * S)

    def word(self, _time_s: int) -> None:
        said = TimeStatement(challenge=CHALLENGE.hex(), at=self.time_s)
        assert self.bench.show(self.fleet.authority.sign(said).text()).ok
        self.since_s, self.on_s, self.in_run, self.was_word, self.clocks = self.time_s, 0, True, True, {self.clock}
        self.tick(1)

    def list(self, age_s: int) -> None:
        """A newer list, which was signed so long ago."""
        self.serial += 1
        at_s = self.time_s - age_s
        assert self.bench.show(self.fleet.authority.revoke(self.serial, at=at_s).text()).ok
        if at_s > self.since_s:
            # By a clock that was behind, the robot knows too little of the age.
            self.on_s = min(self.on_s, age_s) if self.clocks == {"right"} else 0
            self.since_s, self.in_run, self.was_word = at_s, False, True
        elif self.clocks & {"behind", "none"}:
            # It may seem younger than the last word.
            self.on_s, self.in_run = 0, False
        self.tick(1)

    def on(self, time_s: int) -> None:
        self.tick(time_s)

    def gateway_restarts(self, off_s: int) -> None:
        self._restart(off_s, self.bench.now_ns // S + off_s)

    def machine_restarts(self, off_s: int) -> None:
        self._restart(off_s, 10)

    def _restart(self, off_s: int, boot_s: int) -> None:
        text = msgspec.json.encode(self.bench.authority.to_keep(self.bench.now_ns))
        self.time_s += off_s
        self.in_run = False
        self.start(boot_s, msgspec.json.decode(text, type=Kept))

    def step(self, step: Step) -> None:
        name, time_s, clock = step
        self.clock = clock
        self.clocks.add(clock)
        getattr(self, name.replace(" ", "_"))(time_s)

    @property
    def is_barred(self) -> bool:
        self.tick(1)
        return Reason.AUTHORITY_STALE in self.bench.bars()


@example([("on", 20 * HOUR_S, "none"), ("machine restarts", 4 * HOUR_S, "none")] * 20)  # booted each day
@example([("on", 30 * HOUR_S, "right"), ("word", 0, "right"), ("gateway restarts", 60, "right")])
@example([("word", 0, "none"), ("on", 20 * HOUR_S, "ahead"), ("machine restarts", 60, "behind")])
@example([("word", 0, "right"), ("on", 20 * HOUR_S, "right"), ("machine restarts", 10 * HOUR_S, "right")])
@example([("word", 0, "behind"), ("machine restarts", 60, "right")])
@example([("list", 23 * HOUR_S, "right"), ("on", 2 * HOUR_S, "right"), ("machine restarts", 60, "right")])
@example([("on", 30 * HOUR_S, "right"), ("list", 29 * HOUR_S, "right"), ("list", HOUR_S, "right")])
@example([("on", 0, "ahead"), ("on", 65873, "behind"), ("list", 65878, "ahead"), ("on", 20518, "ahead")])
@example([("on", 30_000, "right"), ("list", 30_000, "behind"), ("gateway restarts", 30_000, "right")])
@given(steps)
@settings(max_examples=5 * settings().max_examples)
def test_silence_is_noticed_and_only_silence(taken: list[Step]) -> None:
    """Whatever is heard when, however often gateway and machine are restarted, and whatever the clock says."""
    robot = Robot(taken[0][2] if taken else "right")
    for step in taken:
        robot.step(step)
        barred = robot.is_barred
        robot.pass_time(1)  # the bench's tick of its bars
        silent_s = robot.time_s - robot.since_s
        if robot.on_s > MAX_S:
            assert barred
        elif robot.in_run:
            assert not barred
        if robot.clocks == {"right"}:
            assert barred == (silent_s > MAX_S)
        elif robot.was_word and "ahead" not in robot.clocks and silent_s <= MAX_S:
            assert not barred


def test_lists_that_were_kept_back_end_no_silence() -> None:
    """One an hour, each a day old, by whatever clock: only what was signed lately is a word."""
    for clock in sorted(CLOCKS):
        robot = Robot(clock)
        robot.word(0)
        kept_back = [robot.time_s + hour * HOUR_S for hour in range(20)]
        for at_s in kept_back:
            robot.on(HOUR_S)
            robot.list(robot.time_s - at_s)
        robot.on(25 * HOUR_S)
        assert robot.is_barred
        for at_s in (kept_back[-1] + 1, kept_back[-1] + 2):
            robot.list(robot.time_s - at_s)
            assert robot.is_barred
        robot.word(0)
        assert not robot.is_barred


def test_a_robot_that_is_booted_each_day_notices_that_nobody_says_a_word() -> None:
    """Twenty hours on, four off: at the latest on the second day, also by a clock that stands still."""
    for clock in sorted(CLOCKS):
        robot = Robot(clock)
        robot.on(20 * HOUR_S)
        assert not robot.is_barred
        robot.machine_restarts(4 * HOUR_S)
        robot.on(5 * HOUR_S)
        assert robot.is_barred
        robot.word(0)
        assert not robot.is_barred


def test_a_gateway_that_starts_again_remembers_the_word_of_a_minute_before() -> None:
    """However long the machine is on; the first gateway ever on such a machine counts from its start."""
    robot = Robot("right", boot_s=30 * HOUR_S)
    assert not robot.is_barred
    robot.on(30 * HOUR_S)
    assert robot.is_barred
    robot.word(0)
    robot.gateway_restarts(60)
    assert not robot.is_barred


def test_a_robot_that_was_off_for_long_is_barred_by_its_clock_and_says_since_when() -> None:
    """Until the next word."""
    robot = Robot("right")
    robot.word(0)
    robot.machine_restarts(50 * HOUR_S)
    assert robot.bench.bars() == {Reason.AUTHORITY_STALE: "none for 50.0 h (authority.max_offline_h)"}
    robot.word(0)
    assert robot.bench.bars() == {}


def test_a_note_of_before_counts_from_the_next_start() -> None:
    """It did not say when the authority was heard."""
    kept = msgspec.json.decode(b'{"floor_s": 4000}', type=Kept)
    assert AuthorityBench(kept=kept, boot_ns=30 * HOUR_S * S).bars() == {}


def test_a_run_that_ends_before_its_first_tick_dates_nothing() -> None:
    """It does not know the time yet."""
    bench = AuthorityBench()
    bench.authority._kept, bench.authority.admission.now_s = Kept(), 0
    kept = bench.authority.to_keep(bench.now_ns)
    assert (kept.silent_on_s, kept.silent_since_s) == (0, None)


def test_an_answer_must_be_of_this_start_where_the_settings_ask_for_one() -> None:
    """One of a minute before the restart is none, nor is a list, which may have been kept back."""
    bench = AuthorityBench(require_fresh=True)
    said = TimeStatement(challenge=CHALLENGE.hex(), at=NOW_S)
    assert bench.show(bench.fleet.authority.sign(said).text()).ok
    assert bench.bars() == {}
    kept = bench.authority.to_keep(bench.now_ns)
    again = AuthorityBench(bench.fleet, kept, require_fresh=True)
    assert again.bars().keys() == {Reason.AUTHORITY_STALE}
    assert again.show(bench.fleet.authority.revoke(1, at=NOW_S + HOUR_S).text()).ok
    assert again.bars().keys() == {Reason.AUTHORITY_STALE}

"""Clocks, faults of two healths, stops, alike entries, repeats and holes."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.review import entries
from recorder.review.entries import (
    FAR_NS,
    IDS_KEPT,
    LATE_NS,
    NAMES_MAX,
    NEAR_NS,
    PIECES_MAX,
    SPELL_NS,
    SPELLS_MAX,
    Entry,
    EntryKind,
    Repeats,
    RobotClock,
    Sequences,
    Spells,
    Stops,
    risen,
)
from schemas.decisions import GUARD_STOP_ENDED, RUN_TICKS, Severity
from schemas.messages import ControllerState, FrameHealth, GatewayHealth, Variant
from schemas.reasons import Reason
from schemas.settings import TICK_NS
from tests.support.messages import HEALTH, MS, SECOND, WALL_NS
from tests.support.reading import entry

TICK = 10**9
HOUR_NS = 3600 * SECOND


# The robot's clock.


def run(clock: RobotClock, ticks: range, ahead_ns: int = 0, delay_ns: int = MS) -> list[str]:
    """States of a robot whose clock is ahead by so much, received so much later."""
    said = []
    for tick in ticks:
        now_ns = WALL_NS + tick * TICK_NS
        said.append(clock.hear(TICK + tick, now_ns + ahead_ns, now_ns + delay_ns))
    return [text for text in said if text]


LATER = range(2 * RUN_TICKS, 2 * RUN_TICKS + 1)
CLOCKS: list[tuple[list[tuple[range, int, int]], list[str], int]] = [
    ([(range(0, 100, 5), 0, MS)], [], 0),
    # What stood in a queue is no clock that is behind.
    ([(range(0, 10, 5), 0, 3 * SECOND), (range(10, 100, 5), 0, MS)], [], 0),
    # A state that is received sooner proves the offset wrong, however long all was late before.
    ([(range(0, 400, 5), 0, 2 * SECOND), (range(400, 405, 5), 0, MS)], ["2.0 s behind", "agrees with"], 0),
    # Nothing is received before it is said: one state shows that a clock is ahead, the earliest by how much.
    (
        [(range(0, 5, 5), 5 * SECOND, 3 * SECOND), (range(5, 400, 5), 5 * SECOND, MS)],
        ["2.0 s ahead of", "5.0 s ahead of"],
        MS - 5 * SECOND,
    ),
    # It was set in a long pause; the ticks are too far apart to tell.
    ([(range(0, 400, 5), 0, MS), (range(2000, 2005, 5), -HOUR_NS, MS)], ["3600.0 s behind"], HOUR_NS + MS),
    # One that is off by more than any delay is so at once.
    ([(range(1), -FAR_NS - SECOND, MS)], ["61.0 s behind"], FAR_NS + SECOND + MS),
    # Another run may have another clock, and its ticks say nothing of those before.
    ([(range(0, 100, 5), 0, MS), (LATER, -HOUR_NS, MS)], ["behind"], HOUR_NS + MS),
]


@pytest.mark.parametrize(("heard", "told", "offset_ns"), CLOCKS)
def test_the_robots_clock(heard: list[tuple[range, int, int]], told: list[str], offset_ns: int) -> None:
    """Ticks, how far the clock is ahead, and the delay; what is told, and the offset at the end."""
    clock = RobotClock()
    said = [text for ticks, ahead_ns, delay_ns in heard for text in run(clock, ticks, ahead_ns, delay_ns)]
    assert [words in text for words, text in zip(told, said, strict=True)] == [True] * len(told)
    assert clock.offset_ns == offset_ns


@given(said=st.lists(st.tuples(st.integers(1, 800), st.integers(-(10**11), 10**11), st.integers(0, 10**10))))
def test_nothing_is_placed_behind_its_receipt(said: list[tuple[int, int, int]]) -> None:
    clock = RobotClock()
    tick, log_ns = TICK, WALL_NS
    for ticks, off_ns, later_ns in said:
        tick, log_ns = tick + ticks, log_ns + later_ns
        clock.hear(tick, log_ns - off_ns, log_ns)
        assert clock.place(log_ns - off_ns, log_ns, tick) <= log_ns
        assert clock.place(log_ns - off_ns, log_ns) <= log_ns


@given(set_ns=st.integers(-(10**14), 10**14).filter(lambda ns: abs(ns) > NEAR_NS + MS))
def test_a_clock_that_is_set_is_seen_by_the_ticks(set_ns: int) -> None:
    clock = RobotClock()
    run(clock, range(0, 100, 5))
    now_ns = WALL_NS + 100 * TICK_NS
    assert abs(clock.place(now_ns + set_ns, now_ns + MS, TICK + 100) - now_ns) <= MS
    assert run(clock, range(100, 105, 5), set_ns) == [f"the robot's clock was set by {set_ns / 1e9:+.1f} s"]
    assert abs(clock.place(now_ns + set_ns, now_ns + MS) - now_ns) <= MS


# Faults.

FRAME = msgspec.structs.replace(HEALTH.feedback[0], valid=50)
WELL = msgspec.structs.replace(HEALTH, faults={}, feedback=[FRAME])
NAMES = ("Auto_GearFeedBack", "Auto_DriveFeedBack")


def health(**changes: object) -> GatewayHealth:
    return msgspec.structs.replace(WELL, **changes)


def frame(**changes: object) -> list[FrameHealth]:
    return [msgspec.structs.replace(FRAME, **changes)]


def frames(**changes: object) -> list[FrameHealth]:
    return [msgspec.structs.replace(FRAME, name=name, **changes) for name in NAMES]


FAILING = frame(failures=["checksum"], checksum_faults=7)
ILL = health(faults={"checksum": 7}, feedback=FAILING, bus_losses=3, bus_up=False)
SILENT = health(feedback=frames(failures=["silence"]), faults={"silence": 2})

CHECKSUMS = "warning 3x this: wrong checksum"
CONTROLLER = "the CAN controller changed"
NO_BUS = "error 1x: the CAN bus can0 is down"

HEALTHS: list[tuple[GatewayHealth | None, GatewayHealth, list[str]]] = [
    (ILL, ILL, []),
    (None, WELL, []),
    (WELL, health(faults={"period": 5}), ["warning 5x: frame at a wrong interval"]),
    (WELL, health(feedback=frame(checksum_faults=3)), [CHECKSUMS]),
    (WELL, health(feedback=frame(failures=["silence"])), ["warning 1x this: silent"]),
    (WELL, health(inbox_drops=5), ["warning 5x: request dropped unread: too many arrived"]),
    (WELL, health(bus_up=False, bus_detail="no such device"), [f"{NO_BUS}: no such device"]),
    (WELL, health(controller=ControllerState.PASSIVE), [f"warning 1x: {CONTROLLER} from unknown to passive"]),
    (WELL, health(variant=Variant.FINE), ["over info 1x: the firmware variant changed from coarse to fine"]),
    (health(bus_up=False), WELL, ["over info 1x: the CAN bus can0 is up again"]),
    (health(feedback=frame(failures=["period"])), WELL, ["over info 1x this: recovered (period)"]),
    # Counts of before a log's beginning are none of its.
    (None, ILL, [NO_BUS, "warning 1x this: checksums fail"]),
    # The sum over all frames is left out where a frame tells.
    (
        WELL,
        health(faults={"checksum": 3, "length": 1}, feedback=frame(checksum_faults=3)),
        [CHECKSUMS, "warning 1x: fault of a frame: length"],
    ),
    (health(feedback=frames()), SILENT, ["warning 2x both: silent"]),
    # What was only late is counted once it has come, and so may have been lost long before.
    (
        SILENT,
        health(feedback=frames(lost=50), faults={"silence": 2}),
        ["over info 2x both: recovered (silence)", "over warning 100x both: frame missing"],
    ),
]
ABOUT = {(): "", (FRAME.name,): " this", NAMES: " both"}


@pytest.mark.parametrize(("before", "now", "told"), HEALTHS)
def test_faults_between_two_healths(before: GatewayHealth | None, now: GatewayHealth, told: list[str]) -> None:
    assert [
        f"{'over ' * one.is_end}{one.severity.value} {one.count}x{ABOUT[one.about]}: {one.text}"
        for one in risen(before, now)
    ] == told


# Stops.

KINDS = {
    "engaged": (EntryKind.ENGAGED, Reason.NONE),
    "stopped": (EntryKind.STOPPED, Reason.NONE),
    "reset": (EntryKind.RESET, Reason.NONE),
    "end": (EntryKind.END, Reason.DISENGAGED),
    "deadman": (EntryKind.STOP, Reason.DEADMAN),
    "moving": (EntryKind.STOP, Reason.FOUND_MOVING),
    "bumper": (EntryKind.STOP, Reason.FRONT_BUMPER),
    "takeover": (EntryKind.TAKEOVER, Reason.HAND_TRANSMITTER),
    "guard": (EntryKind.LATCH, Reason.GUARD),
    "latch": (EntryKind.LATCH, Reason.FRONT_BUMPER),
    "died": (EntryKind.GATEWAY, Reason.NONE),
    "watched": (EntryKind.GUARD, Reason.NONE),
    "ended": (EntryKind.GUARD, Reason.GUARD),
}


@pytest.mark.parametrize(
    "happened",
    [
        "engaged end stopped",
        "engaged latch bumper* stopped reset",
        "engaged deadman* engaged deadman*",
        "engaged deadman* bumper stopped",
        "engaged takeover* moving stopped",
        "engaged end bumper* stopped",
        "engaged died* guard died reset engaged",
        "engaged guard* deadman moving stopped",
        "engaged died* guard stopped guard guard",
        "engaged bumper* stopped engaged died*",
        "moving* stopped",
        "watched engaged watched ended",
        # A robot that was moved in between, though never engaged; what the next gateway says of a stop is no news.
        "died* 10.0 moving",
        "died* 10.1 moving*",
        "died* 9000 died",
        "died* 9000 guard",
    ],
)
def test_one_stop_for_each_end_of_being_commanded(happened: str) -> None:
    """These entries, a second apart or as many as stand between; those with a star are stops."""
    counted, time_ns = Stops(), 0
    for word in happened.split():
        if word[0].isdigit():
            time_ns += round((float(word) - 1) * SECOND)
            continue
        time_ns += SECOND
        kind, reason = KINDS[word.rstrip("*")]
        severity = Severity.ERROR if kind is EntryKind.GATEWAY else Severity.WARNING
        text = GUARD_STOP_ENDED if word == "ended" else ""
        marked = counted.mark(entry(kind, time_ns, text, reason=reason, severity=severity))
        assert marked.is_stop is word.endswith("*"), word


# Alike entries, repeats and holes.


def refusal(time_ns: int, count: int = 1) -> Entry:
    return entry(EntryKind.REFUSAL, time_ns, str(time_ns), count=count)


@given(times=st.lists(st.integers(0, 100), min_size=1, max_size=50))
def test_nothing_is_lost_in_whatever_order_it_comes(times: list[int]) -> None:
    spells = Spells()
    step_ns = SPELL_NS // 2
    for time in times:
        spells.add("key", refusal(time * step_ns), time * step_ns)
    told = spells.take()
    assert sum(one.count for one in told) == len(times)
    assert min(one.time_ns for one in told) == min(times) * step_ns
    assert max(one.last_ns for one in told) == max(times) * step_ns


@pytest.mark.parametrize(
    ("added", "told"),
    [
        ([("key", 10, ""), ("key", 30, ""), ("key", 20, "")], ["3x 30"]),
        (
            [("m", 0, "a"), ("m", 1, "b a"), ("m", 2, "c"), ("one", 7, "a")],
            ["3x 3 frames (a, b, c): 2", "1x a: 7"],
        ),
        ([("one", 0, ""), ("two", 0, "")], ["1x 0", "1x 0"]),
    ],
)
def test_alike_entries_are_one(added: list[tuple[str, int, str]], told: list[str]) -> None:
    spells = Spells()
    for key, time_ns, about in added:
        spells.add(key, refusal(time_ns), time_ns, about.split())
    assert spells.take(LATE_NS) == []
    assert [f"{one.count}x {one.text}" for one in spells.take(LATE_NS + 40)] == told


def test_what_has_no_end_takes_no_memory_without_end() -> None:
    spells = Spells()
    for number in range(10 * NAMES_MAX):
        spells.add("key", refusal(0), 0, [f"<{number}>"])
    (told,) = spells.take()
    assert told.text.startswith(f"at least {NAMES_MAX} frames (<0>, <1>,")
    assert (told.text.count("<"), told.count) == (NAMES_MAX, 10 * NAMES_MAX)
    for number in range(SPELLS_MAX + 5):
        spells.add(number, msgspec.structs.replace(refusal(0), text=str(number)), 0)
    assert [one.text for one in spells.take(0)] == [str(number) for number in range(5)]
    sequences = Sequences()
    for sequence in range(0, 2 * PIECES_MAX + 20, 2):
        sequences.add(sequence, sequence)
    assert len(sequences.holes()) == PIECES_MAX + 9
    assert sequences.holes()[0] == entries.SequenceHole(1, 0, 2)
    seen = Repeats()
    assert [seen.is_new(*one) for one in ((1, 1), (1, 2), (1, 1))] == [True, True, False]
    for number in range(IDS_KEPT + 1):
        seen.is_new(number, 0)
    assert (seen.is_new(1, 0), seen.is_new(0, 0)) == (False, True)


@given(there=st.sets(st.integers(0, 60), min_size=1), chance=st.randoms())
def test_holes_are_what_is_missing_between_the_first_and_the_last(there: set[int], chance: object) -> None:
    order = sorted(there) * 2
    chance.shuffle(order)  # type: ignore[attr-defined]
    sequences = Sequences()
    for sequence in order:
        sequences.add(sequence, sequence * 10)
    missing = set(range(min(there), max(there))) - there
    holes = sequences.holes()
    assert sum(hole.count for hole in holes) == len(missing)
    for hole in holes:
        first, last = hole.after_ns // 10 + 1, hole.before_ns // 10 - 1
        assert set(range(first, last + 1)) <= missing
        assert hole.count == last - first + 1

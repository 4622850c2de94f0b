"""The recorder against other writers behind the same subscriber.

All are fed in turns over Zenoh on loopback with what ten driving robots publish, faster than they write, and none
may lose anything. Figures per log record, a raw CAN frame being one: records/s from a full queue once the load has
ended (by the growth of the logs), records/s with the load beside, processor time of the whole process, bytes in
the log. Then robots at their own pace: how many the recorder holds without loss, and its losses at 60 % of that.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from typing import Final

import msgspec

from tests.bench.loads import Row
from tests.bench.recorder_load import TICKS_PER_S, make_script
from tests.bench.recorder_peers import WRITERS, has_foxglove
from tests.bench.recorder_run import OURS, Run, run

ROBOTS: Final = 10
FAST_S: Final = 40  # a round is what these robots publish in this time
HELD_LAG_S: Final = 0.5  # the most by which a receiver may end after the load, and the load be late
SEARCH_RUNS: Final = 7
SEARCH_STEP: Final = 1.3
SUSTAIN_SHARE: Final = 0.6

NAMES: Final = {
    "plain": "mcap Writer, same decoding and transcoding",
    "foxglove": "foxglove-sdk, same decoding and transcoding",
}
FROM_QUEUE: Final = "records/s from a full queue"
GOALS: Final = {"plain": "2 x", "foxglove": "level"}


class Held(msgspec.Struct, frozen=True):
    robots: int
    run: Run


def compare(rounds: int) -> dict[str, list[Run]]:
    receivers = [OURS, *(kind for kind in WRITERS if kind != "foxglove" or has_foxglove())]
    runs: dict[str, list[Run]] = {receiver: [] for receiver in receivers}
    for number in range(rounds):
        for receiver in receivers if number % 2 == 0 else reversed(receivers):
            one = run(receiver, ROBOTS, FAST_S * TICKS_PER_S, is_paced=False)
            assert one.lost == 0, f"{receiver} lost {one.lost}: the comparison is worth nothing"
            runs[receiver].append(one)
    return runs


def find_held(seconds: float, guess: int) -> Held | None:
    """The most robots at their own pace that the recorder holds, to within a few per cent."""
    held: Held | None = None
    too_many: int | None = None
    robots = guess
    for _ in range(SEARCH_RUNS):
        one = run(OURS, robots, round(seconds * TICKS_PER_S), is_paced=True)
        if one.lost == 0 and one.cpu_share <= 1 and max(one.lag_s, one.fed.late_s) < HELD_LAG_S:
            held = Held(robots, one)
        else:
            too_many = robots
        low = held.robots if held is not None else 0
        robots = round(robots * SEARCH_STEP) if too_many is None else (low + too_many) // 2
        if robots == low or (too_many is not None and (too_many - low) * 20 <= low):
            break
    return held


def rows(rounds: int, seconds: float, sustain_s: float) -> list[Row]:
    runs = compare(rounds)
    script = make_script()
    table = [
        *_figure(runs, FROM_QUEUE, lambda one: one.per_s, "{:,.0f}/s", is_rate=True),
        *_figure(runs, "records/s, the load meanwhile", lambda one: one.loaded_per_s, "{:,.0f}/s", is_rate=True),
        *_figure(runs, "CPU for a record, all of it", lambda one: one.cpu_us, "{:.1f} us"),
        *_figure(runs, "bytes of a record in the log", lambda one: one.bytes / one.written, "{:.1f}"),
    ]
    guess = median(one.per_s for one in runs[OURS]) / script.records_per_s
    held = find_held(seconds, max(1, round(guess / 2)))
    if held is None:
        return [*table, ("recorder: robots held", "none", "")]
    load = (
        f"{held.robots * script.samples_per_s:,.0f} samples/s, {held.robots * script.records_per_s:,.0f} records/s"
    )
    table += [
        (f"recorder: robots held for {seconds:g} s without loss", f"{held.robots}", ""),
        ("  that is", load, ""),
        ("  CPU", f"{held.run.cpu_share * 100:.0f} % of a core", "under 100 %"),
    ]
    if not sustain_s:
        return table
    robots = max(1, round(held.robots * SUSTAIN_SHARE))
    long = run(OURS, robots, round(sustain_s * TICKS_PER_S), is_paced=True)
    return [
        *table,
        (f"  {sustain_s:g} s with {robots}: records lost", f"{long.lost} of {long.fed.records:,}", "0"),
        ("  CPU", f"{long.cpu_share * 100:.0f} % of a core", ""),
    ]


def _figure(
    runs: dict[str, list[Run]], what: str, measure: Callable[[Run], float], form: str, *, is_rate: bool = False
) -> list[Row]:
    """Ours and each peer's; ratios are medians over the rounds, and above 1 where ours is better."""
    ours = [measure(one) for one in runs[OURS]]
    table: list[Row] = [(f"recorder: {what}", form.format(median(ours)), "")]
    for peer, name in NAMES.items():
        if peer not in runs:
            table.append((f"  {name}", "not installed", ""))
            continue
        theirs = [measure(one) for one in runs[peer]]
        ratio = median(
            (mine / other) if is_rate else (other / mine) for mine, other in zip(ours, theirs, strict=True)
        )
        goal = GOALS[peer] if what == FROM_QUEUE else ""
        table.append((f"  {name}", f"{form.format(median(theirs))}, {ratio:.2f} x", goal))
    return table

"""How much the recorder takes, over Zenoh on loopback TCP.

Ten driving robots feed it faster than it writes, and nothing may be lost. Counted are records of a log, a raw CAN
frame being one: how many a second leave a full queue once the load has ended (what it still holds back then counts
as written after it, a few per cent), how many it takes a second with the load on the same machine, and processor
time and bytes of each.

Then robots at their own pace, ever more, with the queue that the recorder has by itself: how many it holds without
loss, at most one core, and without falling behind; and how its memory does at 60 % of that.
"""

from __future__ import annotations

from statistics import fmean, linear_regression, median
from typing import Final

import msgspec

from tests.bench.loads import Row
from tests.bench.recorder_load import TICKS_PER_S, make_script
from tests.bench.recorder_run import Run, run

ROBOTS: Final = 10
FAST_S: Final = 40
"""What these robots say in so many seconds is a round."""

HELD_LAG_S: Final = 0.5
"""Whoever ends later than this behind the load did not hold it; whoever began a tick so late was no load."""

SEARCH_RUNS: Final = 7
SEARCH_STEP: Final = 1.3
SUSTAIN_SHARE: Final = 0.6


class Held(msgspec.Struct, frozen=True):
    """How many robots were held, and the run that showed it."""

    robots: int
    run: Run


def find_held(seconds: float, guess: int) -> Held | None:
    """The most robots at their own pace that the recorder holds for so long, to within a few per cent."""
    held: Held | None = None
    too_many: int | None = None
    robots = guess
    for _ in range(SEARCH_RUNS):
        one = run(robots, round(seconds * TICKS_PER_S), is_paced=True)
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
    runs = [run(ROBOTS, FAST_S * TICKS_PER_S, is_paced=False) for _ in range(rounds)]
    lost = [one.lost for one in runs]
    assert not any(lost), f"lost {lost}: the figures are worth nothing"
    script = make_script()
    per_s, loaded_per_s = (median(getattr(one, name) for one in runs) for name in ("per_s", "loaded_per_s"))
    cpu_us, size = median(one.cpu_us for one in runs), median(one.bytes / one.written for one in runs)
    table: list[Row] = [
        ("recorder: records/s from a full queue", f"{per_s:,.0f}/s", ""),
        ("  records/s, the load meanwhile", f"{loaded_per_s:,.0f}/s", ""),
        ("  CPU for a record, all of it; bytes in the log", f"{cpu_us:.1f} us; {size:.1f}", ""),
    ]
    held = find_held(seconds, max(1, round(per_s / script.records_per_s / 2)))
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
    long = run(robots, round(sustain_s * TICKS_PER_S), is_paced=True)
    late = long.rss_bytes[len(long.rss_bytes) // 2 :]
    slope = linear_regression(range(len(late)), late).slope if len(late) > 1 else 0.0
    return [
        *table,
        (f"  {sustain_s:g} s with {robots}: records lost", f"{long.lost} of {long.fed.records:,}", "0"),
        ("  CPU", f"{long.cpu_share * 100:.0f} % of a core", ""),
        ("  memory in the second half, change", f"{fmean(late) / 1e6:.0f} MB, {slope / 1e3:+.0f} kB/s", "flat"),
    ]

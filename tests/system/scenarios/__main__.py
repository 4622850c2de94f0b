"""Play many scenarios, and print a summary.

Usage: python -m tests.system.scenarios [--count N] [--seed FIRST] [--jobs N]
       python -m tests.system.scenarios --frozen | --freeze [--jobs N]
       python -m tests.system.scenarios --lines NAME
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections import Counter, defaultdict
from multiprocessing import Pool

import msgspec

from tests.system.scenarios import frozen
from tests.system.scenarios.oracle import Violation
from tests.system.scenarios.scenario import Play, Result, run, scenario

SEEDS_SHOWN = 6
TRACE_TICKS = 5
RUN_AGAIN_EVERY = 20


def trace(play_: Play) -> None:
    if round(play_.rig.now_s * 100) % TRACE_TICKS == 0:
        print(play_.oracle.line(play_.rig.now_s))
    for violation in play_.oracle.violations.values():
        if violation.at_s >= play_.rig.now_s - 0.005:
            print(f"   >>> {violation.kind} at {violation.at_s:.2f} s: {violation.detail}")


def play(job: tuple[int, bool]) -> Result:
    """Play a scenario; an exception is a violation like any other."""
    seed, runs_again = job
    try:
        return run(seed, runs_again=runs_again)
    except Exception as error:  # noqa: BLE001 - any exception has to name its seed
        where = traceback.extract_tb(error.__traceback__)[-1]
        crash = Violation("crash", 0.0, f"{type(error).__name__}: {error} in {where.name}, line {where.lineno}")
        return Result(seed, [crash], 0, 0.0, 0.0, 0.0, [])


def play_frozen(jobs: int, *, writes: bool) -> int:
    """Play all frozen runs, and write the file, or print the differences; 1 if there are any."""
    with Pool(jobs) as pool:
        rows = list(pool.imap(frozen.row_of, frozen.NAMES, chunksize=8))
    if writes:
        frozen.freeze(rows)
    before = frozen.frozen()
    differences = list(filter(None, (frozen.difference(row, before[row.partition(" ")[0]]) for row in rows)))
    print(*differences, f"{len(differences)} of {len(rows)} differ from {frozen.FILE.name}", sep="\n")
    return 1 if differences else 0


def main() -> int:
    """Play and print the summary; 1 if a rule was broken."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1, help="number of scenarios (default 1, printed in full)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first (default 1)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    parser.add_argument("--trace", action="store_true", help="print a line each 50 ms of the first one")
    parser.add_argument("--frozen", action="store_true", help="play the frozen runs and compare")
    parser.add_argument("--freeze", action="store_true", help="play them and write their hashes again")
    parser.add_argument("--lines", metavar="NAME", help="print all that is hashed of one frozen run")
    arguments = parser.parse_args()
    if arguments.lines:
        frozen.play(arguments.lines, sys.stdout.write)
        return 0
    if arguments.frozen or arguments.freeze:
        return play_frozen(arguments.jobs, writes=arguments.freeze)
    if arguments.trace:
        return 1 if run(arguments.seed, runs_again=True, watch=trace).violations else 0
    jobs = [(arguments.seed + number, number % RUN_AGAIN_EVERY == 0) for number in range(arguments.count)]
    began_s = time.perf_counter()
    with Pool(arguments.jobs) as pool:
        results = list(pool.imap_unordered(play, jobs, chunksize=8))
    if arguments.count == 1:
        print(msgspec.json.format(msgspec.json.encode(scenario(arguments.seed)), indent=1).decode())
    summary(results, time.perf_counter() - began_s)
    return 1 if any(result.violations for result in results) else 0


def summary(results: list[Result], took_s: float) -> None:
    print(
        f"{len(results)} scenarios, {sum(one.simulated_s for one in results) / 60:.0f} min simulated in "
        f"{took_s:.0f} s, {sum(one.driven_m for one in results):.0f} m driven, "
        f"{sum(one.stops for one in results)} stop phases, "
        f"{sum(bool(one.violations) for one in results)} scenarios with a violation"
    )
    kinds: dict[str, list[tuple[int, Violation]]] = defaultdict(list)
    for result in sorted(results, key=lambda one: one.seed):
        for violation in result.violations:
            kinds[violation.kind].append((result.seed, violation))
    for kind, found in sorted(kinds.items(), key=lambda item: -len(item[1])):
        seeds, (_, first) = ", ".join(str(seed) for seed, _ in found[:SEEDS_SHOWN]), found[0]
        print(f"{kind}: {len(found)}, seeds {seeds}; the first at {first.at_s:.2f} s: {first.detail}")
    print("disturbances:", dict(Counter(name for result in results for name in result.disturbances)))


if __name__ == "__main__":
    sys.exit(main())

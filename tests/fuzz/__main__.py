"""``make fuzz``: every target in its own process for its share of the time; findings are in build/fuzz.

Usage: python -m tests.fuzz [--seconds N] [--jobs N] [--target NAME ...]

A finding is run again with: python -m tests.fuzz.one TARGET FILE
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Final

from tests.fuzz.targets import BY_NAME, TARGETS, Target

ROOT: Final = Path(__file__).parents[2]
FOUND: Final = ROOT / "build" / "fuzz"
LONGEST_S: Final = 10
MEMORY_MB: Final = 1024
INPUT_BYTES: Final = 20_000
"""A little more than the longest statement; larger than the logs of the seeds."""


def main() -> None:
    """Fuzz, print a line for each target, and end with 1 if anything was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, default=60, help="of all targets together (default 60)")
    parser.add_argument("--jobs", type=int, default=1, help="targets at a time (default 1)")
    parser.add_argument("--target", action="append", choices=BY_NAME, help="only this one; may be repeated")
    arguments = parser.parse_args()
    targets = [one for one in TARGETS if not arguments.target or one.name in arguments.target]
    seconds = max(1, arguments.seconds * arguments.jobs // len(targets))
    with ThreadPoolExecutor(arguments.jobs) as pool:
        passed = list(pool.map(partial(fuzz, seconds=seconds), targets))
    sys.exit(0 if all(passed) else f"fuzz: findings in {FOUND.relative_to(ROOT)}")


def fuzz(target: Target, seconds: int) -> bool:
    """Fuzz a target; what was interesting in earlier runs is where it begins. False if something was found."""
    corpus, findings = FOUND / target.name / "corpus", FOUND / target.name
    corpus.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(target.seeds):
        (corpus / f"seed-{number}").write_bytes(seed)
    limits = [f"-max_total_time={seconds}", f"-timeout={LONGEST_S}", f"-rss_limit_mb={MEMORY_MB}"]
    options = [f"-max_len={INPUT_BYTES}", "-print_final_stats=1", f"-artifact_prefix={findings}/"]
    command = [sys.executable, "-m", "tests.fuzz.one", target.name, *limits, *options, str(corpus)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, errors="replace", check=False)
    runs = re.search(r"stat::number_of_executed_units: (\d+)", done.stderr)
    print(f"{target.name:16} {int(runs[1]) if runs else 0:>10,} runs in {seconds} s", flush=True)
    if done.returncode:
        # The exception is on stdout, libFuzzer's report on stderr.
        print(done.stdout[-2000:], done.stderr[-1000:], flush=True)
    return done.returncode == 0


if __name__ == "__main__":
    main()

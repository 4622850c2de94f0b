"""``make test``: run pytest, and sum its runs up in the last line."""

import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable
from typing import Final

SUMMARY: Final = re.compile(r"^=+ (\d+ \w+(?:, \d+ \w+)*) in [\d.]+s")  # the last line of a run
FIRST: Final = ("failed", "errors", "passed", "skipped")


def summed(lines: Iterable[str]) -> str:
    """The sum of the runs in this output."""
    counts = Counter[str]()
    for line in lines:
        if found := SUMMARY.match(line):
            for count, what in re.findall(r"(\d+) (\w+)", found[1]):
                counts["errors" if what == "error" else what] += int(count)
    order = sorted(counts, key=lambda what: FIRST.index(what) if what in FIRST else len(FIRST))
    return ", ".join(f"{counts[what]} {what}" for what in order) or "no test was run to its end"


def main() -> int:
    # Ctrl-C is the command's, which says so. A handler, since the command would inherit that it is ignored.
    signal.signal(signal.SIGINT, lambda *_: None)
    command = subprocess.Popen(
        sys.argv[1:], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    summaries = []
    for line in command.stdout or ():
        sys.stdout.write(line)
        sys.stdout.flush()
        if SUMMARY.match(line):
            summaries.append(line)
    code = command.wait()
    sys.stdout.write(f"\n{'FAILED' if code else 'passed'}: {summed(summaries)}\n")
    return code


if __name__ == "__main__":
    sys.exit(main())

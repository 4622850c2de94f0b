"""``cruiser review`` on a log in an object store: requests and bytes, and the time that they take on this machine.

A robot is driven by a gateway with a simulated chassis until its log has about the size, and then stopped by
somebody. The store is in memory and counts: a request of a real one takes some tens of milliseconds more.

Usage: python -m tests.bench.review_stored [--minutes N]. Not a test: machines differ.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from recorder.encoding.event_digest import DIGEST_NAME
from recorder.mcap.summary_reader import read_summary
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.logs import look_at_stored
from recorder.reading.rows import Selection, read_rows
from recorder.reading.survey import survey
from recorder.review.timeline.timeline import read_events
from recorder.review.why import Explainer
from tests.bench.loads import Row, print_table
from tests.support.fakes.objects import FakeStoredLog
from tests.support.messages import MS, SECOND
from tests.support.rigs.recorded import RecordedRig

MINUTES: Final = 20.0
TURN_S: Final = 5.0


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=MINUTES, help=f"of driving (default {MINUTES:g})")
    print_table(rows(parser.parse_args().minutes))


def rows(minutes: float = MINUTES) -> list[Row]:
    """The table of stored logs."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "a.mcap"
        path.write_bytes(drive(minutes))
        with path.open("rb") as stream:
            summary = read_summary(stream)
        digest = sum(one.length for one in summary.attachments if one.name == DIGEST_NAME) if summary else 0
        size = path.stat().st_size
        return [
            ("a log in a store", f"{size / 1e6:.1f} MB, {minutes:g} min; digest {100 * digest / size:.2f} %", ""),
            ("why: the last stop", ask(path, why), "under 2 MB, 10 requests"),
            ("events: of all of it", ask(path, events), "under 2 MB, 10 requests"),
            ("10 s of it, every topic", ask(path, middle), "under 1 s"),
        ]


def drive(minutes: float) -> bytes:
    """The log of a drive that ends with somebody's stop, as a recorder writes it."""
    rig, operator = RecordedRig.driving(0.5)
    for turn in range(int(60 * minutes / TURN_S)):
        operator.drive(0.5, 10.0 - turn % 20, TURN_S)
    rig.put("passer-by", "stop", b"")
    rig.rest_after(1)
    return rig.log(tick_ns=10 * MS)


def ask(path: Path, question: Callable[[LogFile], object]) -> str:
    """Ask as a new command does. Returns the figures."""
    stored = FakeStoredLog(path)
    stored.objects.looks.append("its length")
    start_s = time.perf_counter()
    question(look_at_stored(stored))
    wall_s = time.perf_counter() - start_s
    return f"{stored.objects.requests} requests, {stored.objects.fetched / 1e6:.2f} MB, {wall_s:.2f} s"


def why(log: LogFile) -> object:
    """Explain the last stop."""
    faults = Faults()
    return Explainer("cruiser-1", [log], survey([log], faults), faults).last()


def events(log: LogFile) -> object:
    """All entries."""
    return list(read_events([log], Selection(), Faults()))


def middle(log: LogFile) -> object:
    """All messages of ten seconds."""
    from_ns = (log.start_ns + log.end_ns) // 2
    return list(read_rows([log], Selection(from_ns=from_ns, to_ns=from_ns + 10 * SECOND), Faults()))


if __name__ == "__main__":
    main()

"""kill -9 of a recorder at random instants: what each kill cost, after the next start has recovered its log."""

from __future__ import annotations

import random
import signal
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import msgspec
from mcap.reader import make_reader

from recorder.disk.keeper import RecoveryOutcome, recover
from recorder.review.check import check_log
from schemas.messages import Gear
from tests.bench.loads import Row
from tests.bench.processes import quantile, start
from tests.support.fakes.peer import Peer, free_endpoint
from tests.support.messages import gear, key_of, sample_of
from tests.support.waiting import wait_until

PERIOD_S = 0.002
ALIVE_S = (0.6, 1.8)  # range of the time from a recorder's first sample to its kill
JOINING = 20  # a new subscriber on a busy machine may miss some of the first samples


class Kills(msgspec.Struct, frozen=True):
    """The cost of the kills.

    Attributes:
        lost_ms: for each kill, from the last message in its log to the kill.
        lost, sent: messages lost in each kill, and all that were sent to a recorder.
        holes, doubled: messages missing inside a log; in two logs.
        left: parts that the later starts had not recovered.
        not_whole: logs that are not whole in the end.
    """

    lost_ms: list[float]
    lost: list[int]
    sent: int
    holes: int
    doubled: int
    left: int
    not_whole: list[str]


class _Publisher:
    def __init__(self, endpoint: str) -> None:
        self.next = 0
        self._peer = Peer(endpoint)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._peer.close()

    def _run(self) -> None:
        while not self._stop.wait(PERIOD_S):
            self._peer.put(sample_of(gear(self.next, time.time_ns())))
            self.next += 1


def measure(kills: int, directory: Path, seed: int = 1) -> Kills:
    """Kill recorders one after the other on one directory; then read all logs."""
    chooser = random.Random(seed)  # noqa: S311 - reproducible, not secret
    endpoint = free_endpoint()
    ends: list[tuple[int, int]] = []
    with _Publisher(endpoint) as publisher:
        for _ in range(kills):
            before = set(directory.iterdir())
            with ExitStack() as stack:
                words = ["-m", "gateway", "record", "-o", str(directory), "--connect", endpoint]
                recorder, _ready = start(stack, words, "record: ")
                # Whatever is new is this recorder's log, or an earlier one that it has recovered.
                wait_until(lambda before=before: _is_writing(directory, before))  # type: ignore[misc]  # bound at once
                time.sleep(chooser.uniform(*ALIVE_S))
                recorder.send_signal(signal.SIGKILL)
                ends.append((publisher.next, time.time_ns()))
                recorder.wait()
    left = sorted(directory.glob("*.part"))
    for path in left:
        assert recover(path, "bench").outcome in {RecoveryOutcome.WHOLE, RecoveryOutcome.RECOVERED}
    return _count(directory, ends, len(left))


def _is_writing(directory: Path, before: set[Path]) -> bool:
    return any(path.name.endswith(".part") and path.stat().st_size for path in set(directory.iterdir()) - before)


def _count(directory: Path, ends: list[tuple[int, int]], left: int) -> Kills:
    """Compare each log with what had been sent by its kill."""
    logs: list[dict[int, int]] = []
    for path in directory.glob("*.mcap"):
        with path.open("rb") as stream:
            found = make_reader(stream, validate_crcs=True).iter_messages(topics=[key_of(Gear)])
            logs.append({message.sequence: message.publish_time for _, _, message in found})
    logs = sorted((log for log in logs if log), key=min)
    lost_ms, lost, sent = [], [], 0
    for log, (next_sent, killed_ns) in zip(logs, ends, strict=True):
        last = max(log)
        lost_ms.append((killed_ns - log[last]) / 1e6)
        lost.append(max(0, next_sent - 1 - last))
        sent += next_sent - min(log)
    return Kills(
        lost_ms=sorted(lost_ms),
        lost=sorted(lost),
        sent=sent,
        holes=sum(number not in log for log in logs for number in range(min(log) + JOINING, max(log))),
        doubled=sum(map(len, logs)) - len({sequence for log in logs for sequence in log}),
        left=left,
        not_whole=[str(path) for path in directory.glob("*") if not check_log(path).whole],
    )


def rows(kills: int) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        cost = measure(kills, Path(folder))
    lost = " ".join(f"{quantile(cost.lost_ms, share):.0f}" for share in (0.5, 0.99, 1))
    whole = f"{cost.holes}, {cost.doubled}, {len(cost.not_whole)}"
    return [
        (f"{kills} kills of a recorder: lost before each, p50 p99 max", f"{lost} ms", ""),
        ("  messages, most, of all sent", f"{cost.lost[-1]}, {cost.sent}", ""),
        ("  holes, doubled, not whole", whole, "0, 0, 0"),
    ]

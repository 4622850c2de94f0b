"""One run of the recorder's bench: the load, one receiver, and what it wrote and used.

Processor time is that of the receiver's whole process from the first sample on. Its end is seen by its processor
time, since a receiver may note the receipt long before it writes.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Final, Self

import msgspec
from mcap.records import Channel, Statistics
from mcap.stream_reader import StreamReader

from schemas.command_line import ExitCode
from schemas.recording import OUTLINE_CHUNK, TRANSFORM_CHUNK
from tests.bench.recorder_load import Fed
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.usage import cpu_s

OURS: Final = "recorder"  # ``cruiser record``; the others are in ``recorder_peers``
QUEUE_SAMPLES: Final = 1_000_000
QUEUE_BYTES: Final = 4_000_000_000  # room for all that waits at a receiver
BUSY_SHARE: Final = 0.2
BUSY_WINDOW_S: Final = 0.02  # a receiver is busy while it uses this share of a core
IDLE_S: Final = 0.5  # it has finished when it was idle for so long
DRAIN_S: Final = 120.0
MARGIN_S: Final = 60.0  # added to the load's time for start, drain and end
DRAIN_MIN_S: Final = 0.3  # a shorter drain is not measured


class Run(msgspec.Struct, frozen=True):
    """The result of a run.

    Attributes:
        written, lost: records in the logs, and missing there.
        wall_s: from the first sample to the receiver's last work.
        lag_s: from the publisher's end to that.
        drain_per_s: records a second in that time, by the growth of the logs.
    """

    fed: Fed
    written: int
    lost: int
    cpu_s: float
    wall_s: float
    lag_s: float
    drain_per_s: float
    bytes: int

    @property
    def cpu_us(self) -> float:
        return self.cpu_s * 1e6 / self.written

    @property
    def per_s(self) -> float:
        """Records a second from a full queue, or with the load beside if the receiver keeps pace."""
        return self.drain_per_s if self.lag_s > DRAIN_MIN_S else self.loaded_per_s

    @property
    def loaded_per_s(self) -> float:
        return self.written / self.wall_s

    @property
    def cpu_share(self) -> float:
        return self.cpu_s / self.wall_s


def run(receiver: str, robots: int, ticks: int, *, is_paced: bool) -> Run:
    """Feed a receiver for so many ticks of 10 ms: at the robots' pace, or as fast as possible."""
    endpoint = free_endpoint()
    load = ["-m", "tests.bench.recorder_load", endpoint, "--robots", str(robots), "--ticks", str(ticks)]
    queue = {} if is_paced else {"CRUISER_RECORDER_QUEUE_BYTES": str(QUEUE_BYTES)}
    with TemporaryDirectory() as name:
        folder = Path(name)
        with started([sys.executable, *load, *["--paced"] * is_paced], ticks / 100) as publisher:
            answer(publisher)
            if receiver == OURS:
                words = ["-m", "gateway", "record", "-o", name, "--connect", endpoint, "--json"]
            else:
                log = str(folder / "log.mcap")
                words = ["-m", "tests.bench.recorder_peers", receiver, endpoint, log, str(QUEUE_SAMPLES)]
            with started([sys.executable, *words], ticks / 100, **queue) as process:
                said = await_ready(process)
                go_on(publisher)
                begin_s = cpu_s(process.pid)
                with _Watch(process.pid) as watch:
                    fed = msgspec.json.decode(go_on(publisher), type=Fed)
                    written_bytes = _log_bytes(folder)
                    watch.await_idle()
                assert process.poll() is None, "".join(said)
                process.send_signal(signal.SIGTERM)
                assert process.stdout is not None
                process.stdout.read()
                _, status, usage = os.wait4(process.pid, 0)
                # A recorder that has lost something says so by its exit code.
                assert os.waitstatus_to_exitcode(status) in {ExitCode.OK, ExitCode.PARTIAL}, "".join(said)
        log_bytes, written = _log_bytes(folder), sum(map(_records, folder.glob("*.mcap")))
    lag_s = max(0.0, (watch.busy_ns - fed.end_ns) / 1e9)
    return Run(
        fed=fed,
        written=written,
        lost=fed.records - written,
        cpu_s=usage.ru_utime + usage.ru_stime - begin_s,
        wall_s=(fed.end_ns - fed.begin_ns) / 1e9 + lag_s,
        lag_s=lag_s,
        drain_per_s=written * (1 - written_bytes / log_bytes) / lag_s if lag_s else 0.0,
        bytes=log_bytes,
    )


def _log_bytes(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.iterdir())


def _records(path: Path) -> int:
    """Return the records of samples: without what the recorder says itself, and draws for viewers."""
    drawn = (f"/{TRANSFORM_CHUNK}", f"/{OUTLINE_CHUNK}")
    own: set[int] = set()
    counts: dict[int, int] = {}
    with path.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Channel) and ("@" in record.topic or record.topic.endswith(drawn)):
                own.add(record.id)
            elif isinstance(record, Statistics):
                counts = record.channel_message_counts
    return sum(count for channel_id, count in counts.items() if channel_id not in own)


@contextmanager
def started(words: list[str], load_s: float, **environment: str) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )
    killer = threading.Timer(load_s + DRAIN_S + MARGIN_S, process.kill)
    killer.start()
    try:
        yield process
    except BaseException:
        process.kill()
        raise
    finally:
        # Its input ends, and so does it.
        process.communicate()
        killer.cancel()


def answer(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    assert process.stderr is not None
    line = process.stdout.readline()
    assert line, process.stderr.read()
    return line


def go_on(process: subprocess.Popen[str]) -> str:
    """Let it take its next step. Returns its next line."""
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()
    return answer(process)


def await_ready(process: subprocess.Popen[str]) -> list[str]:
    """Wait until it receives. Returns its lines on stderr, then and later."""
    assert process.stderr is not None
    said = []
    for line in process.stderr:
        said.append(line)
        if line.startswith("record: "):
            threading.Thread(target=_listen, args=(process.stderr, said), daemon=True).start()
            return said
    raise RuntimeError("".join(said))


def _listen(stream: IO[str], said: list[str]) -> None:
    # The stream is closed when the process has ended.
    with suppress(ValueError):
        said.extend(stream)


class _Watch:
    """Notes when a process was last busy."""

    def __init__(self, pid: int) -> None:
        self.busy_ns = 0  # since 1970
        self._proc = Path(f"/proc/{pid}")
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    def await_idle(self) -> None:
        begin_ns = time.time_ns()
        while (now_ns := time.time_ns()) - max(self.busy_ns, begin_ns) < IDLE_S * 1e9:
            if now_ns - begin_ns > DRAIN_S * 1e9:
                raise TimeoutError("the receiver does not come to an end")
            time.sleep(BUSY_WINDOW_S)

    def _run(self) -> None:
        last_ns, ran_ns = time.time_ns(), self._ran_ns()
        while not self._is_over.wait(BUSY_WINDOW_S):
            before_ns, last_ns = last_ns, time.time_ns()
            before_ran_ns, ran_ns = ran_ns, self._ran_ns()
            if ran_ns - before_ran_ns > BUSY_SHARE * (last_ns - before_ns):
                self.busy_ns = last_ns

    def _ran_ns(self) -> int:
        """Processor time of all threads; that of ``stat`` is too coarse."""
        ran_ns = 0
        for path in self._proc.glob("task/*/schedstat"):
            # A thread may have ended since.
            with suppress(OSError):
                ran_ns += int(path.read_text(encoding="utf-8").split()[0])
        return ran_ns

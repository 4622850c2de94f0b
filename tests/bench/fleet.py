"""A fleet through routers into sharded recorders: the load of each process, and losses.

One process plays all robots, each with its own session and a real gateway's payloads and rates
(``recorder_load``). They appear at one instant, publish once somebody subscribes, and answer no query. ``ZENOHD``
names Zenoh's own router; without it ours runs. Bytes on the links come from ``ss`` (iproute2), if it is there.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec

from schemas.command_line import ExitCode
from tests.bench.loads import Row
from tests.bench.recorder_load import Fed
from tests.bench.recorder_run import answer, await_ready, go_on, started
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.listening import listening
from tests.support.processes.usage import cpu_s, rss_bytes
from tests.support.waiting import wait_until

ZENOHD: Final = os.environ.get("ZENOHD", "")

SETTLE_S: Final = 1.5  # until all that was sent is on the disk


class FleetRun(msgspec.Struct, frozen=True, kw_only=True):
    """The result of a run.

    Attributes:
        late_s: behind the robots' pace at the end.
        join_s: from the robots' tokens until somebody subscribed to each of them.
        dropped, missed: samples that recorders dropped, and that never reached them.
        cpu_s: of the robots' process, the routers and the recorders, during the load.
        sent_bytes: TCP payload; 0 without ``ss``.
    """

    robots: int
    profile: str
    samples: int
    recorded: int
    join_s: float
    join_cpu_s: dict[str, list[float]]
    seconds: float
    late_s: float
    dropped: int
    missed: int
    cpu_s: dict[str, list[float]]
    rss_bytes: dict[str, list[float]]
    sent_bytes: dict[str, list[float]]
    log_bytes: int

    @property
    def name(self) -> str:
        routers, shards = len(self.cpu_s["routers"]), len(self.cpu_s["recorders"])
        return f"{self.robots} {self.profile} robots, {routers} router{'s' * (routers > 1)}, {shards} shards"

    def shares(self, who: str) -> str:
        """The share of a core of each process of a kind."""
        return ", ".join(f"{one / self.seconds * 100:.0f} %" for one in self.cpu_s[who])

    def cost_us(self, who: str) -> float:
        """Processor time per sample, of all processes of a kind."""
        return sum(self.cpu_s[who]) * 1e6 / self.samples


def measure(robots: int, routers: int, shards: int, seconds: float, profile: str) -> FleetRun:
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder, ends = Path(name), [free_endpoint() for _ in range(routers)]
        kinds = {
            "routers": [
                stack.enter_context(_router(folder / f"{number}.json5", end, ends[:number], seconds))
                for number, end in enumerate(ends)
            ],
            "recorders": [
                stack.enter_context(_recorder(folder / str(shard), ends[-1], f"{shard}/{shards}", seconds))
                for shard in range(1, shards + 1)
            ],
        }
        words = ["--robots", str(robots), "--ticks", str(round(seconds * 100)), "--paced", "--client"]
        load_words = ["-m", "tests.bench.recorder_load", ends[0], *words, "--profile", profile]
        load = stack.enter_context(started([sys.executable, *load_words], seconds))
        kinds["robots"] = [load]
        answer(load)
        appeared, appeared_s = _each(kinds, cpu_s), time.monotonic()
        go_on(load)
        join_s = time.monotonic() - appeared_s
        begun, sent = _each(kinds, cpu_s), _each(kinds, _sent_bytes)
        fed = msgspec.json.decode(go_on(load), type=Fed)
        time.sleep(SETTLE_S)
        used, memory, sent_since = _each(kinds, cpu_s), _each(kinds, rss_bytes), _each(kinds, _sent_bytes)
        accounts = [_end(one) for one in kinds["recorders"]]
        log_bytes = sum(path.stat().st_size for path in folder.rglob("*.mcap"))
    return FleetRun(
        robots=robots,
        profile=profile,
        samples=fed.samples,
        recorded=sum(key["received"] for account in accounts for key in account["keys"].values()),
        join_s=join_s,
        join_cpu_s=_since(appeared, begun),
        seconds=(fed.end_ns - fed.begin_ns) / 1e9,
        late_s=fed.late_s,
        dropped=sum(account["lost_queue"] + account["lost_disk"] for account in accounts),
        missed=sum(account["lost_link"] for account in accounts),
        cpu_s=_since(begun, used),
        rss_bytes=memory,
        sent_bytes=_since(sent, sent_since),
        log_bytes=log_bytes,
    )


def _each(kinds: dict[str, list[subprocess.Popen[str]]], figure: Callable[[int], float]) -> dict[str, list[float]]:
    return {kind: [figure(one.pid) for one in ones] for kind, ones in kinds.items()}


def _since(begun: dict[str, list[float]], ended: dict[str, list[float]]) -> dict[str, list[float]]:
    return {
        kind: [end - begin for begin, end in zip(begun[kind], ends, strict=True)] for kind, ends in ended.items()
    }


def _sent_bytes(pid: int) -> int:
    """Bytes sent on a process's TCP connections; 0 without ``ss``."""
    program = shutil.which("ss")
    if program is None:
        return 0
    listed = subprocess.run([program, "-tinpHO"], capture_output=True, text=True, check=True).stdout
    return sum(
        int(found[1])
        for line in listed.splitlines()
        if f"pid={pid}," in line and (found := re.search(r"bytes_sent:(\d+)", line))
    )


def rows(robots: Iterable[int], routers: int, shards: int, seconds: float, profile: str) -> list[Row]:
    runs = (measure(number, routers, shards, seconds, profile) for number in robots)
    return [row for run in runs for row in rows_of(run)]


def rows_of(run: FleetRun) -> list[Row]:
    memory = {kind: ", ".join(f"{size / 1e6:.0f}" for size in sizes) for kind, sizes in run.rss_bytes.items()}
    sent = [sum(run.sent_bytes["robots"]), *run.sent_bytes["routers"]]
    return [
        (f"{run.name}: samples/s", f"{run.samples / run.seconds:.0f}", ""),
        (
            "  until all had a subscriber; CPU of routers, recorders",
            f"{run.join_s:.1f} s; {sum(run.join_cpu_s['routers']):.1f}, {sum(run.join_cpu_s['recorders']):.1f} s",
            "",
        ),
        ("  behind the robots' pace", f"{run.late_s:.1f} s of {run.seconds:.1f}", ""),
        ("  samples in logs", f"{run.recorded} of {run.samples}", "all"),
        ("  dropped, missed", f"{run.dropped}, {run.missed}", "0, 0"),
        ("  CPU of each router", f"{run.shares('routers')}, {run.cost_us('routers'):.1f} us a sample", ""),
        ("  CPU of each recorder", f"{run.shares('recorders')}, {run.cost_us('recorders'):.1f} us a sample", ""),
        ("  memory of routers; recorders", f"{memory['routers']}; {memory['recorders']} MB", ""),
        (
            "  sent for each robot: by it, by each router",
            ", ".join(f"{one / run.seconds / run.robots / 1e3:.1f}" for one in sent) + " kB/s",
            "",
        ),
        ("  log of each robot", f"{run.log_bytes / run.seconds / run.robots / 1e3:.1f} kB/s", ""),
    ]


@contextmanager
def _router(file: Path, endpoint: str, connect: list[str], load_s: float) -> Iterator[subprocess.Popen[str]]:
    configuration = {
        "mode": "router",
        "listen": {"endpoints": [endpoint]},
        "connect": {"endpoints": connect},
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"unicast": {"max_sessions": 20_000, "accept_pending": 1_000}},
    }
    file.write_text(json.dumps(configuration), "utf-8")
    words = [ZENOHD, "-c"] if ZENOHD else [sys.executable, "-m", "gateway", "router", "--zenoh-config"]
    with started([*words, str(file)], load_s) as process:
        wait_until(lambda: process.poll() is not None or endpoint.partition("/")[2] in listening(process.pid))
        try:
            yield process
        finally:
            process.terminate()


@contextmanager
def _recorder(directory: Path, endpoint: str, shard: str, load_s: float) -> Iterator[subprocess.Popen[str]]:
    words = ["-m", "gateway", "record", "--shard", shard, "-o", str(directory), "--connect", endpoint, "--json"]
    with started([sys.executable, *words], load_s, CRUISER_ZENOH_MODE="client") as process:
        await_ready(process)
        yield process


def _end(recorder: subprocess.Popen[str]) -> dict[str, Any]:
    recorder.send_signal(signal.SIGTERM)
    assert recorder.stdout is not None
    account: dict[str, Any] = json.loads(recorder.stdout.read())
    assert recorder.wait() in {ExitCode.OK, ExitCode.PARTIAL}
    return account

"""Memory and start of a robot's processes in open mode.

Memory is that of ``smaps_rollup``, beside an interpreter that has only opened a Zenoh session. The first sample is
timed from the gateway's start to a subscriber's callback; the chassis runs, and the files are cached.
"""

from __future__ import annotations

import json
import re
import statistics
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import msgspec
import zenoh

from schemas.settings import ZenohSettings
from schemas.zenoh_session import close_session, open_session, session_settings
from tests.bench.loads import Row
from tests.bench.processes import served_chassis, start
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.usage import cpu_s

TIMEOUT_S: Final = 30.0

IDLE: Final = """
import json, sys, time, zenoh
config = zenoh.Config()
for path, value in json.loads(sys.argv[1]).items():
    config.insert_json5(path, json.dumps(value))
session = zenoh.open(config)
print("idle: ready", file=sys.stderr, flush=True)
time.sleep(3600)
"""


class Start(msgspec.Struct, frozen=True):
    """Seconds until the first sample, and processor time of all threads until then."""

    first_s: float
    cpu_s: float


class Memory(msgspec.Struct, frozen=True):
    """Memory in MiB: resident, and the anonymous pages in it."""

    resident: float
    own: float


def _start_once(bus: list[str]) -> Start:
    endpoint = free_endpoint()
    came = threading.Event()
    first_s: list[float] = []

    def receive(_sample: zenoh.Sample) -> None:
        if not first_s:
            first_s.append(time.monotonic())
            came.set()

    with ExitStack() as stack:
        session = open_session(ZenohSettings(), [], [endpoint])
        stack.callback(close_session, session)
        session.declare_subscriber("**", receive)
        began_s = time.monotonic()
        gateway, _ = start(stack, ["-m", "gateway", "gateway", *bus, "--connect", endpoint], "gateway: ")
        if not came.wait(TIMEOUT_S):
            raise TimeoutError("no sample came")
        return Start(first_s[0] - began_s, cpu_s(gateway.pid))


def measure_memory(seconds: float) -> dict[str, Memory]:
    """Memory of gateway, guard and recorder at rest, and of an interpreter with a session."""
    endpoint = free_endpoint()
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        words = ["-m", "gateway", "gateway", *_chassis(stack), "--listen", endpoint]
        gateway, _ = start(stack, words, "gateway: ")
        words = ["-m", "gateway", "record", "-o", folder, "--connect", endpoint]
        recorder, _ = start(stack, words, "record: ")
        entries = json.dumps(session_settings(ZenohSettings(), [endpoint], []))
        idle, _ = start(stack, ["-c", IDLE, entries], "idle: ")
        time.sleep(seconds)
        guard = int(Path(f"/proc/{gateway.pid}/task/{gateway.pid}/children").read_text("ascii").split()[0])
        pids = {"gateway": gateway.pid, "its guard": guard, "recorder": recorder.pid, "idle": idle.pid}
        return {name: _memory(pid) for name, pid in pids.items()}


def _chassis(stack: ExitStack) -> list[str]:
    """Start a virtual chassis. Returns a gateway's flags for its bus."""
    return ["--interface", "socketcand", "--channel", served_chassis(stack), "--variant", "coarse"]


def _memory(pid: int) -> Memory:
    text = Path(f"/proc/{pid}/smaps_rollup").read_text("ascii")
    kib = {name: int(value) for name, value in re.findall(r"^(\w+): +(\d+) kB$", text, re.MULTILINE)}
    return Memory(kib["Rss"] / 1024, kib["Anonymous"] / 1024)


def rows(starts: int, seconds: float) -> list[Row]:
    goals = {"gateway": "45 MiB", "its guard": "30 MiB", "recorder": "45 MiB"}
    names = {"idle": "an interpreter with a Zenoh session"}
    found = measure_memory(seconds)
    memory = [
        (
            f"{names.get(name, name)}: resident, of that its own",
            f"{one.resident:.1f}, {one.own:.1f} MiB",
            goals.get(name, ""),
        )
        for name, one in found.items()
    ]
    with ExitStack() as stack:
        bus = _chassis(stack)
        started = [_start_once(bus) for _ in range(starts)]
    first_s = sorted(one.first_s for one in started)
    return [
        *memory,
        (
            "gateway's start to its first sample, least, p50",
            f"{first_s[0]:.2f}, {statistics.median(first_s):.2f} s, of {starts}",
            "0.40 s",
        ),
        ("  CPU of its threads until then", f"{statistics.median(one.cpu_s for one in started):.2f} s", ""),
    ]

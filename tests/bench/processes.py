"""Chassis, gateway and recorder as three processes, with a subscriber that watches the clock."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import msgspec
import zenoh

from schemas import codec
from schemas.messages import Message
from schemas.settings import ZenohSettings
from schemas.subjects import BY_NAME
from schemas.zenoh_session import close_session, open_session
from tests.bench.empty_loop import KEY as EMPTY_KEY
from tests.support.fakes.peer import free_endpoint

NOMINAL_FRAMES_PER_S = 630
WARM_UP_S = 2.0
WATCHED = BY_NAME["chassis/gear"]


class Empty(msgspec.Struct):
    """Lateness of an empty loop's ticks, and times of its puts to a subscriber, on the same machine; sorted."""

    lateness_us: list[float] = []
    put_us: list[float] = []


class Load(msgspec.Struct, frozen=True):
    """The result of one run.

    Attributes:
        frames, lost, missed: raw frames in the log, frames missing by the alive counters, samples missing.
        gateway_cpu_percent, gateway_cpu_us: of one core, and per frame: the whole process.
        latency_us: from the chassis's send to the subscriber's callback, sorted.
        lateness_us: of each of the gateway's ticks, sorted.
    """

    frames_per_s: float
    frames: int
    lost: int
    missed: int
    gateway_cpu_percent: float
    gateway_cpu_us: float
    latency_us: list[float]
    lateness_us: list[float]
    empty: Empty


def quantile(values: list[float], share: float) -> float:
    return values[min(len(values) - 1, int(share * len(values)))] if values else float("nan")


def run_load(frames_per_s: float, seconds: float, vcan: str = "") -> Load:
    """Run chassis, gateway and recorder after a warm-up, and read the log; without vcan over socketcand."""
    endpoint = free_endpoint()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        multiplier = str(frames_per_s / NOMINAL_FRAMES_PER_S)
        sim = ["-m", "gateway", "sim", "--rate-multiplier", multiplier]
        if vcan:
            bus = ["--interface", "socketcan", "--channel", vcan]
            start(stack, [*sim, *bus], "sim: ")
        else:
            bus = ["--interface", "socketcand", "--channel", served_chassis(stack, *sim[3:])]
        bus += ["--listen", endpoint]
        probe = ["-m", "tests.bench.gateway_probe", str(folder / "probe.json"), *bus, "--variant", "coarse"]
        gateway, _ = start(stack, probe, "gateway: ")
        beside = ExitStack()
        stack.push(beside)
        empty = beside.enter_context(empty_loop())
        time.sleep(WARM_UP_S)
        latency_us: list[float] = []
        session = open_session(ZenohSettings(), [endpoint], [])
        stack.callback(close_session, session)
        subscriber = session.declare_subscriber(f"**/{WATCHED.name}", _watch(latency_us))
        record = ["-m", "gateway", "record", "-o", str(folder), "--connect", endpoint, "--json"]
        recorder, _ = start(stack, record, "record: ")
        time.sleep(seconds)
        recorder.terminate()
        assert recorder.stdout is not None
        log = json.loads(recorder.stdout.read())["path"]
        subscriber.undeclare()
        gateway.terminate()
        gateway.wait(20)
        beside.close()
        measured = json.loads((folder / "probe.json").read_text(encoding="utf-8"))
        checked = _check(log)
    frames = sum(row["frames"] for row in checked["frames"])
    lateness_us = sorted(late_ns / 1000 for late_ns in measured["late_ns"])
    handled = len(measured["late_ns"]) / 100 * frames_per_s
    return Load(
        frames_per_s=frames_per_s,
        frames=frames,
        lost=checked["frames_lost"],
        missed=checked["missed"],
        gateway_cpu_percent=measured["cpu_s"] / (len(measured["late_ns"]) / 100) * 100,
        gateway_cpu_us=measured["cpu_s"] * 1e6 / handled,
        latency_us=sorted(latency_us),
        lateness_us=lateness_us,
        empty=empty,
    )


@contextmanager
def empty_loop() -> Iterator[Empty]:
    """Run an empty loop meanwhile; its figures are there at the end."""
    empty = Empty()
    endpoint = free_endpoint()

    def receive(sample: zenoh.Sample) -> None:
        empty.put_us.append((time.time_ns() - int.from_bytes(sample.payload.to_bytes(), "big")) / 1000)

    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        file = Path(folder) / "late.json"
        process, _ = start(stack, ["-m", "tests.bench.empty_loop", endpoint, str(file)], "empty: ")
        session = open_session(ZenohSettings(), [endpoint], [])
        stack.callback(close_session, session)
        session.declare_subscriber(EMPTY_KEY, receive)
        yield empty
        process.terminate()
        process.wait(20)
        empty.lateness_us = sorted(late_ns / 1000 for late_ns in json.loads(file.read_text(encoding="utf-8")))
    empty.put_us.sort()


def _watch(latency_us: list[float]) -> Any:  # noqa: ANN401 - Zenoh's own callback type
    def watch(sample: zenoh.Sample) -> None:
        now_ns = time.time_ns()
        message = codec.decode(WATCHED, sample.payload.to_bytes())
        if isinstance(message, Message):
            latency_us.append((now_ns - message.time_ns) / 1000)

    return watch


def served_chassis(stack: ExitStack, *words: str) -> str:
    ready = start(stack, ["-m", "gateway", "sim", "--listen", "127.0.0.1:0", *words], "sim: ")[1]
    return "127.0.0.1:" + ready.partition("127.0.0.1:")[2].split()[0].rstrip(",;.")


def start(stack: ExitStack, words: list[str], ready: str) -> tuple[subprocess.Popen[str], str]:
    """Start a process; it, and its first line that begins so. It ends with the stack."""
    process = subprocess.Popen(
        [sys.executable, *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={
            "CRUISER_GATEWAY_STATE_DIR": "",
            "CRUISER_COMMAND_SPEED_LIMIT_MPS": "2.222",
            "CRUISER_COMMAND_SPEED_LIMIT_WITHOUT_REALTIME_MPS": "2.222",
        }
        | os.environ,
    )
    stack.enter_context(process)
    stack.callback(process.terminate)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(ready):
            threading.Thread(target=_drain, args=(process.stderr,), daemon=True).start()
            return process, line
    raise RuntimeError(f"{words} ended with {process.wait()}")


def _drain(stream: IO[str]) -> None:
    # The stream is closed when the process has ended.
    with suppress(ValueError):
        for _ in stream:
            pass


def _check(log: str) -> dict[str, Any]:
    command = [sys.executable, "-m", "gateway", "review", "check", "--json", log]
    # It ends with 1 where it finds a loss, which is a figure here.
    checked: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, check=False).stdout)
    return checked

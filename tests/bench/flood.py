"""20,000 puts a second on ``drive`` for three seconds, by somebody without the lease, while another one drives."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from random import Random
from typing import Final

import msgspec
import zenoh

from schemas.settings import ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.bench.command_latency import SPEED_MPS, on_the_road, stop_under_way_us
from tests.bench.loads import Row, beside
from tests.bench.processes import empty_loop

PUTS_PER_S: Final = 20_000
SECONDS: Final = 3.0
BURSTS_PER_S: Final = 500
KEY: Final = "fleet/cruiser-1/@cmd/stranger/drive"


def rows(floods: int) -> list[Row]:
    random = Random(0)  # noqa: S311 - to hit every place between two ticks
    stop_us: list[float] = []
    rates: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        probe = Path(folder) / "probe.json"
        command = ("-m", "tests.bench.gateway_probe", str(probe))
        with on_the_road(*command) as (driver, witness, endpoint, _), empty_loop() as empty:
            for _ in range(floods):
                driver.get_going()
                words = [sys.executable, "-m", "tests.bench.flood", endpoint]
                with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as flood:
                    assert flood.stdout is not None
                    flood.stdout.readline()
                    end_s = time.monotonic() + SECONDS / 2
                    while time.monotonic() < end_s:
                        driver.drive(SPEED_MPS)
                        time.sleep(0.02)
                    stop_us.append(stop_under_way_us(driver, witness, random))
                    rates.append(float(flood.stdout.readline()))
        measured = json.loads(probe.read_text(encoding="utf-8"))
    late_us = sorted(late_ns / 1000 for late_ns in measured["late_ns"])
    late, empty_late, difference = beside(late_us, empty.lateness_us, (0.5, 0.99, 1), 1)
    stop, empty_put, _ = beside(sorted(stop_us), empty.put_us, (0.5, 1), 1)
    return [
        (f"flood of {min(rates):.0f} puts/s: tick lateness, p50 p99 max", late, ""),
        ("  an empty loop of its priority meanwhile", empty_late, ""),
        ("  the difference", difference, "20 ms"),
        ("  remote stop put to first stop frame, p50 max", stop, "100 ms"),
        ("  an empty put meanwhile", empty_put, ""),
    ]


def flood(endpoint: str) -> None:
    """Put in bursts; print when it begins, and the rate."""
    session = open_session(ZenohSettings(mode="client"), [endpoint], [])
    publisher = session.declare_publisher(KEY, congestion_control=zenoh.CongestionControl.DROP)
    payload = msgspec.msgpack.encode(
        {"lease": 1, "seq": 1, "challenge": bytes(8), "speed_mps": 1.0, "angle_deg": 0.0}
    )
    print("begun", flush=True)
    begun_s = time.monotonic()
    bursts = round(SECONDS * BURSTS_PER_S)
    for number in range(bursts):
        for _ in range(PUTS_PER_S // BURSTS_PER_S):
            publisher.put(payload)
        time.sleep(max(0.0, begun_s + (number + 1) / BURSTS_PER_S - time.monotonic()))
    print(bursts * (PUTS_PER_S // BURSTS_PER_S) / (time.monotonic() - begun_s), flush=True)
    close_session(session)


if __name__ == "__main__":
    flood(sys.argv[1])

"""20,000 puts a second on ``drive`` for three seconds, by somebody without the lease, while another one drives.

Usage: python -m tests.bench.flood
"""

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
from tests.bench.processes import Empty, empty_loop, quantile

PUTS_PER_S: Final = 20_000
SECONDS: Final = 3.0
BURSTS_PER_S: Final = 500
HEALTH: Final = "fleet/cruiser-1/gateway/health"
KEY: Final = "fleet/cruiser-1/@cmd/stranger/drive"


class Flooded(msgspec.Struct, frozen=True):
    """What a flood does.

    Attributes:
        puts_per_s: the slowest flood that was really put.
        dropped: how many the gateway dropped unread, and so got.
        late_us: of every tick of the gateway, the quiet ones between two floods too, sorted.
        stop_us: from the put of a remote stop under the flood to the first frame with a lower speed, sorted.
        empty: of an empty loop meanwhile.
    """

    puts_per_s: float
    dropped: int
    late_us: list[float]
    stop_us: list[float]
    empty: Empty


def measure(floods: int = 10) -> Flooded:
    """So many floods, with one remote stop in the midst of each."""
    random = Random(0)  # noqa: S311 - to hit every place between two ticks
    stop_us: list[float] = []
    rates: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        probe = Path(folder) / "probe.json"
        command = ("-m", "tests.bench.gateway_probe", str(probe))
        with on_the_road(*command) as (driver, witness, endpoint, _), empty_loop() as empty:
            healths = driver.session.declare_subscriber(HEALTH, zenoh.handlers.RingChannel(1))
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
            dropped = msgspec.msgpack.decode(healths.recv().payload.to_bytes())["inbox_drops"]
        measured = json.loads(probe.read_text(encoding="utf-8"))
    late_us = sorted(late_ns / 1000 for late_ns in measured["late_ns"])
    return Flooded(min(rates), dropped, late_us, sorted(stop_us), empty)


def flood(endpoint: str) -> None:
    """Put, in bursts, from a process of its own; says when it begins, and how many a second it were."""
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


def main() -> None:
    """Measure and print."""
    measured = measure()
    late_us, stop_us = measured.late_us, measured.stop_us
    print(f"flood of {measured.puts_per_s:.0f} puts/s and more, {measured.dropped} dropped unread")
    print(f"lateness of {len(late_us)} ticks, us: p99 {quantile(late_us, 0.99):.0f}, worst {late_us[-1]:.0f}")
    print(f"{len(stop_us)} stops, us: p50 {quantile(stop_us, 0.5):.0f}, p99 {quantile(stop_us, 0.99):.0f}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        flood(sys.argv[1])
    else:
        main()

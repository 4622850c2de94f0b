"""A loop with the gateway's period and priority that only puts the time: the cost of the machine itself.

Usage: python -m tests.bench.empty_loop ENDPOINT FILE, until SIGTERM
"""

from __future__ import annotations

import gc
import json
import signal
import sys
import threading
import time
from pathlib import Path

import zenoh

from gateway.host.process import request_realtime
from schemas.settings import Settings
from schemas.zenoh_session import close_session, open_session

KEY = "bench/empty"
PERIOD_NS = 10_000_000


def main(endpoint: str, file: Path) -> None:
    """Tick and put until SIGTERM; then write the lateness of each tick in ns."""
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    settings = Settings()
    session = open_session(settings.zenoh, [], [endpoint])
    publisher = session.declare_publisher(KEY, congestion_control=zenoh.CongestionControl.DROP)
    late_ns: list[int] = []
    # As the gateway does: no collection falls into a tick.
    gc.freeze()
    gc.disable()
    request_realtime(settings.gateway.realtime_priority)
    sys.stderr.write("empty: ready\n")
    sys.stderr.flush()
    due_ns = time.monotonic_ns() + PERIOD_NS
    while not ended.is_set():
        now_ns = time.monotonic_ns()
        while now_ns < due_ns:
            time.sleep((due_ns - now_ns) / 1e9)
            now_ns = time.monotonic_ns()
        late_ns.append(now_ns - due_ns)
        publisher.put(time.time_ns().to_bytes(8, "big"))
        due_ns += PERIOD_NS * (1 + (now_ns - due_ns) // PERIOD_NS)
    file.write_text(json.dumps(late_ns), encoding="utf-8")
    close_session(session)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))

"""Many robots' states without gateways, from a process of its own: as much as a desk has to carry.

Usage: python -m tests.support.processes.robots ENDPOINT COUNT, until SIGTERM
"""

import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import msgspec
import zenoh

from schemas import codec, keys
from schemas.messages import Message
from schemas.settings import ZenohSettings
from schemas.subjects import BY_TYPE
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import HEALTH, ROOT, STANDBY, STATE

LEASE_MS = 10_000
"""A machine that is busy with all of them must not lose the link."""

PERIOD_S = 0.05
"""Of states; health comes once a second."""

SLOTS = 10
"""Parts of a period, in each of which a part of the robots publishes: they do not all speak at once."""

ROUNDS = 40
"""Different states, one after the other: two seconds, after which they come again."""


def name_of(number: int) -> str:
    return f"robot-{number:04}"


def main(endpoint: str, count: int) -> None:
    """Publish at the endpoint until SIGTERM. All robots do the same, each at another place of the two seconds."""
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    session = open_session(ZenohSettings(lease_ms=LEASE_MS), [], [endpoint])
    tokens = [session.liveliness().declare_token(keys.liveliness(ROOT, name_of(one))) for one in range(count)]
    puts = {
        kind: [_publisher(session, name_of(one), kind) for one in range(count)]
        for kind in (type(STATE), type(STANDBY), type(HEALTH))
    }
    states = [
        codec.encode(msgspec.structs.replace(STATE, speed_mps=round(0.02 * number, 3), sequence=number))
        for number in range(ROUNDS)
    ]
    safeties = [codec.encode(msgspec.structs.replace(STANDBY, sequence=number)) for number in range(ROUNDS)]
    health = codec.encode(HEALTH)
    sys.stderr.write(f"robots: {count} at {endpoint}\n")
    sys.stderr.flush()
    due_s, step = time.monotonic(), 0
    while not ended.wait(max(0.0, due_s - time.monotonic())):
        period, slot = divmod(step, SLOTS)
        for one in range(slot, count, SLOTS):
            turn = (period + one) % ROUNDS
            puts[type(STATE)][one].put(states[turn])
            puts[type(STANDBY)][one].put(safeties[turn])
            if turn % round(1 / PERIOD_S) == 0:
                puts[type(HEALTH)][one].put(health)
        step += 1
        due_s += PERIOD_S / SLOTS
    del tokens
    close_session(session)


def _publisher(session: zenoh.Session, name: str, kind: type[Message]) -> zenoh.Publisher:
    subject = BY_TYPE[kind]
    key = keys.build(ROOT, name, subject)
    return session.declare_publisher(
        key, encoding=subject.encoding, congestion_control=zenoh.CongestionControl.DROP
    )


@contextmanager
def robots(count: int) -> Iterator[str]:
    """Robots that publish meanwhile. Yields their endpoint."""
    endpoint = free_endpoint()
    words = [sys.executable, "-m", "tests.support.processes.robots", endpoint, str(count)]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            assert re.match("robots: ", process.stderr.readline())
            yield endpoint
        finally:
            process.terminate()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))

"""Threads of one process that decode messages."""

import subprocess
import sys

RACE = """
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
import msgspec
from schemas.codec import decode, encode

sys.setswitchinterval(1e-6)
payload = {}
for _ in range(9):
    payload = {"inner": [payload], "more": None}
payload = msgspec.msgpack.encode(payload)
for _ in range(40):
    kind = int
    for number in range(10):
        fields = [("inner", list[kind] | None, None), ("more", dict[str, kind] | None, None)]
        fields += [(f"f{at}", list[kind] | None, None) for at in range(8)]
        kind = msgspec.defstruct(f"Kind{number}", fields)
    begun = Barrier(4)

    def decoded(_):
        begun.wait()
        return decode(type("Subject", (), {"type": kind}), payload)

    with ThreadPoolExecutor(4) as threads:
        for found in threads.map(decoded, range(4)):
            assert isinstance(found, kind), found
"""


def test_threads_may_decode_a_type_for_the_first_time_at_once() -> None:
    """A process that talks to two robots does."""
    subprocess.run([sys.executable, "-c", RACE], check=True, timeout=60)

"""Somebody who may connect sends far more than any robot needs."""

import re
import socket
from contextlib import ExitStack
from pathlib import Path

import msgpack
import pytest
import zenoh

from schemas.settings import ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night
from tests.support.processes.gateway import chassis, gateway, run, wait_for_chassis
from tests.support.waiting import wait_until

IDLE = 150

HUGE_BYTES = 60_000_000
GROWS_BYTES = 30_000_000  # half of one such message


def peak_bytes(pid: int) -> int:
    found = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    assert found is not None
    return int(found[1]) * 1024


@pytest.mark.parametrize("verb", [by_night("drive"), by_night("engage"), "stop"])
def test_no_message_makes_the_gateway_hold_megabytes(verb: str) -> None:
    """Puts and queries of 60 MB are dropped on arrival; a stop after them is answered."""
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint) as running:
        session = open_session(ZenohSettings(mode="client"), [endpoint], [])
        stops = "fleet/cruiser-1/@cmd/stranger/stop"

        def is_answered() -> bool:
            replies = [reply.ok for reply in session.get(stops, timeout=5) if reply.ok is not None]
            return bool(replies) and msgpack.unpackb(replies[0].payload.to_bytes())["ok"]

        wait_until(is_answered)
        before = peak_bytes(running.process.pid)
        huge, key = bytes(HUGE_BYTES), f"fleet/cruiser-1/@cmd/stranger/{verb}"
        for _ in range(2):
            session.put(key, huge, congestion_control=zenoh.CongestionControl.BLOCK)
            assert [reply for reply in session.get(key, payload=huge, timeout=2) if reply.ok is not None] == []
        wait_until(is_answered)
        assert peak_bytes(running.process.pid) - before < GROWS_BYTES
        close_session(session)
        assert running.stop() == 0


def test_connections_that_say_nothing_keep_no_stop_out() -> None:
    """More than Zenoh's default of 100, which would delay everybody else for 10 s."""
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint), ExitStack() as stack:
        wait_for_chassis(endpoint)
        host, _, port = endpoint.removeprefix("tcp/").partition(":")
        for _ in range(IDLE):
            stack.enter_context(socket.create_connection((host, int(port))))
        done = run(["stop", "cruiser-1", "--connect", endpoint, "--timeout", "8"])
        assert (done.returncode, done.stderr) == (0, "")


def test_no_memory_is_shared_with_who_connects() -> None:
    """A peer that shares memory could crash the gateway by truncating it."""
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint) as running:
        wait_for_chassis(endpoint)
        assert ".zenoh" not in Path(f"/proc/{running.process.pid}/maps").read_text()

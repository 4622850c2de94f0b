"""The Zenoh session settings that every process of ours shares. Pure: it builds a mapping, it opens nothing.

Multicast scouting is off and gossip is on: nodes find each other through those they are connected to. A lease
of 1 s and a fast reconnection keep a stalled link from delivering old samples in a burst.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

from schemas.printable import plain
from schemas.settings import ZenohSettings

RECONNECT_MIN_MS: Final = 100
RECONNECT_MAX_MS: Final = 500

OPEN_TIMEOUT_MS: Final = 2000
"""Who accepts a connection and then says nothing for this long does not speak Zenoh."""

QUEUE_BATCHES: Final = 8
"""Batches of 64 KiB that may wait on a link for each priority. A put never waits for room, it drops."""

ANY_LOCAL_PORT: Final = "tcp/127.0.0.1:0"

Json = dict[str, "Json"] | list["Json"] | str | int | float | bool | None


MODE: Final = "mode"
LEASE: Final = "transport/link/tx/lease"
CONNECT: Final = "connect/endpoints"
LISTEN: Final = "listen/endpoints"
MULTICAST: Final = "scouting/multicast/enabled"

Says = Callable[[str], bool]
"""Whether a Zenoh configuration file says anything of its own at a path."""


def nothing_said(_path: str) -> bool:
    """There is no Zenoh configuration file."""
    return False


def session_settings(
    zenoh: ZenohSettings, connect: list[str], listen: list[str], says: Says = nothing_said
) -> dict[str, Json]:
    """What to set over the user's Zenoh configuration file, or over Zenoh's start values.

    What the file says holds, unless a setting of ours says it too: endpoints that are given here, and a mode or
    a lease that a source of the settings gave.

    Args:
        zenoh: the settings; its own ``connect`` and ``listen`` are not read here.
        connect: endpoints to connect to; retried for ever, in the background.
        listen: endpoints to listen on; failing to is an error at once.
        says: what the file says.

    Returns:
        Values by their path in Zenoh's configuration, ``scouting/multicast/enabled``.
    """
    given = {
        MODE: "mode" in zenoh.given,
        LEASE: "lease_ms" in zenoh.given,
        CONNECT: bool(connect),
        LISTEN: bool(listen),
    }
    entries = _entries(zenoh, connect, listen)
    return {path: value for path, value in entries.items() if given.get(path) or not says(path)}


def reason(message: str) -> str:
    """What a message of Zenoh says, in one line, without the places in Zenoh's own source."""
    text = " ".join(re.sub(r" at /\S+?\.rs:\d+\.?", "", message).split())
    nested = re.search(r'msg: "([^"]*)', text)
    return plain(nested[1] if nested else text).strip()


def _entries(zenoh: ZenohSettings, connect: list[str], listen: list[str]) -> dict[str, Json]:
    return {
        MODE: zenoh.mode,
        CONNECT: list(connect),
        # By mode, whoever says which it is.
        "connect/timeout_ms": {"router": -1, "peer": -1, "client": 0},
        "connect/exit_on_failure": {"router": False, "peer": False, "client": True},
        "connect/retry": {
            "period_init_ms": RECONNECT_MIN_MS,
            "period_max_ms": RECONNECT_MAX_MS,
            "period_increase_factor": 2,
        },
        LISTEN: list(listen),
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        MULTICAST: False,
        "scouting/gossip/enabled": True,
        "transport/unicast/open_timeout": OPEN_TIMEOUT_MS,
        LEASE: zenoh.lease_ms,
        "transport/link/tx/keep_alive": 4,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
        # Zenoh's own one batch drops a command whenever the one before it is still being sent.
        "transport/link/tx/queue/size/interactive_high": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data_high": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data_low": QUEUE_BATCHES,
        "transport/link/tx/queue/size/background": QUEUE_BATCHES,
        "timestamping/enabled": True,
    }

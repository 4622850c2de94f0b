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

    The file keeps its endpoints where none are given here, and its own word on multicast.

    Args:
        zenoh: the settings; its own ``connect`` and ``listen`` are not read here.
        connect: endpoints to connect to; retried for ever, in the background.
        listen: endpoints to listen on; failing to is an error at once.
        says: what the file says.

    Returns:
        Values by their path in Zenoh's configuration, ``scouting/multicast/enabled``.
    """
    entries = _entries(zenoh, connect, listen)
    for path, is_given in ((CONNECT, bool(connect)), (LISTEN, bool(listen)), (MULTICAST, False)):
        if not is_given and says(path):
            del entries[path]
    return entries


def reason(message: str) -> str:
    """What a message of Zenoh says, in one line, without the places in Zenoh's own source."""
    text = " ".join(re.sub(r" at /\S+?\.rs:\d+\.?", "", message).split())
    nested = re.search(r'msg: "([^"]*)', text)
    return plain(nested[1] if nested else text).strip()


def _entries(zenoh: ZenohSettings, connect: list[str], listen: list[str]) -> dict[str, Json]:
    return {
        "mode": zenoh.mode,
        CONNECT: list(connect),
        "connect/timeout_ms": -1 if zenoh.mode == "peer" else 0,
        "connect/exit_on_failure": zenoh.mode == "client",
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
        "transport/link/tx/lease": zenoh.lease_ms,
        "transport/link/tx/keep_alive": 4,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
        "transport/link/tx/queue/size/data_high": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data_low": QUEUE_BATCHES,
        "transport/link/tx/queue/size/background": QUEUE_BATCHES,
        "timestamping/enabled": True,
    }

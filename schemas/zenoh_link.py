"""The Zenoh session settings that every process of ours shares. Pure: it builds a mapping, it opens nothing.

Multicast scouting is off and gossip is on: nodes find each other through those they are connected to. A lease
of 1 s and a fast reconnection keep a stalled link from delivering old samples in a burst.
"""

from __future__ import annotations

from typing import Final

from schemas.settings import ZenohSettings

RECONNECT_MIN_MS: Final = 100
RECONNECT_MAX_MS: Final = 500
QUEUE_BATCHES: Final = 8
"""Batches of 64 KiB that may wait on a link for each priority. A put never waits for room, it drops."""

ANY_LOCAL_PORT: Final = "tcp/127.0.0.1:0"

Json = dict[str, "Json"] | list["Json"] | str | int | float | bool | None


def session_settings(zenoh: ZenohSettings, connect: list[str], listen: list[str]) -> dict[str, Json]:
    """Zenoh configuration entries, by their path in Zenoh's configuration (``scouting/multicast/enabled``).

    Args:
        zenoh: the settings; its own ``connect`` and ``listen`` are not read here.
        connect: endpoints to connect to; retried for ever, in the background.
        listen: endpoints to listen on; failing to is an error at once.
    """
    return {
        "mode": zenoh.mode,
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1 if zenoh.mode == "peer" else 0,
        "connect/exit_on_failure": zenoh.mode == "client",
        "connect/retry": {
            "period_init_ms": RECONNECT_MIN_MS,
            "period_max_ms": RECONNECT_MAX_MS,
            "period_increase_factor": 2,
        },
        "listen/endpoints": list(listen),
        "listen/timeout_ms": 0,
        "listen/exit_on_failure": True,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "transport/link/tx/lease": zenoh.lease_ms,
        "transport/link/tx/keep_alive": 4,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
        "transport/link/tx/queue/size/data_high": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data_low": QUEUE_BATCHES,
        "transport/link/tx/queue/size/background": QUEUE_BATCHES,
        "timestamping/enabled": True,
    }

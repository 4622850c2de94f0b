"""A router-mode session, from the file that ``cruiser provision router`` made: where nodes meet."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import zenoh

from schemas.command_line import CommandError, ExitCode, plain
from schemas.zenoh_session import (
    LISTEN,
    MODE,
    MULTICAST,
    base_configuration,
    enter,
    is_loopback,
    open_configured,
)

ROUTER: Final = "router"


def open_router(file: Path, listen: list[str]) -> tuple[zenoh.Session, list[str]]:
    """Open a session that routes. Returns it, and the endpoints that it listens on.

    Args:
        file: a Zenoh configuration.
        listen: endpoints to listen on instead of those of the file; those of the file if it is empty.

    Raises:
        CommandError: the file is wrong, or names no endpoint to listen on, or one that cannot be used.
    """
    config = base_configuration(str(file))
    if json.loads(config.get_json(MODE)) != ROUTER:
        raise CommandError(
            f"{plain(str(file))} is not a router's: 'cruiser provision router' makes one", ExitCode.USAGE
        )
    enter(config, {MULTICAST: False})
    if listen:
        enter(config, {LISTEN: [*listen]})
    endpoints = json.loads(config.get_json(LISTEN))
    if not isinstance(endpoints, list) or not endpoints:
        raise CommandError(f"{plain(str(file))} does not say where to listen: --listen says it", ExitCode.USAGE)
    return open_configured(config, str(file)), list(map(str, endpoints))


def open_local_router(endpoint: str) -> zenoh.Session:
    """Open a router for this machine alone: without keys, for virtual robots.

    Raises:
        CommandError: the endpoint can be reached from other machines, is taken, or is none.
    """
    if not is_loopback(endpoint):
        # Behind a router a gateway does not see who commands it, and from where.
        raise CommandError(
            f"{plain(endpoint)} can be reached from other machines: virtual robots have no keys; "
            "give one of 127.0.0.1",
            ExitCode.USAGE,
        )
    config = base_configuration("")
    enter(config, {MODE: ROUTER, LISTEN: [endpoint], MULTICAST: False})
    return open_configured(config)

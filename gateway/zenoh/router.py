"""A router-mode session, from the file that ``cruiser provision router`` made: where nodes meet."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import zenoh

from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.zenoh_link import LISTEN, MODE, MULTICAST, is_loopback, reason

ROUTER: Final = "router"


def open_router(file: Path, listen: list[str]) -> tuple[zenoh.Session, list[str]]:
    """Open a session that routes. Returns it, and the endpoints that it listens on.

    Args:
        file: a Zenoh configuration.
        listen: endpoints to listen on instead of those of the file; those of the file if it is empty.

    Raises:
        CommandError: the file is wrong, or names no endpoint to listen on, or one that cannot be used.
    """
    config = _read(file)
    if json.loads(config.get_json(MODE)) != ROUTER:
        raise CommandError(
            f"{plain(str(file))} is not a router's: 'cruiser provision router' makes one", ExitCode.USAGE
        )
    try:
        if listen:
            config.insert_json5(LISTEN, json.dumps(listen))
        config.insert_json5(MULTICAST, "false")
    except zenoh.ZError as error:
        shown = plain(", ".join(listen))
        raise CommandError(f"cannot listen on {shown}: {reason(str(error))}", ExitCode.USAGE) from error
    endpoints = json.loads(config.get_json(LISTEN))
    if not isinstance(endpoints, list) or not endpoints:
        raise CommandError(f"{plain(str(file))} does not say where to listen: --listen says it", ExitCode.USAGE)
    return _open(config), list(map(str, endpoints))


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
    config = zenoh.Config()
    try:
        for path, value in ((MODE, ROUTER), (LISTEN, [endpoint]), (MULTICAST, False)):
            config.insert_json5(path, json.dumps(value))
    except zenoh.ZError as error:
        raise CommandError(f"cannot listen on {plain(endpoint)}: {reason(str(error))}", ExitCode.USAGE) from error
    return _open(config)


def _open(config: zenoh.Config) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise CommandError(f"cannot open Zenoh: {reason(str(error))}", ExitCode.UNREACHABLE) from error


def _read(file: Path) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        raise CommandError(
            f"Zenoh configuration file {plain(str(file))}: {reason(str(error))}", ExitCode.USAGE
        ) from error

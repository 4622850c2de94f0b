"""A router-mode session, from the file that ``cruiser provision router`` made: where nodes meet."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

import zenoh

from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.zenoh_link import LISTEN, MODE, MULTICAST, reason

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
    try:
        return zenoh.open(config), list(map(str, endpoints))
    except zenoh.ZError as error:
        raise CommandError(f"cannot open Zenoh: {reason(str(error))}", ExitCode.UNREACHABLE) from error


def _read(file: Path) -> zenoh.Config:
    try:
        return zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        raise CommandError(
            f"Zenoh configuration file {plain(str(file))}: {reason(str(error))}", ExitCode.USAGE
        ) from error

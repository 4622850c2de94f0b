"""A service whose session does not open: it logs the cause once, and waits for its router or new certificates.

Otherwise systemd would restart it each second, and each start takes seconds of the processor. A command that was
started by hand ends with the cause; a container engine has its own restarts.
"""

from __future__ import annotations

import argparse
import logging
import os
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Final

from gateway.host.process import ServiceManager
from schemas.command_line import CommandError
from schemas.settings import ZenohSettings
from schemas.zenoh_session import MODE, SessionError, client_endpoints, close_session, open_session

log = logging.getLogger(__name__)

# commands that run as long as their machine
SERVICES: Final = frozenset({"gateway", "router", "record", "desk", "metrics"})

LOOK_S: Final = 1.0  # period of looking at certificates and router, well below the watchdog's time

POLL_S: Final = 0.1


def is_service(name: str, arguments: argparse.Namespace) -> bool:
    """Return True if the command runs until it is stopped. ``record`` with an action does not."""
    return name in SERVICES and getattr(arguments, "action", None) is None


def check_session_files(file: Path) -> None:
    """Check certificates and keys of a Zenoh file before a session opens; warn if one ends soon."""
    if fault := why_shut_out(str(file)):
        raise SessionError("cannot open Zenoh", fault, str(file))
    from gateway.provisioning.key_files import check_tls_files  # noqa: PLC0415 - loaded for a Zenoh file alone

    if warning := check_tls_files(file, file.stem, time.time()):
        log.warning("%s", warning)


def why_shut_out(config: str) -> str:
    """Return why the certificates and keys of a Zenoh file are not accepted; empty if they are."""
    if not config:
        return ""
    # Loaded for a Zenoh file alone; the settings have loaded it then, before any robot was driven.
    from gateway.provisioning import key_files  # noqa: PLC0415

    return key_files.why_shut_out(Path(config), time.time())


def why_away(error: SessionError) -> str:
    """Return the cause of a failed session that a later attempt may cure: files or router; else empty."""
    return why_shut_out(error.config) or (str(error) if error.is_unanswered else "")


def has_waited(error: CommandError, zenoh: ZenohSettings, ends: Callable[[], bool]) -> bool:
    """Wait until the session opens, or the end. False at once if waiting is useless, or without systemd."""
    manager = ServiceManager.of(os.environ)
    if manager is None or not isinstance(error, SessionError):
        return False
    failed: SessionError | None = error
    has_said = False
    with closing(manager):
        while failed is not None and (cause := why_away(failed)) and not ends():
            if not has_said:
                log.error("%s; off the network until then", cause)
            has_said = True
            # "standby": nothing is driven, and the package may be replaced.
            manager.alive(f"standby, off the network: {cause}")
            wait(LOOK_S, ends)
            failed = _again(failed, zenoh)
        if has_said:
            manager.alive("")
    return has_said


def _again(error: SessionError, zenoh: ZenohSettings) -> SessionError | None:
    """Retry a session that no router answered."""
    if why_shut_out(error.config) or not error.is_unanswered:
        return error
    try:
        close_session(open_session(zenoh, client_endpoints(zenoh), [], changes={MODE: "client"}))
    except SessionError as failed:
        return failed
    return None


def wait(time_s: float, ends: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + time_s
    while time.monotonic() < deadline_s and not ends():
        time.sleep(POLL_S)

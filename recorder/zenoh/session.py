"""Opens Zenoh sessions as the settings say, and matches keys as Zenoh does."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Sequence
from typing import Final

import msgspec
import zenoh

from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import DEFAULT_ENDPOINT, ZenohSettings
from schemas.zenoh_link import (
    ANY_LOCAL_PORT,
    GOSSIP,
    PROTOCOLS,
    Json,
    SessionError,
    ZenohChoice,
    allows,
    finds_router,
    is_loopback,
    next_ports,
    reason,
    said,
    session_settings,
    with_port,
)

BATCH_SIZE: Final = "transport/link/tx/batch_size"

CERTIFICATE: Final = "transport/link/tls/connect_certificate"

BATCH_BYTES: Final = 16_384
"""The links' batches, both ways. A sample that waits keeps all of the batch in memory that it came in: with
Zenoh's own 64 KiB a recorder of 300 robots grew to 1.4 GB. Less would leave senders too little for a stall."""


def open_session(settings: ZenohSettings, listen: Sequence[str] = (), *, is_apart: bool = False) -> zenoh.Session:
    """A session; it connects in the background.

    A Zenoh router passes nothing from one peer to another (measured with 1.10.2): a session that listens on
    nothing and finds a router becomes its client, unless the settings say which mode it is to be.

    Args:
        settings: of the session.
        listen: the endpoints to listen on; none if it is empty.
        is_apart: it connects to nobody of itself, and no node that connects to it is told of another.

    Raises:
        CommandError: the settings are wrong, or it cannot be opened.
    """
    session = _open(_configuration(settings, listen, is_apart=is_apart), listen, settings.config)
    mode, _, _, is_given = said_of(settings)
    if listen or mode != "peer" or is_given or not finds_router(session.info, time.sleep):
        return session
    session.close()
    client = msgspec.structs.replace(settings, mode="client", given=settings.given | {"mode"})
    return _open(_configuration(client), (), settings.config)


def _open(config: zenoh.Config, listen: Sequence[str], config_file: str) -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        on = f", listening on {', '.join(listen)}" if listen else ""
        raise SessionError(f"cannot join Zenoh{on}", str(error), config_file) from error


def key_matches(expression: str, topic: str) -> bool:
    """True if a Zenoh key expression matches a topic. False of what is no key expression."""
    try:
        return zenoh.KeyExpr.autocanonize(expression).includes(zenoh.KeyExpr(topic))
    except zenoh.ZError:
        return expression == topic


def said_of(settings: ZenohSettings) -> ZenohChoice:
    """Return a session's mode and endpoints; without any it connects to this machine's gateway.

    Raises:
        CommandError: the settings are wrong.
    """
    file = _File(settings)
    found = said(settings, file.says)
    return found._replace(connect=found.connect or [DEFAULT_ENDPOINT])


def listens_only(settings: ZenohSettings) -> bool:
    """Return True if the settings say where to listen, and nowhere to connect.

    Raises:
        CommandError: the settings are wrong.
    """
    found = said(settings, _File(settings).says)
    return bool(found.listen) and not found.connect


def local_port(settings: ZenohSettings) -> list[str]:
    """A free port of this machine's loopback address, for others on it, where nothing is said of listening.

    None for a client, for who connects to another machine, and where the protocols do not allow it.

    Raises:
        CommandError: the settings are wrong.
    """
    mode, connect, *_ = said_of(settings)
    allowed = allows(_File(settings).says(PROTOCOLS), ANY_LOCAL_PORT)
    if mode == "client" or not allowed or not all(map(is_loopback, connect)):
        return []
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return [with_port(ANY_LOCAL_PORT, probe.getsockname()[1])]


def listen_beside(settings: ZenohSettings) -> list[str]:
    """Return the endpoints of a session beside the first: one port on from the settings', or see ``local_port``.

    Raises:
        CommandError: the settings are wrong.
    """
    try:
        return next_ports(said_of(settings).listen) or local_port(settings)
    except ValueError as error:
        raise CommandError(f"wrong Zenoh settings: to listen on: {error}", ExitCode.USAGE) from error


def certificate_file(settings: ZenohSettings) -> str:
    """The file of the certificate that a session connects with; empty if there is none.

    Raises:
        CommandError: the settings are wrong.
    """
    return str(_File(settings).says(CERTIFICATE) or "")


class _File:
    """The configuration file, if one is set, or else Zenoh's start values."""

    def __init__(self, settings: ZenohSettings) -> None:
        try:
            self.config = zenoh.Config.from_file(settings.config) if settings.config else zenoh.Config()
        except zenoh.ZError as error:
            raise CommandError(f"wrong Zenoh settings: {reason(str(error))}", ExitCode.USAGE) from error

    def says(self, path: str) -> Json:
        """Return the file's own value at a path; None if it sets none."""
        value: Json = json.loads(self.config.get_json(path))
        return None if value == json.loads(zenoh.Config().get_json(path)) else value


def _configuration(settings: ZenohSettings, listen: Sequence[str] = (), *, is_apart: bool = False) -> zenoh.Config:
    """The configuration file, if one is set, with our settings over it."""
    file = _File(settings)
    connect = [] if is_apart else said_of(settings).connect
    ours = session_settings(settings, connect, listen, lambda path: file.says(path) is not None)
    if file.says(BATCH_SIZE) is None:
        ours[BATCH_SIZE] = BATCH_BYTES
    if is_apart:
        ours[GOSSIP] = False
    try:
        for path, value in ours.items():
            file.config.insert_json5(path, json.dumps(value))
    except zenoh.ZError as error:
        raise CommandError(f"wrong Zenoh settings: {reason(str(error))}", ExitCode.USAGE) from error
    return file.config

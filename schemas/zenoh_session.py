"""Configure, open and close Zenoh sessions; no other module does.

Multicast scouting is off and gossip is on: nodes find each other through nodes that they are connected to. A lease
of 1 s and fast reconnection prevent a stalled link from delivering old samples in a burst.
"""

from __future__ import annotations

import json
import logging
import re
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple, Protocol

import msgspec
import zenoh

from schemas.command_line import CommandError, ExitCode, UsageError, plain
from schemas.settings import DEFAULT_ENDPOINT, ZenohSettings

log = logging.getLogger(__name__)

RECONNECT_MIN_MS: Final = 100
RECONNECT_MAX_MS: Final = 500

SCOUTING_MS: Final = 50
"""Longest wait of an opening session for the nodes that it connects to.

Zenoh's default is 500 ms, which Zenoh 1.10 often uses up although all nodes are connected: it misses initial
declarations that precede the connection's registration. Slower nodes connect later; ``finds_router`` waits for
them.
"""

OPEN_TIMEOUT_MS: Final = 2000  # time for a new connection's handshake
ACCEPT_PENDING: Final = 500  # most connections during their handshake
ROUTER_LOOKS: Final = 50
LOOK_EVERY_S: Final = 0.01  # with ROUTER_LOOKS: half a second for a router to connect
QUEUE_BATCHES: Final = 8  # batches of 64 KiB in a link's queue of each priority; a put to a full queue is dropped

ANY_LOCAL_PORT: Final = "tcp/127.0.0.1:0"

WITH_NAMES: Final = ("tls", "quic")  # protocols whose certificates carry the listener's name

_ENDPOINT: Final = re.compile(
    r"(?P<protocol>[a-z0-9_-]+)/(?P<host>[^?#]*):(?P<port>[0-9]+)(?P<metadata>[?][^#]*)?(?P<options>#.*)?"
)
_LOOPBACK: Final = re.compile(r"localhost|\[::1\]|127(\.[0-9]+){3}")
_NOT_CONNECTED: Final = re.compile(r"Single\(([^)]*)\)")
_HIGHEST_PORT: Final = 65535

Json = dict[str, "Json"] | list["Json"] | str | int | float | bool | None


MODE: Final = "mode"
LEASE: Final = "transport/link/tx/lease"
CONNECT: Final = "connect/endpoints"
LISTEN: Final = "listen/endpoints"
MULTICAST: Final = "scouting/multicast/enabled"
GOSSIP: Final = "scouting/gossip/enabled"
SCOUTING: Final = "scouting/delay"
CONNECT_TIMEOUT: Final = "connect/timeout_ms"
PROTOCOLS: Final = "transport/link/protocols"

Says = Callable[[str], bool]
"""A test of a path: True if the Zenoh configuration file sets a value of its own there."""


def session_settings(
    settings: ZenohSettings,
    connect: Sequence[str],
    listen: Sequence[str],
    says: Says = lambda _path: False,
    own: Mapping[str, Json] | None = None,
) -> dict[str, Json]:
    """Return our values for Zenoh's configuration, by path (``scouting/multicast/enabled``).

    A value in the user's file takes precedence, except over endpoints to connect to that are given here, a mode or
    lease that is set, and the endpoints to listen on.

    Args:
        settings: their ``connect`` and ``listen`` are not used.
        connect: endpoints to connect to, retried for ever in the background.
        own: further values for this kind of session.
    """
    given = {
        MODE: "mode" in settings.given,
        LEASE: "lease_ms" in settings.given,
        CONNECT: bool(connect),
        LISTEN: True,
    }
    entries: dict[str, Json] = {
        MODE: settings.mode,
        CONNECT: list(connect),
        # For each mode, since the file may set it.
        CONNECT_TIMEOUT: {"router": -1, "peer": -1, "client": 0},
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
        GOSSIP: True,
        SCOUTING: SCOUTING_MS,
        "transport/unicast/open_timeout": OPEN_TIMEOUT_MS,
        "transport/unicast/accept_timeout": OPEN_TIMEOUT_MS,
        "transport/unicast/accept_pending": ACCEPT_PENDING,
        # A process that shares memory with another can fill it, and can kill the other by truncating it.
        "transport/shared_memory/enabled": False,
        LEASE: settings.lease_ms,
        "transport/link/tx/keep_alive": 4,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 0,
        # With Zenoh's default of one batch, a command is dropped while the one before it is being sent.
        "transport/link/tx/queue/size/interactive_high": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data_high": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data": QUEUE_BATCHES,
        "transport/link/tx/queue/size/data_low": QUEUE_BATCHES,
        "transport/link/tx/queue/size/background": QUEUE_BATCHES,
        "timestamping/enabled": True,
        **(own or {}),
    }
    return {path: value for path, value in entries.items() if given.get(path) or not says(path)}


class ZenohChoice(NamedTuple):
    """A session's mode and endpoints, from the settings or else from a Zenoh configuration file."""

    mode: str
    connect: list[str]
    listen: list[str]
    is_mode_given: bool = False


def said(settings: ZenohSettings, of_file: Callable[[str], Json]) -> ZenohChoice:
    """Return a session's mode and endpoints; a client listens on nothing.

    Args:
        of_file: returns the file's value at a path; None for none, or for Zenoh's default.
    """
    files = of_file(MODE)
    mode = settings.mode if "mode" in settings.given or files is None else str(files)
    connect = list(settings.connect) or _endpoints(of_file(CONNECT), mode)
    listen = list(settings.listen) or _endpoints(of_file(LISTEN), mode)
    is_given = "mode" in settings.given or files is not None
    return ZenohChoice(mode, connect, [] if mode == "client" else listen, is_given)


class Connected(Protocol):
    """The nodes that a session is connected to, as Zenoh names them."""

    def peers_zid(self) -> Sequence[object]: ...
    def routers_zid(self) -> Sequence[object]: ...


def finds_router(connected: Connected, pause: Callable[[float], None]) -> bool:
    """Return True if the first connected node is a router. False if none connects in half a second."""
    for _ in range(ROUTER_LOOKS):
        if connected.peers_zid():
            return False
        if connected.routers_zid():
            return True
        pause(LOOK_EVERY_S)
    return False


def split_endpoint(endpoint: str) -> tuple[str, str, int]:
    parts = _parts(endpoint)
    return parts["protocol"], parts["host"], int(parts["port"])


def with_port(endpoint: str, port: int) -> str:
    parts = _parts(endpoint)
    if port > _HIGHEST_PORT:
        raise ValueError(f"{endpoint} has the last port, so no other is next to it")
    return f"{endpoint[: parts.start('port')]}{port}{endpoint[parts.end('port') :]}"


def next_ports(listen: list[str]) -> list[str]:
    """Return endpoints for a second session: the same addresses with the next port; port 0 stays."""
    ports = [(one, split_endpoint(one)[2]) for one in listen]
    return [with_port(one, port + 1 if port else 0) for one, port in ports]


def with_command_ports(connect: Sequence[str]) -> list[str]:
    """Return endpoints of gateways, and after them those at which they listen for commands: the next ports.

    Zenoh connects to a node that another one names, but never again once that link alone broke (measured with
    1.10.2). It reconnects to an endpoint of the configuration. An endpoint that has to answer gets none beside it.
    """
    parts = [(one, _ENDPOINT.fullmatch(one)) for one in connect if "exit_on_failure" not in one]
    ports = [(one, int(found["port"]) + 1) for one, found in parts if found is not None]
    beside = [with_port(one, port) for one, port in ports if port <= _HIGHEST_PORT]
    return list(dict.fromkeys([*connect, *beside]))


def own_endpoint(listen: str) -> str:
    """The endpoint by which another session of this process connects to an endpoint that is listened on.

    Certificates are verified, but need not contain the name of the process's own address.
    """
    parts = _ENDPOINT.fullmatch(listen)
    if parts is None:
        return listen
    host = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}.get(parts["host"], parts["host"])  # noqa: S104
    options = "#verify_name_on_connect=false" if parts["protocol"] in WITH_NAMES else ""
    return f"{parts['protocol']}/{host}:{parts['port']}{parts['metadata'] or ''}{options}"


def is_loopback(endpoint: str) -> bool:
    host = endpoint.partition("/")[2].rpartition(":")[0]
    return endpoint.startswith("unix") or bool(_LOOPBACK.fullmatch(host))


def reason(message: str) -> str:
    """Return the cause in a Zenoh error message, in one line, without places in Zenoh's source."""
    text = " ".join(re.sub(r" at /\S+?\.rs:\d+\.?", "", message).split())
    nested = re.search(r'msg: "([^"]*)', text)
    return plain(nested[1] if nested else text).strip()


class SessionError(CommandError):
    """A session that could not be opened. For certificates and keys Zenoh's error names no file and no cause.

    Attributes:
        config: the Zenoh file of the session; empty without one.
        is_unanswered: no node accepted the connection.
    """

    def __init__(self, what: str, message: str, config: str = "") -> None:
        super().__init__(f"{what}: {_nobody(reason(message))}", ExitCode.UNREACHABLE)
        self.config = config
        self.is_unanswered = bool(_places(message))


def open_session(
    settings: ZenohSettings,
    connect: Sequence[str],
    listen: Sequence[str],
    *,
    own: Mapping[str, Json] | None = None,
    changes: Mapping[str, Json] | None = None,
) -> zenoh.Session:
    """Open a session. A peer's session opens without any connection, and keeps trying in the background.

    Args:
        settings: their ``connect`` and ``listen`` are not used.
        connect: endpoints to connect to; if empty, those of the Zenoh configuration file.
        own: values for this kind of session, by path, where the file sets none.
        changes: values by path that override all others.
    """
    config = _configuration(settings, connect, listen, own)
    enter(config, changes or {})
    return open_configured(config, settings.config)


def join(
    settings: ZenohSettings,
    listen: Sequence[str] = (),
    *,
    own: Mapping[str, Json] | None = None,
    commands: bool = False,
) -> zenoh.Session:
    """Open a session that connects to the endpoints in the settings, or else to this machine's gateway.

    A Zenoh router forwards nothing between peers (measured with 1.10.2): a session that listens on nothing and
    finds a router becomes its client, unless the settings give a mode.

    Args:
        commands: it sends commands for a long time: where it finds no router, it is opened again to connect to the
            endpoints at which gateways listen for them too.
    """
    endpoints, choice = client_endpoints(settings), said_of(settings)
    session = open_session(settings, endpoints, listen, own=own)
    may_change = choice.mode == "peer" and not choice.is_mode_given and not listen
    if choice.mode == "client" or not (may_change or commands):
        return session
    is_at_router = finds_router(session.info, time.sleep)
    if is_at_router and may_change:
        close_session(session)
        client = msgspec.structs.replace(settings, mode="client", given=settings.given | {"mode"})
        return open_session(client, endpoints, [], own=own)
    if is_at_router or not commands:
        return session
    close_session(session)
    try:
        return open_session(settings, with_command_ports(endpoints), listen, own=own)
    except CommandError:  # The Zenoh file wants every endpoint to answer.
        return open_session(settings, endpoints, listen, own=own)


def open_configured(config: zenoh.Config, file: str = "") -> zenoh.Session:
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise SessionError("cannot open Zenoh", str(error), file) from error


def close_session(session: zenoh.Session) -> None:
    """Close a session. Never raises."""
    try:
        session.close()
    except zenoh.ZError as error:  # The session is not used any more either way.
        log.debug("closing Zenoh: %s", error)


def is_connected(session: zenoh.Session) -> bool:
    """Return True if a Zenoh node is connected directly; a peer's session can be open without one."""
    return bool(session.info.peers_zid() or session.info.routers_zid())


def base_configuration(file: str) -> zenoh.Config:
    """Read the user's Zenoh file; without one, Zenoh's defaults."""
    if not file:
        return zenoh.Config()
    try:
        return zenoh.Config.from_file(file)
    except zenoh.ZError as error:
        raise UsageError(f"Zenoh configuration file {plain(file)!r}: {reason(str(error))}") from error


def enter(config: zenoh.Config, entries: Mapping[str, Json]) -> None:
    for path, value in entries.items():
        try:
            config.insert_json5(path, json.dumps(value))
        except zenoh.ZError as error:
            shown = plain(json.dumps(value))
            raise UsageError(f"Zenoh does not take {path} = {shown}: {reason(str(error))}") from error


def of_file(settings: ZenohSettings, path: str) -> Json:
    """Return the configuration file's value at a path; None for none, or for Zenoh's default."""
    return _said_at(base_configuration(settings.config), path)


def said_of(settings: ZenohSettings) -> ZenohChoice:
    """Return a session's mode and endpoints, from the settings or else from the Zenoh file."""
    config = base_configuration(settings.config)
    return said(settings, lambda path: _said_at(config, path))


def client_endpoints(settings: ZenohSettings) -> list[str]:
    """Return the endpoints to connect to, for any process but a gateway."""
    return said_of(settings).connect or [DEFAULT_ENDPOINT]


def place(settings: ZenohSettings) -> str:
    return ", ".join(map(plain, client_endpoints(settings)))


def is_allowed(settings: ZenohSettings, endpoint: str) -> bool:
    """Return True if the configuration file allows this endpoint's protocol."""
    protocols = of_file(settings, PROTOCOLS)
    return not isinstance(protocols, list) or endpoint.partition("/")[0] in protocols


def lease_in_force_ms(settings: ZenohSettings) -> int:
    """The lease of a session with these settings and their Zenoh file."""
    return int(json.loads(_configuration(settings, [], []).get_json(LEASE)))


def local_port(settings: ZenohSettings) -> list[str]:
    """A free port of the loopback address, for other processes on this machine.

    None for a client, for a session that connects to another machine, and where the protocols do not allow it.
    """
    is_local = all(map(is_loopback, client_endpoints(settings)))
    if said_of(settings).mode == "client" or not is_local or not is_allowed(settings, ANY_LOCAL_PORT):
        return []
    return with_free_ports([ANY_LOCAL_PORT])


def with_free_ports(listen: list[str]) -> list[str]:
    """The endpoints with a free port in place of port 0."""
    return [_with_free_port(one) if ":0" in one else one for one in listen]


def _with_free_port(endpoint: str) -> str:
    try:
        protocol, host, port = split_endpoint(endpoint)
    except ValueError:
        return endpoint
    if port:
        return endpoint
    kind = socket.SOCK_DGRAM if protocol in ("udp", "quic") else socket.SOCK_STREAM
    try:
        family, *_, address = socket.getaddrinfo(host.strip("[]"), 0, type=kind)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(address)
            return with_port(endpoint, probe.getsockname()[1])
    except OSError as error:
        raise CommandError(f"cannot listen on {plain(endpoint)}: {error}", ExitCode.UNREACHABLE) from error


def _configuration(
    settings: ZenohSettings,
    connect: Sequence[str],
    listen: Sequence[str],
    own: Mapping[str, Json] | None = None,
) -> zenoh.Config:
    config = base_configuration(settings.config)
    enter(
        config,
        session_settings(settings, connect, listen, lambda path: _said_at(config, path) is not None, own),
    )
    return config


def _said_at(config: zenoh.Config, path: str) -> Json:
    value: Json = json.loads(config.get_json(path))
    return None if value == json.loads(zenoh.Config().get_json(path)) else value


def _places(text: str) -> list[str]:
    return _NOT_CONNECTED.findall(text) if "Unable to connect" in text else []


def _nobody(text: str) -> str:
    """Explain an error in which no endpoint answered; else return it unchanged."""
    places = _places(text)
    if not places:
        return text
    where = ", ".join(places)
    if not any(place.startswith(WITH_NAMES) for place in places):
        return f"no answer from {where}: check the router or gateway there, and the network"
    return (
        f"no connection to {where}: check there whether a router runs, whether it belongs to this fleet, and its "
        "certificate"
    )


def _endpoints(value: Json, mode: str) -> list[str]:
    """One, a list, or one of these for each mode."""
    if isinstance(value, dict):
        value = value.get(mode)
    return [value] if isinstance(value, str) else list(map(str, value)) if isinstance(value, list) else []


def _parts(endpoint: str) -> re.Match[str]:
    parts = _ENDPOINT.fullmatch(endpoint)
    if parts is None:
        fault = "has no port" if "/" in endpoint else "is not an endpoint, such as tcp/127.0.0.1:7447"
        raise ValueError(f"{plain(endpoint)} {fault}")
    return parts

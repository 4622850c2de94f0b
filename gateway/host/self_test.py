"""The self-test of signed mode: what a stranger gets from the router, and from this robot.

Tries what must be denied: to get in without a certificate, and to do anything with one that has no right.

Zenoh denies without a word, so each deed is looked for at its other end.

The look of a gateway in signed mode at its own endpoints and Zenoh file, and the attempt to get past a router.

Zenoh's access control is silent where it is wrong: it lets everybody pass where a rule, a name or a switch is
missing. What the robot's own file says is looked at in each start. What a router lets through is tried on request
alone, by ``cruiser doctor --intrude``, for it puts messages on the robot's keys.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Self

import msgspec
import zenoh

from gateway.authority.enrolment import SHUT_OUT_FILE, TLS_KEY_FILE, TransportRole
from gateway.provisioning.key_files import check_shut_out
from gateway.zenoh.client import PendingQuery, SessionOwner
from schemas import keys
from schemas.authority.key_files import directory_of
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import Settings, ZenohSettings
from schemas.subjects import BY_NAME
from schemas.zenoh_session import (
    MODE,
    WITH_NAMES,
    Json,
    base_configuration,
    client_endpoints,
    close_session,
    is_loopback,
    open_session,
    own_endpoint,
    said_of,
)

ACCESS: Final = "access_control"
TLS: Final = "transport/link/tls"

SETTLE_S: Final = 1.0
"""The time in which a message that is not denied arrives, by way of a router."""

WAITING: Final = 64
"""Samples of a subscription that may wait; one is enough."""

ANSWER_TIMEOUT_S: Final = 0.5

_Declared = Any


class Attempt(msgspec.Struct, frozen=True):
    """An attempt by somebody without any right, at one endpoint.

    Attributes:
        is_connected: it has a link. Without one, nothing was tried.
        deeds: the attempts that were not denied, in words.
    """

    is_connected: bool
    deeds: list[str] = []


def access_of(settings: ZenohSettings) -> tuple[dict[str, Json], dict[str, Json]]:
    """The access control and the TLS of a gateway's sessions, as Zenoh reads them."""
    config = base_configuration(settings.config)
    access, tls = (msgspec.json.decode(config.get_json(path)) for path in (ACCESS, TLS))
    return access, tls


class Tripwires:
    """Subscribers and a queryable on a session of the robot's that would receive an intruder's messages.

    Attributes:
        operator: the name under which it is tried; nobody else has it.
    """

    def __init__(self, settings: Settings, session: zenoh.Session) -> None:
        """Subscribe on a session that has the robot's certificate."""
        self.operator = f"nobody-{secrets.token_hex(4)}"
        root, robot = settings.robot.root, settings.robot.name
        self.question = f"{root}/{robot}/gateway/{self.operator}"
        self._session = session
        commanded = keys.command(root, robot, self.operator, keys.ALL)
        state = keys.build(root, robot, BY_NAME["safety/state"])
        self._subscribers: list[_Declared] = [
            session.declare_subscriber(key, zenoh.handlers.RingChannel(WAITING)) for key in (commanded, state)
        ]
        self._queryable: _Declared = session.declare_queryable(commanded, zenoh.handlers.RingChannel(WAITING))

    def deeds(self) -> list[str]:
        """Return the messages that have arrived here, in words."""
        found: set[str] = set()
        for subscriber in self._subscribers:
            while (sample := subscriber.try_recv()) is not None:
                if sample.payload.to_bytes() == self.operator.encode():
                    found.add(f"a put on {sample.key_expr} arrives")
        while (query := self._queryable.try_recv()) is not None:
            with query:
                found.add(f"a query on {query.key_expr} arrives")
        return sorted(found)

    def ask(self) -> None:
        """Ask what the robot alone may answer; it does not."""
        self._session.get(self.question, PendingQuery().handler, timeout=ANSWER_TIMEOUT_S)

    def close(self) -> None:
        """Take them away."""
        with suppress(zenoh.ZError):
            for subscriber in self._subscribers:
                subscriber.undeclare()
            self._queryable.undeclare()


class Intruder(SessionOwner):
    """A node with a certificate of the role ``nothing``."""

    def __init__(self, session: zenoh.Session, settings: Settings, wires: Tripwires) -> None:
        """Declare what must not be declared, on a session that it then owns."""
        super().__init__(session)
        root, robot = settings.robot.root, settings.robot.name
        self._wires = wires
        self._drive, self._acquire = (
            keys.command(root, robot, wires.operator, verb) for verb in ("drive", "acquire")
        )
        self._state = keys.build(root, robot, BY_NAME["safety/state"])
        self._spies: list[_Declared] = [
            session.declare_subscriber(key, zenoh.handlers.RingChannel(WAITING))
            for key in (self._state, f"{root}/**")
        ]
        self._questions: _Declared = session.declare_queryable(
            wires.question, zenoh.handlers.RingChannel(WAITING), complete=True
        )

    @classmethod
    def open(cls, settings: Settings, endpoint: str, certificate: Path, key: Path, wires: Tripwires) -> Self:
        """Connect to an endpoint.

        Args:
            certificate: of the role ``nothing``.
        """
        changes: dict[str, Json] = {
            MODE: "client",
            f"{ACCESS}/enabled": False,
            f"{TLS}/connect_certificate": str(certificate),
            f"{TLS}/connect_private_key": str(key),
        }
        return cls(open_session(settings.zenoh, [endpoint], [], changes=changes), settings, wires)

    def act(self, pause: Callable[[float], object]) -> list[str]:
        """Attempt all that must be denied, and wait for its effects. Returns what was not denied, in words."""
        said = self._wires.operator.encode()
        for key in (self._drive, self._state):
            self._session.put(key, said)
        every = zenoh.QueryTarget.ALL
        self._session.get(self._acquire, PendingQuery().handler, target=every, payload=said, timeout=SETTLE_S)
        pause(SETTLE_S)
        deeds = self._wires.deeds()
        deeds += [f"a subscription to {spy.key_expr} receives" for spy in self._spies if self._receives(spy)]
        self._wires.ask()
        pause(ANSWER_TIMEOUT_S)
        if self._questions.try_recv() is not None:
            deeds.append(f"a query on {self._wires.question} comes to it")
        return deeds

    def _receives(self, spy: _Declared) -> bool:
        """Return True if it has received anything but its own."""
        own = self._wires.operator.encode()
        while (sample := spy.try_recv()) is not None:
            if sample.payload.to_bytes() != own:
                return True
        return False


def intrude(
    settings: Settings,
    endpoint: str,
    certificate: Path,
    key: Path,
    session: zenoh.Session,
    pause: Callable[[float], object],
) -> Attempt:
    """Try everything at an endpoint, with a certificate that has no right.

    Args:
        endpoint: a router's, or one of the gateway's own.
        certificate: of the role ``nothing``.
        pause: waits for so many seconds.
    """
    wires = Tripwires(settings, session)
    try:
        with Intruder.open(settings, endpoint, certificate, key, wires) as intruder:
            return Attempt(intruder.connected(), intruder.act(pause))
    except (CommandError, zenoh.ZError):
        return Attempt(is_connected=False)
    finally:
        wires.close()


def enters_without_certificate(settings: ZenohSettings, listener: str) -> str:
    """The endpoint at which somebody without a certificate gets a link to a listener; empty if nowhere.

    Args:
        settings: the gateway's; of its file, the network's authority alone is used.
        listener: the endpoint that it listens on with certificates.
    """
    own = own_endpoint(listener)
    plain = own.partition("/")[2].partition("#")[0]
    endpoints = [own] if own.startswith("quic") else [own, f"tcp/{plain}"]
    _, tls = access_of(settings)
    changes: dict[str, Json] = {MODE: "client", f"{TLS}/root_ca_certificate": tls.get("root_ca_certificate")}
    for endpoint in endpoints:
        try:
            with SessionOwner(open_session(ZenohSettings(), [endpoint], [], changes=changes)) as stranger:
                if stranger.connected():
                    return endpoint.partition("#")[0]
        except CommandError:
            continue
    return ""


def has_certificates(endpoint: str) -> bool:
    """Return True if it is of a protocol by which both ends show a certificate."""
    return endpoint.partition("/")[0] in WITH_NAMES


OPENING: Final = ("verify_name_on_connect=false", "enable_mtls=false")
"""Options of an endpoint by which any machine of the network passes for the router, or gets in."""

INSTALL: Final = "'cruiser provision install --replace' writes it"


class Reached(msgspec.Struct, frozen=True):
    """Where a gateway is reached.

    Attributes:
        connect: where it dials out to.
        listen: where it listens, for telemetry and for commands.
    """

    connect: list[str]
    listen: list[str]

    @property
    def is_secured(self) -> bool:
        """Does anything but this machine's own plain connections reach it?"""
        return any(has_certificates(one) or not is_loopback(one) for one in (*self.connect, *self.listen))


def own_fault(settings: Settings, place: Reached) -> str:
    """Return the first flaw of a gateway's own that lets in whom nobody named; empty if there is none.

    Where this machine alone reaches it, as in open mode, there is none: whoever commands it there signs.
    """
    return (_endpoint_fault(place) or _file_fault(settings)) if place.is_secured else ""


def _endpoint_fault(place: Reached) -> str:
    for endpoint in (*place.connect, *place.listen):
        if not has_certificates(endpoint) and not is_loopback(endpoint):
            return (
                f"{plain(endpoint)} is reached without a certificate: use tls/ or quic/, with the Zenoh file that "
                "'cruiser provision robot' and 'install' make"
            )
        for option in OPENING:
            if option in endpoint:
                return f"{plain(endpoint)} lets anybody pass: leave out {option}"
    return ""


def _file_fault(settings: Settings) -> str:
    file = settings.zenoh.config
    if not file:
        return "zenoh.config is not set: 'cruiser provision robot' and 'install' make robot.json5"
    try:
        fault = access_fault(*access_of(settings.zenoh))
    except CommandError as error:
        return str(error)
    return f"{plain(file)}: {fault}; {INSTALL}" if fault else ""


def access_fault(access: dict[str, Json], tls: dict[str, Json]) -> str:
    """Return the first flaw that lets anybody pass a Zenoh configuration's access control or TLS; empty if none.

    Args:
        access: ``access_control``, as Zenoh read it.
        tls: ``transport/link/tls``, the same.
    """
    for where, section, name, wanted in (
        ("transport.link.tls", tls, "enable_mtls", True),
        ("transport.link.tls", tls, "verify_name_on_connect", True),
        ("access_control", access, "enabled", True),
        ("access_control", access, "default_permission", "deny"),
    ):
        if section.get(name) != wanted:
            return f"{where}.{name} is not {str(wanted).lower()}"
    subjects = access.get("subjects")
    if not isinstance(subjects, list) or not subjects:
        return "access_control.subjects names nobody"
    for subject in subjects:
        if not isinstance(subject, dict) or not subject.get("cert_common_names"):
            said = subject.get("id") if isinstance(subject, dict) else subject
            return f"the subject {said!a} of access_control has no cert_common_names, and so is everybody"
    return ""


def find_hole(settings: Settings, pause: Callable[[float], object] = time.sleep) -> str:
    """Try what must be denied, at each router of a robot's Zenoh file and at each endpoint that it listens on.

    Args:
        settings: the robot's, with its keys on this machine.
        pause: waits for so many seconds.

    Returns:
        What was not denied, with the cure; empty if all was.
    """
    directory, zenoh = directory_of(settings.authority), settings.zenoh
    check_shut_out(directory, time.time())
    key = directory / TLS_KEY_FILE.format(who=TransportRole.ROBOT.value)
    for endpoint in client_endpoints(zenoh):
        if fault := _past_router(settings, endpoint, directory / SHUT_OUT_FILE, key, pause):
            return fault
    for listener in filter(has_certificates, said_of(zenoh).listen):
        if entrance := enters_without_certificate(zenoh, listener):
            return (
                f"{plain(entrance)} lets in who shows no certificate: leave out what the endpoint "
                f"{plain(listener)} says against {plain(zenoh.config)}"
            )
    return ""


def _past_router(
    settings: Settings, endpoint: str, certificate: Path, key: Path, pause: Callable[[float], object]
) -> str:
    own = open_session(settings.zenoh, [endpoint], [], changes={MODE: "client"})
    try:
        attempt = intrude(settings, endpoint, certificate, key, own, pause)
    finally:
        close_session(own)
    if not attempt.is_connected:
        raise CommandError(
            f"{plain(endpoint)}: a certificate without any right gets no link", ExitCode.UNREACHABLE
        )
    if not attempt.deeds:
        return ""
    return (
        f"a certificate without any right is not shut out: {attempt.deeds[0]}; the router at {plain(endpoint)} "
        "has to run from the router.json5 that 'cruiser provision install' writes there"
    )

"""Tries what must be denied: to get in without a certificate, and to do anything with one that has no right.

Zenoh denies without a word, so each deed is looked for at its other end.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Self

import msgspec
import zenoh

from gateway.zenoh.client import PendingQuery, SessionOwner
from schemas import keys
from schemas.command_line import CommandError
from schemas.settings import Settings, ZenohSettings
from schemas.subjects import BY_NAME
from schemas.zenoh_session import MODE, WITH_NAMES, Json, base_configuration, open_session, own_endpoint

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
    """The access control and the TLS of a gateway's sessions, as Zenoh reads them.

    Raises:
        CommandError: the configuration file is wrong.
    """
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
            settings: the gateway's.
            endpoint: a router's, or one of its own.
            certificate: of the role ``nothing``.
            key: the certificate's.
            wires: the subscribers that would notice them.

        Raises:
            CommandError: there is nobody, or the certificate is not accepted.
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
        settings: the gateway's.
        endpoint: a router's, or one of the gateway's own.
        certificate: of the role ``nothing``.
        key: the certificate's.
        session: one that has the robot's own certificate.
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

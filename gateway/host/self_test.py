"""The look of a gateway in signed mode at its own endpoints and Zenoh file, and the attempt to get past a router.

Zenoh's access control is silent where it is wrong: it lets everybody pass where a rule, a name or a switch is
missing. What the robot's own file says is looked at in each start. What a router lets through is tried on request
alone, by ``cruiser doctor --intrude``, for it puts messages on the robot's keys.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

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

SETTLE_S: Final = 1.0  # the time in which a message that is not denied arrives, by way of a router
WAITING: Final = 64  # samples of a subscription that may wait; one is enough

ANSWER_TIMEOUT_S: Final = 0.5


class Attempt(msgspec.Struct, frozen=True):
    """An attempt by somebody without any right, at one endpoint."""

    is_connected: bool
    deeds: list[str] = []


def access_of(settings: ZenohSettings) -> tuple[dict[str, Json], dict[str, Json]]:
    """The access control and the TLS of a gateway's sessions, as Zenoh reads them."""
    config = base_configuration(settings.config)
    access, tls = (msgspec.json.decode(config.get_json(path)) for path in (ACCESS, TLS))
    return access, tls


def intrude(
    settings: Settings,
    endpoint: str,
    certificate: Path,
    key: Path,
    session: zenoh.Session,
    pause: Callable[[float], object],
) -> Attempt:
    """Try everything at an endpoint, with a certificate that has no right, and look for it at its other end.

    Args:
        certificate: of the role ``nothing``.
        session: has the robot's certificate.
    """
    root, robot = settings.robot.root, settings.robot.name
    # Nobody else has this name.
    operator = f"nobody-{secrets.token_hex(4)}"
    said, question = operator.encode(), f"{root}/{robot}/gateway/{operator}"
    commanded, drive, acquire = (
        keys.command(root, robot, operator, verb) for verb in (keys.ALL, "drive", "acquire")
    )
    state = keys.build(root, robot, BY_NAME["safety/state"])
    changes: dict[str, Json] = {
        MODE: "client",
        f"{ACCESS}/enabled": False,
        f"{TLS}/connect_certificate": str(certificate),
        f"{TLS}/connect_private_key": str(key),
    }
    try:
        with ExitStack() as stack:

            def subscribed(to: zenoh.Session, expression: str) -> Any:  # noqa: ANN401 - Zenoh's
                return stack.enter_context(to.declare_subscriber(expression, _ring()))

            def answering(at: zenoh.Session, expression: str) -> Any:  # noqa: ANN401 - Zenoh's
                return stack.enter_context(at.declare_queryable(expression, _ring(), complete=True))

            wires, asked = [subscribed(session, one) for one in (commanded, state)], answering(session, commanded)
            stranger = open_session(settings.zenoh, [endpoint], [], changes=changes)
            owner = stack.enter_context(SessionOwner(stranger))
            spies = [subscribed(stranger, one) for one in (state, f"{root}/**")]
            questions = answering(stranger, question)
            for one in (drive, state):
                stranger.put(one, said)
            every = zenoh.QueryTarget.ALL
            stranger.get(acquire, PendingQuery().handler, target=every, payload=said, timeout=SETTLE_S)
            pause(SETTLE_S)
            puts = {str(one.key_expr) for wire in wires for one in _come(wire) if one.payload.to_bytes() == said}
            deeds = [f"a put on {one} arrives" for one in sorted(puts)]
            deeds += [f"a query on {one.key_expr} arrives" for one in _come(asked)][:1]
            deeds += [
                f"a subscription to {spy.key_expr} receives"
                for spy in spies
                if any(one.payload.to_bytes() != said for one in _come(spy))
            ]
            session.get(question, PendingQuery().handler, timeout=ANSWER_TIMEOUT_S)
            pause(ANSWER_TIMEOUT_S)
            deeds += [f"a query on {question} comes to it" for _ in _come(questions)][:1]
            return Attempt(owner.connected(), deeds)
    except (CommandError, zenoh.ZError):
        return Attempt(is_connected=False)


def _ring() -> zenoh.handlers.RingChannel[Any]:
    return zenoh.handlers.RingChannel(WAITING)


def _come(declared: Any) -> Iterator[Any]:  # noqa: ANN401 - a subscriber or queryable of Zenoh's
    while (one := declared.try_recv()) is not None:
        yield one


def enters_without_certificate(settings: ZenohSettings, listener: str) -> str:
    """The endpoint at which somebody without a certificate gets a link to a listener; empty if nowhere.

    Args:
        settings: the gateway's; of its file, the network's authority alone is used.
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
    """Where a gateway is reached."""

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
    """Return the first flaw by which anybody passes access control or TLS, as Zenoh reads them; empty if none."""
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

"""Signed mode: check the gateway's own endpoints and Zenoh file, and try to get past a router.

Zenoh's access control fails silently: a missing rule, name or switch lets every client pass. The robot's own file
is checked at each start. A router is tested on request only, by ``cruiser doctor --intrude``, because the test
puts messages on the robot's keys.
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

SETTLE_S: Final = 1.0  # time for a message that is not denied to arrive through a router
WAITING: Final = 64  # queued samples of a subscription; one is enough

ANSWER_TIMEOUT_S: Final = 0.5


class Attempt(msgspec.Struct, frozen=True):
    """An attempt without any rights, at one endpoint."""

    is_connected: bool
    deeds: list[str] = []


def access_of(settings: ZenohSettings) -> tuple[dict[str, Json], dict[str, Json]]:
    """Return access control and TLS of a gateway's sessions, as Zenoh reads them."""
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
    """Try every kind of access at an endpoint with a certificate of the role ``nothing``.

    ``session`` has the robot's certificate, and shows what arrives.
    """
    root, robot = settings.robot.root, settings.robot.name
    operator = f"nobody-{secrets.token_hex(4)}"
    marker, question = operator.encode(), f"{root}/{robot}/gateway/{operator}"
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
                stranger.put(one, marker)
            every = zenoh.QueryTarget.ALL
            stranger.get(acquire, PendingQuery().handler, target=every, payload=marker, timeout=SETTLE_S)
            pause(SETTLE_S)
            puts = {str(one.key_expr) for wire in wires for one in _come(wire) if one.payload.to_bytes() == marker}
            deeds = [f"a put on {one} arrives" for one in sorted(puts)]
            deeds += [f"a query on {one.key_expr} arrives" for one in _come(asked)][:1]
            deeds += [
                f"a subscription to {spy.key_expr} receives"
                for spy in spies
                if any(one.payload.to_bytes() != marker for one in _come(spy))
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
    """Return the endpoint of a listener that accepts a client without a certificate; empty if none does.

    Of the gateway's settings only the network's authority is used.
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
    """Report whether the endpoint's protocol can have certificates at both ends."""
    return endpoint.partition("/")[0] in WITH_NAMES


OPENING: Final = ("verify_name_on_connect=false", "enable_mtls=false")
"""Endpoint options that let any machine of the network pose as the router, or connect."""

INSTALL: Final = "'cruiser provision install --replace' writes it"


class Reached(msgspec.Struct, frozen=True):
    """Endpoints of a gateway."""

    connect: list[str]
    listen: list[str]

    @property
    def is_secured(self) -> bool:
        """Report whether more than plain connections of this computer reach it."""
        return any(has_certificates(one) or not is_loopback(one) for one in (*self.connect, *self.listen))


def own_fault(settings: Settings, place: Reached) -> str:
    """Return the first flaw in a gateway's configuration that lets unknown clients in; empty if there is none.

    A gateway that only this computer can reach has none: commands are signed there too.
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
                return f"{plain(endpoint)} accepts any client: leave out {option}"
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
    """Return the first flaw in access control or TLS that lets any client in; empty if there is none."""
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
        return "access_control.subjects is empty"
    for subject in subjects:
        if not isinstance(subject, dict) or not subject.get("cert_common_names"):
            shown = subject.get("id") if isinstance(subject, dict) else subject
            return f"the subject {shown!a} of access_control has no cert_common_names: it matches every client"
    return ""


def find_hole(settings: Settings, pause: Callable[[float], object] = time.sleep) -> str:
    """Test each router of a robot's Zenoh file, and each endpoint that it listens on.

    Returns:
        The first access that was not denied, with the cure; empty if all was denied.
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
                f"{plain(entrance)} accepts clients without a certificate: leave out what the endpoint "
                f"{plain(listener)} changes of {plain(zenoh.config)}"
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
        raise CommandError(f"{plain(endpoint)}: a certificate without rights gets no link", ExitCode.UNREACHABLE)
    if not attempt.deeds:
        return ""
    return (
        f"a certificate without rights gets past the router: {attempt.deeds[0]}; the router at {plain(endpoint)} "
        "must use the router.json5 that 'cruiser provision install' writes there"
    )

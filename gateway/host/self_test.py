"""The look of a gateway in signed mode at its own endpoints and Zenoh file, and the attempt to get past a router.

Zenoh's access control is silent where it is wrong: it lets everybody pass where a rule, a name or a switch is
missing. What the robot's own file says is looked at in each start. What a router lets through is tried on request
alone, by ``cruiser doctor --intrude``, for it puts messages on the robot's keys.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec

from gateway.authority.transport import SHUT_OUT_FILE, TLS_KEY_FILE, TransportRole
from gateway.provisioning.key_files import directory_of
from gateway.provisioning.tls_files import check_shut_out
from gateway.zenoh.intruder import access_of, enters_without_certificate, has_certificates, intrude
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import Settings
from schemas.zenoh_session import MODE, Json, client_endpoints, close_session, is_loopback, open_session, said_of

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

    Raises:
        CommandError: it cannot be tried: a file is missing or wrong, or no router answers.
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

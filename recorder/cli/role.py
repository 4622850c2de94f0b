"""The role of this machine's certificate. What a role may not do a router denies, and says nothing of it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Final

from recorder.disk.key_files import certificate_role
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import ZenohSettings
from schemas.zenoh_session import of_file

CERTIFICATE: Final = "transport/link/tls/connect_certificate"

RECORDING: Final = frozenset({"recorder", "router"})
ORDERING: Final = frozenset({"operator", "desk", "router"})

_PROVISIONED: Final = frozenset({"robot", "viewer"}) | RECORDING | ORDERING
"""Roles of 'cruiser provision'; of another one it is not known what it may do."""


def check_role(settings: ZenohSettings, roles: Collection[str], allowed: str) -> None:
    """Check that this machine's certificate is of one of these roles.

    Args:
        settings: of the session.
        roles: those that may do it.
        allowed: what routers let them do, and what cures it, in words.

    Raises:
        CommandError: it is of another role of ``cruiser provision``.
    """
    file = str(of_file(settings, CERTIFICATE) or "")
    role = certificate_role(Path(file)) if file else ""
    if role in _PROVISIONED and role not in roles:
        raise CommandError(f"{plain(file)} is a certificate of the role {role}: {allowed}", ExitCode.USAGE)


def check_recording(settings: ZenohSettings, expressions: Sequence[str]) -> None:
    """Check that routers let this machine receive these key expressions.

    Raises:
        CommandError: one of them is a recorder's alone.
    """
    if any("**" in expression for expression in expressions):
        check_role(
            settings,
            RECORDING,
            "routers let a recorder alone receive everything; 'cruiser provision recorder NAME' makes the keys of "
            "one, or -k names single subjects",
        )

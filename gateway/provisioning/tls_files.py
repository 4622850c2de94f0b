"""The certificates and keys that a Zenoh file names. Zenoh says of none which it is, nor that one is over."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Final

from cryptography.x509 import Certificate

from gateway.authority.transport import SHUT_OUT_FILE, TLS_KEY_FILE
from gateway.provisioning.certificates import (
    RENEW_S,
    CertificateError,
    begins_s,
    common_name_of,
    expires_s,
    fits,
    is_issued,
    read_certificates,
)
from gateway.provisioning.key_store import KeyStore, read_input
from schemas.authority.identity import INSTALLED, remade, renewed
from schemas.command_line import CommandError, ExitCode, check_regular, plain
from schemas.settings import ZenohSettings

ENDS: Final = ("connect", "listen")

_DAY_S: Final = 86_400


def check_tls_files(file: Path, who: str, now_s: float) -> str:
    """Hold the certificates and keys of a Zenoh file against each other and the time.

    Args:
        file: a Zenoh file as it was provisioned. Nothing is said of one that somebody wrote in JSON5.
        who: for whom it is, as ``cruiser provision`` calls it.
        now_s: seconds since 1970.

    Returns:
        A warning that a certificate ends soon; empty if none does.

    Raises:
        CommandError: a file is missing, wrong, or over.
    """
    cure = renewed(who)
    tls = tls_entries(file)
    names = {end: (tls.get(f"{end}_certificate"), tls.get(f"{end}_private_key")) for end in ENDS}
    ca = tls.get("root_ca_certificate")
    roots = _read(Path(ca), INSTALLED) if isinstance(ca, str) else []
    if isinstance(ca, str) and max(map(expires_s, roots)) <= now_s:
        raise _ended(Path(ca), max(map(expires_s, roots)) - now_s, "the fleet needs a new authority")
    warning = ""
    for certificate, key in dict.fromkeys(names.values()):
        if not isinstance(certificate, str) or not isinstance(key, str):
            continue
        shown, chain = plain(certificate), _read(Path(certificate), cure)
        private = KeyStore(Path(key).parent).p256(Path(key).name, remade(who))
        if not fits(chain[0], private):
            raise CommandError(f"{shown} is not the certificate of {plain(key)}; {cure}", ExitCode.USAGE)
        if roots and not is_issued(chain, roots):
            raise CommandError(
                f"{shown} is of another network than {plain(str(ca))}: none of its authorities signed it; {cure}",
                ExitCode.USAGE,
            )
        left_s = expires_s(chain[0]) - now_s
        if left_s <= 0:
            raise _ended(Path(certificate), left_s, cure)
        if left_s < RENEW_S:
            warning = f"{shown} ends in {left_s / _DAY_S:.1f} days; {cure}"
    return warning


def check_kinds(file: Path) -> None:
    """Check that a Zenoh file, and each that it names, is a regular file: Zenoh would wait for a FIFO for ever.

    Raises:
        CommandError: one is not. Nothing is said of one that is missing: Zenoh does.
    """
    for path in (file, *tls_files(file)):
        with suppress(OSError, ValueError):
            check_regular(path, path.stat().st_mode)


def why_shut_out(file: Path, now_s: float) -> str:
    """Return what is wrong with the certificates and keys of a Zenoh file with which no session opened.

    Empty if nothing is found.

    Args:
        file: named for whom it is, as it was provisioned.
        now_s: seconds since 1970, by this computer's clock.
    """
    try:
        check_tls_files(file, file.stem, now_s)
        for path in tls_files(file):
            begins_in_s = 0.0 if path.suffix == ".key" else begins_s(_read(path, "")[0]) - now_s
            if begins_in_s > 0:
                begins = f"{plain(str(path))} begins in {begins_in_s / _DAY_S:.1f} days"
                return f"{begins} by this computer's clock, which is behind: set it"
    except CommandError as error:
        return str(error)
    return ""


def certificate_ends_s(settings: ZenohSettings) -> int | None:
    """Return when the certificate ends that a session connects with, seconds since 1970; None if none is found."""
    try:
        path = tls_entries(Path(settings.config)).get("connect_certificate") if settings.config else None
        if not isinstance(path, str):
            return None
        return expires_s(read_certificates(read_input(Path(path)).decode(errors="replace"))[0])
    except (CommandError, CertificateError):
        return None


def tls_entries(file: Path) -> dict[str, object]:
    """The TLS part of a Zenoh file as it was provisioned; nothing of one that somebody wrote in JSON5."""
    try:
        tls = json.loads(read_input(file))["transport"]["link"]["tls"]
    except (ValueError, LookupError, TypeError):
        return {}
    return tls if isinstance(tls, dict) else {}


def _read(path: Path, cure: str) -> list[Certificate]:
    try:
        return read_certificates(read_input(path, cure).decode(errors="replace"))
    except CertificateError as error:
        raise CommandError(f"{plain(str(path))}: {error}; {cure}", ExitCode.USAGE) from error


def _ended(path: Path, left_s: float, cure: str) -> CommandError:
    ended = f"{plain(str(path))} ended {-left_s / _DAY_S:.1f} days ago"
    return CommandError(f"{ended}; {cure}", ExitCode.USAGE)


def tls_files(file: Path) -> list[Path]:
    """The certificates and keys that a Zenoh file names, if it is as it was provisioned."""
    try:
        tls = tls_entries(file)
    except CommandError:
        return []
    names = ("root_ca_certificate", *(f"{end}_{what}" for end in ENDS for what in ("certificate", "private_key")))
    return [Path(found) for name in names if isinstance(found := tls.get(name), str)]


def role_of(file: Path) -> str:
    """Return the role of the certificate that a Zenoh file names; empty if it names none that can be read."""
    try:
        tls = tls_entries(file)
        names = (tls.get(f"{end}_certificate") for end in ENDS)
        certificate = next((name for name in names if isinstance(name, str)), "")
        return common_name_of(_read(Path(certificate), "")[0]) if certificate else ""
    except CommandError:
        return ""


def check_shut_out(directory: Path, now_s: float) -> None:
    """Hold the certificate with which a robot tests its network against its key and the time.

    Args:
        directory: of the robot's keys.
        now_s: seconds since 1970.

    Raises:
        CommandError: it is missing, wrong, or over.
    """
    cure = "'cruiser provision renew robot' asks for it"
    path = directory / SHUT_OUT_FILE
    certificate = _read(path, cure)[0]
    if expires_s(certificate) <= now_s:
        raise _ended(path, expires_s(certificate) - now_s, cure)
    key = KeyStore(directory).p256(TLS_KEY_FILE.format(who="robot"), remade("robot"))
    if not fits(certificate, key):
        raise CommandError(f"{plain(str(path))} is not of the key beside it; {cure}", ExitCode.USAGE)

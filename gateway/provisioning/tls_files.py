"""The certificates and keys that a Zenoh file names. Zenoh says of none which it is, nor that one is over."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from gateway.authority.transport import SHUT_OUT_FILE, TLS_KEY_FILE
from gateway.provisioning.certificates import RENEW_S, CertificateError, expires_s, fits, read_certificates
from gateway.provisioning.key_store import KeyStore, read_input
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
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
    cure = f"'cruiser provision renew {who}' asks for another"
    tls = _tls_of(file)
    names = {end: (tls.get(f"{end}_certificate"), tls.get(f"{end}_private_key")) for end in ENDS}
    ca = tls.get("root_ca_certificate")
    if isinstance(ca, str):
        _certificate(Path(ca), now_s, "'cruiser provision install' writes it")
    warning = ""
    for certificate, key in dict.fromkeys(names.values()):
        if not isinstance(certificate, str) or not isinstance(key, str):
            continue
        left_s = _certificate(Path(certificate), now_s, cure)
        private = KeyStore(Path(key).parent).p256(Path(key).name, f"'cruiser provision {who}' makes it")
        if not fits(read_certificates(read_input(Path(certificate)).decode())[0], private):
            shown = plain(certificate)
            raise CommandError(f"{shown} is not the certificate of {plain(key)}; {cure}", ExitCode.USAGE)
        if left_s < RENEW_S:
            warning = f"{plain(certificate)} ends in {left_s / _DAY_S:.1f} days; {cure}"
    return warning


def certificate_ends_s(settings: ZenohSettings) -> int | None:
    """Return when the certificate ends that a session connects with, seconds since 1970; None if none is found."""
    try:
        path = _tls_of(Path(settings.config)).get("connect_certificate") if settings.config else None
        if not isinstance(path, str):
            return None
        return expires_s(read_certificates(read_input(Path(path)).decode(errors="replace"))[0])
    except (CommandError, CertificateError):
        return None


def _tls_of(file: Path) -> dict[str, object]:
    """The TLS part of a Zenoh file as it was provisioned; nothing of one that somebody wrote in JSON5."""
    try:
        tls = json.loads(read_input(file))["transport"]["link"]["tls"]
    except (ValueError, LookupError, TypeError):
        return {}
    return tls if isinstance(tls, dict) else {}


def _certificate(path: Path, now_s: float, cure: str) -> float:
    """Seconds that are left of a certificate."""
    shown = plain(str(path))
    try:
        certificate = read_certificates(read_input(path, cure).decode(errors="replace"))[0]
    except CertificateError as error:
        raise CommandError(f"{shown}: {error}; {cure}", ExitCode.USAGE) from error
    left_s = expires_s(certificate) - now_s
    if left_s <= 0:
        raise CommandError(f"{shown} ended {-left_s / _DAY_S:.1f} days ago; {cure}", ExitCode.USAGE)
    return left_s


def tls_files(file: Path) -> list[Path]:
    """The certificates and keys that a Zenoh file names, if it is as it was provisioned."""
    try:
        tls = _tls_of(file)
    except CommandError:
        return []
    names = ("root_ca_certificate", *(f"{end}_{what}" for end in ENDS for what in ("certificate", "private_key")))
    return [Path(found) for name in names if isinstance(found := tls.get(name), str)]


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
    _certificate(path, now_s, cure)
    key = KeyStore(directory).p256(TLS_KEY_FILE.format(who="robot"), "'cruiser provision robot' makes it")
    if not fits(read_certificates(read_input(path).decode())[0], key):
        raise CommandError(f"{plain(str(path))} is not of the key beside it; {cure}", ExitCode.USAGE)

"""The address at which browsers come: a socket, a certificate, and names."""

from __future__ import annotations

import socket
import ssl
from pathlib import Path
from typing import Final

from schemas.exit_codes import CommandError, ExitCode
from schemas.listen_address import certificate_files, shown_address

PACKAGES: Final = frozenset({"starlette", "uvicorn", "websockets"})
"""Packages that a server needs, by the names under which they are imported. The extra 'desk' brings them."""

LOCAL_NAMES: Final = ("127.0.0.1", "localhost", "::1", "[::1]")
"""Names under which browsers of this machine reach it."""


def listening_socket(host: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Raises:
        CommandError: the address is taken, or not one of this machine.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        text = f"cannot listen on {shown_address(host, port)}: {error.strerror or error}"
        raise CommandError(text, ExitCode.UNREACHABLE) from error


def usable_certificate(chain: Path | str | None, key: Path | str | None, host: str) -> tuple[Path, Path] | None:
    """Return the files of the certificate and its key; None where browsers come from this machine alone.

    Raises:
        CommandError: one of them is missing where it is needed, or cannot be used.
    """
    files = certificate_files(chain, key, host, "browsers")
    if files is None:
        return None
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(*files)
    except (OSError, ValueError) as error:
        text = f"{files[0]} and {files[1]} are no certificate with its key: {error}"
        raise CommandError(text, ExitCode.USAGE) from None
    return files

"""A TLS handshake with a router that lets nobody in: Zenoh says of a failure neither which nor why."""

from __future__ import annotations

import json
import socket
import ssl
from pathlib import Path
from typing import Final

from gateway.provisioning.key_store import read_input
from gateway.provisioning.tls_files import tls_entries
from schemas.exit_codes import CommandError
from schemas.printable import plain
from schemas.zenoh_link import CONNECT, split_endpoint

TIMEOUT_S: Final = 2.0
ALERT_S: Final = 1.0
"""A router that refuses a certificate says so right after the handshake (TLS 1.3, RFC 8446, 4.4.2.4)."""


def why_not_let_in(file: Path, message: str) -> str:
    """Return why no router of a Zenoh file lets this machine in; empty where the handshakes do not tell.

    Args:
        file: as it was provisioned. Nothing is tried with one that somebody wrote in JSON5.
        message: names the endpoints that were tried; those of a flag are not in the file.
    """
    found = [_why(file, endpoint) for endpoint in _endpoints(file) if endpoint in message]
    return "; ".join(map(plain, found)) if all(found) else ""


def _endpoints(file: Path) -> list[str]:
    try:
        said = json.loads(read_input(file))
        for part in CONNECT.split("/"):
            said = said[part]
    except (ValueError, LookupError, TypeError, CommandError):
        return []
    return (
        [one for one in said if isinstance(one, str) and one.startswith("tls/")] if isinstance(said, list) else []
    )


def _why(file: Path, endpoint: str) -> str:
    try:
        _, host, port = split_endpoint(endpoint)
        _shake_hands(file, host.strip("[]"), port)
    except ssl.SSLCertVerificationError as error:
        return f"the router at {endpoint} {_of_router(error)}"
    except ssl.SSLError as error:
        words = (error.reason or "").partition("ALERT_")[2].replace("_", " ").lower()
        return f"the router at {endpoint} refuses this machine's certificate: {words}" if words else ""
    except ConnectionRefusedError:
        return f"no router runs at {endpoint}: 'cruiser router' there, or 'systemctl status cruiser-router'"
    except socket.gaierror:
        return f"the host of {endpoint} is not known: look at the name, and at the network"
    except (OSError, ValueError, CommandError):
        return ""
    return ""


def _shake_hands(file: Path, host: str, port: int) -> None:
    """Connect with the certificate of the file, and wait for an alert.

    Raises:
        OSError, ssl.SSLError: why it failed; a timeout where nobody says anything.
    """
    tls = tls_entries(file)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(str(tls["root_ca_certificate"]))
    context.load_cert_chain(str(tls["connect_certificate"]), str(tls["connect_private_key"]))
    with (
        socket.create_connection((host, port), TIMEOUT_S) as link,
        context.wrap_socket(link, server_hostname=host) as session,
    ):
        session.settimeout(ALERT_S)
        session.recv(1)


def _of_router(error: ssl.SSLCertVerificationError) -> str:
    match error.verify_code:  # OpenSSL's X509_V_ERR_*
        case 10:
            return "has a certificate that is over: 'cruiser provision renew router' there"
        case 9:
            return "has a certificate that has not begun: look at this computer's clock"
        case 62 | 64:
            return "has a certificate for another name: connect to the one that it was made for"
        case _:
            return "is another fleet's, or of another authority: its certificate is not signed by the ca.pem here"

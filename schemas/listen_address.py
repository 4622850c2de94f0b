"""Addresses that a command listens on, and its certificate there, as they stand on the command line."""

from __future__ import annotations

import argparse
import ipaddress
from pathlib import Path

from schemas.exit_codes import CommandError, ExitCode


def address(text: str) -> tuple[str, int]:
    """An address on the command line.

    Raises:
        argparse.ArgumentTypeError: it is not an IP address and a port.
    """
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    try:
        ipaddress.ip_address(host)
        number = int(port)
    except ValueError:
        number = -1
    if not 0 <= number < 1 << 16:
        raise argparse.ArgumentTypeError(f"{text!a} is not an address and a port, such as 0.0.0.0:9747")
    return host, number


def shown_address(host: str, port: int) -> str:
    """An IP address and a port, as they stand in a URL."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def add_certificate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a server's certificate; see ``certificate_files``."""
    parser.add_argument(
        "--certificate", type=Path, metavar="FILE", help="its certificate chain, PEM: needed beyond this machine"
    )
    parser.add_argument("--key", type=Path, metavar="FILE", help="the certificate's private key, PEM")


def certificate_files(
    chain: Path | str | None, key: Path | str | None, host: str, who: str
) -> tuple[Path, Path] | None:
    """The files of the certificate and its key; None where there are none, and clients are on this machine alone.

    Args:
        chain: the certificate's file, as it was given, if it was.
        key: its key's.
        host: the IP address that is listened on.
        who: the clients, in words.

    Raises:
        CommandError: one of them is missing where it is needed.
    """
    if not chain and not key:
        if ipaddress.ip_address(host).is_loopback:
            return None
        raise CommandError(
            f"beyond this machine ({host}) {who} need TLS: give --certificate and --key", ExitCode.USAGE
        )
    if not chain or not key:
        raise CommandError("--certificate and --key belong together", ExitCode.USAGE)
    return Path(chain), Path(key)

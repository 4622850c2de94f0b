"""Shared by command lines: exit codes, printable text, files, addresses, settings that were removed."""

from __future__ import annotations

import argparse
import ipaddress
import stat
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import IntEnum
from importlib.util import find_spec
from pathlib import Path, PurePath
from typing import Final


def installed_version(package: str) -> str:
    """The version of an installed package, without importlib.metadata, which takes 3.5 MiB of memory."""
    start = f"{package.replace('-', '_')}-"
    for place in sys.path:
        for path in Path(place).glob(f"{start}*.dist-info"):
            return path.name.removeprefix(start).removesuffix(".dist-info")
    # Tools other than pip may name the directory differently.
    from importlib.metadata import version  # noqa: PLC0415

    return version(package)


class ExitCode(IntEnum):
    """The exit codes of every command."""

    OK = 0
    FAILURE = 1  # findings, or a failure that fits nothing below
    USAGE = 2  # wrong arguments or a wrong configuration
    PARTIAL = 3  # part of the input could be read or done
    UNREACHABLE = 4  # a bus, a robot or a Zenoh node does not answer
    REFUSED = 5  # the robot refused the request


class CommandError(Exception):
    """A command cannot continue: one line for the user, and an exit code."""

    def __init__(self, message: str, code: ExitCode = ExitCode.FAILURE) -> None:
        super().__init__(message)
        self.code = code


class UsageError(CommandError):
    """Wrong arguments, files or settings: exit code 2."""

    def __init__(self, message: str) -> None:
        super().__init__(message, ExitCode.USAGE)


LINE_LENGTH: Final = 300  # longest text from elsewhere in a line


def plain(text: str) -> str:
    """The text, with escapes if it is not printable: it cannot break lines or control the terminal."""
    return text if text.isprintable() else ascii(text)[1:-1]


def short(text: str) -> str:
    return text if len(text) <= LINE_LENGTH else f"{text[: LINE_LENGTH - 3]}..."


_EXTRA_OF: Final = {  # by library
    **dict.fromkeys(("duckdb", "numpy", "ptars", "pyarrow"), "review"),
    **dict.fromkeys(("starlette", "uvicorn", "websockets"), "desk"),
    "obstore": "upload",
    "foxglove": "live",
    "prometheus_client": "metrics",
}


@contextmanager
def needing_extra() -> Iterator[None]:
    """Name the missing extra if an import in this block fails."""
    try:
        yield
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name not in _EXTRA_OF:
            raise
        raise missing_extra(name, _EXTRA_OF[name]) from None


def missing_extra(library: str, extra: str) -> CommandError:
    return CommandError(f"this needs {library}{how_to_get(extra)}")


def how_to_get(extra: str) -> str:
    """Return how to install an extra, to append to the library's name."""
    if find_spec("pip") is not None:
        return f": pip install -e '.[{extra}]' in the checkout, or 'FILE[{extra}]' with the wheel"
    # The Debian package and the image have no pip.
    return ", which is not part of this installation, and there is no pip: use a checkout and 'make install'"


SAFE_PATH_VARIABLE: Final = "PYTHONSAFEPATH"  # as ``-P``, for an interpreter that a library starts


def module_command(module: str, *words: str) -> tuple[str, ...]:
    """Return the command line that runs a module of this installation.

    With ``-P`` a Python file in the working directory, beside downloaded logs, is never imported.
    """
    return sys.executable, "-P", "-m", module, *words


_KINDS: Final = {"d": "a directory", "p": "a FIFO", "s": "a socket", "c": "a device", "b": "a device"}


def other_kind(mode: int) -> str:
    """Return the kind of a file that is not regular, in words; empty for a regular one."""
    return "" if stat.S_ISREG(mode) else _KINDS.get(stat.filemode(mode)[0], "something else")


def check_regular(path: PurePath, mode: int) -> None:
    """Check that a file is regular, before it is opened."""
    if kind := other_kind(mode):
        raise UsageError(f"{plain(str(path))} is {kind}, not a regular file")


GONE_SETTINGS: Final[Mapping[str, str]] = {
    "upload.hours": "limit the hours with a systemd timer: see docs/recording.md",
    "command.brake_pedal_percent": "the brake pedal is never pressed",
    "authority.max_offline_h": "issue grants of hours: a robot needs no contact with its authority",
    "authority.require_fresh": "issue grants of hours: a robot needs no contact with its authority",
}
"""Settings that were removed, by dotted key: what to use instead.

A settings file that contains one still starts the gateway, with a warning: an upgrade must not ground a fleet.
Logs of earlier versions contain them too.
"""


def address(text: str) -> tuple[str, int]:
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
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def add_certificate_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a server's certificate; see ``certificate_files``."""
    parser.add_argument(
        "--certificate",
        type=Path,
        metavar="FILE",
        help="certificate chain, PEM; required if other machines connect",
    )
    parser.add_argument("--certificate-key", type=Path, metavar="FILE", help="private key of the certificate, PEM")


def certificate_files(
    chain: Path | str | None, key: Path | str | None, host: str, who: str
) -> tuple[Path, Path] | None:
    """The files of certificate and key; None without them, which is allowed on a loopback address only."""
    if not chain and not key:
        if ipaddress.ip_address(host).is_loopback:
            return None
        raise UsageError(f"beyond this machine ({host}) {who} need TLS: give --certificate and --certificate-key")
    if not chain or not key:
        raise UsageError("--certificate and --certificate-key belong together")
    return Path(chain), Path(key)

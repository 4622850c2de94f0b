"""Shared by command lines: exit codes, text that is safe to print, files, addresses, words that are gone."""

from __future__ import annotations

import argparse
import ipaddress
import stat
import sys
from collections.abc import Mapping, Sequence
from enum import IntEnum
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path, PurePath
from typing import Final


def installed_version(package: str) -> str:
    """The version of an installed package. importlib.metadata tells it too, and takes 3.5 MiB of memory for it."""
    start = f"{package.replace('-', '_')}-"
    for place in sys.path:
        for path in Path(place).glob(f"{start}*.dist-info"):
            return path.name.removeprefix(start).removesuffix(".dist-info")
    # Other tools than pip may name the directory otherwise.
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
    """A command cannot go on: one clear line for the person, and an exit code."""

    def __init__(self, message: str, code: ExitCode = ExitCode.FAILURE) -> None:
        super().__init__(message)
        self.code = code


LINE_LENGTH: Final = 300  # of a text from elsewhere no more belongs into a line


def plain(text: str) -> str:
    """The text as it is if all of it can be printed, else with escapes: it can break neither line nor terminal."""
    return text if text.isprintable() else ascii(text)[1:-1]


def short(text: str) -> str:
    return text if len(text) <= LINE_LENGTH else f"{text[: LINE_LENGTH - 3]}..."


def missing_extra(library: str, extra: str) -> CommandError:
    return CommandError(f"this needs {library}{how_to_get(extra)}")


def how_to_get(extra: str) -> str:
    """Return where an extra comes from, to be put behind what needs it."""
    if find_spec("pip") is not None:
        return f": pip install -e '.[{extra}]' in the checkout, or 'FILE[{extra}]' with the wheel"
    # The Debian package and the image have none: what they bring is all that they ever have.
    return (
        ", which is not part of this installation, and there is no pip: run it from a checkout, where "
        "'make install' brings it"
    )


SAFE_PATH_VARIABLE: Final = "PYTHONSAFEPATH"  # the same as ``-P``, for an interpreter that a library starts


def module_command(module: str, *words: str) -> tuple[str, ...]:
    """Return the command line that runs a module of this installation.

    With ``-P``: a Python file in the working directory is never taken for a module. People keep logs there that
    others have sent them.
    """
    return sys.executable, "-P", "-m", module, *words


_KINDS: Final = {"d": "a directory", "p": "a FIFO", "s": "a socket", "c": "a device", "b": "a device"}


def other_kind(mode: int) -> str:
    """Return the kind of what is no regular file, in words; empty for a regular one."""
    return "" if stat.S_ISREG(mode) else _KINDS.get(stat.filemode(mode)[0], "something else")


def check_regular(path: PurePath, mode: int) -> None:
    """Check that what is to be read is a regular file, before it is opened."""
    if kind := other_kind(mode):
        raise CommandError(f"{plain(str(path))} is {kind}, and has to be a regular file", ExitCode.USAGE)


GONE_WORDS: Final[Mapping[str, str]] = {
    "review evidence": "cut the time out with 'cruiser review cut', and keep the whole log with its .sig",
    "setup --dry-run": "docs/operate.md says what is written; what was there is kept beside it",
    "setup --output": "the services read /etc/cruiser/cruiser.toml",
    "setup --without-bus": "setup needs no bus",
    "serve": "'cruiser desk --logs DIRECTORY --logs-only' shows logs in a browser",
    "shadow": "record the drive, and ask 'cruiser review rerun LOG --set SETTING=VALUE'",
    "review regress": "'cruiser review rerun LOG...' says of how many logs the decisions differ",
    "review rerun --jobs": "give --processes N",
    "review export --runner": "give --processes N, or --ray ADDRESS",
    "record start": "a recorder records while it runs: 'systemctl start cruiser-recorder'",
    "record stop": "a recorder records while it runs: 'systemctl stop cruiser-recorder'",
    "record split": "'systemctl reload cruiser-recorder', or SIGHUP, begins new files",
    "review export --add": "export to a dataset of its own, and read both",
    "review merge": "'mcap merge' (the mcap CLI); questions take several files and directories",
    "record backfill": "ask the log of the robot's own recorder too, which lacks nothing that a link lost",
    "provision site": "the authority signs each person's request itself ('cruiser provision sign')",
    "provision sign --delegate": "no grant stands below another",
    "provision revoke --grant": "give NAME, --key or --epoch",
    "provision time": "a robot goes by its clock, and by no earlier time than its authority signed last",
    "demo-fleet": "'make demo-fleet' in a checkout; docs/examples/fleet.sh has its commands",
    "demo --browser": "it is opened, unless --no-browser",
    "demo --json": "'cruiser review info --json' asks the log",
    "demo --link": "the demo's link is that of this machine",
    "demo --patrol": "'cruiser drive' drives one of its robots",
    "sim --fleet": "'cruiser demo --desk --robots N'",
    "sim --patrol": "'cruiser demo --desk', and 'cruiser drive' to drive one of its robots",
    "sim --endpoint": "'cruiser demo --desk --endpoint ENDPOINT'",
    **dict.fromkeys(
        (
            f"review replay --{flag}"
            for flag in ("interface", "channel", "bitrate", "fd", "tx", "force-real-bus", "force-command-frames")
        ),
        "put frames on a bus with 'cruiser review export --format candump' and canplayer",
    ),
}
"""Commands (``serve``) and flags (``review export --add``) as they were typed: what to use."""

GONE_SETTINGS: Final[Mapping[str, str]] = {
    "upload.hours": "a systemd timer has the hours, see docs/recording.md",
    "command.brake_pedal_percent": "the brake pedal is never pressed",
    "authority.max_offline_h": "a robot is engaged however long its authority was silent; give grants of hours",
    "authority.require_fresh": "a robot waits for no word of its authority; give grants of hours",
}
"""Settings by their dotted keys, or whole tables by their names: what to use instead.

A robot's settings file that holds one still starts its gateway, with a warning: an upgrade must ground no fleet.
Logs hold the settings that were in force, so those of earlier versions hold them too.
"""


def gone_word(words: Sequence[str]) -> str:
    """Return what to say about the first of a command line's words that is gone; empty if none is."""
    flags = [word.partition("=")[0] for word in words if word.startswith("--")]
    # A word behind a flag may be its value.
    names = [
        word
        for before, word in pairwise(["", *words])
        if not word.startswith("-") and (not before.startswith("-") or "=" in before)
    ]
    commands = [" ".join(names[:length]) for length in (1, 2) if len(names) >= length]
    typed = [*commands, *(f"{command} {flag}" for flag in flags for command in commands)]
    return next((f"'{word}' is gone: {GONE_WORDS[word]}" for word in typed if word in GONE_WORDS), "")


def gone_setting(key: str) -> str:
    """Return what to say about a setting, or a table of settings, that is gone; empty if it is not."""
    named = next((name for name in (key, key.partition(".")[0]) if name in GONE_SETTINGS), "")
    return f"{key} is gone and has no effect: {GONE_SETTINGS[named]}" if named else ""


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
        "--certificate", type=Path, metavar="FILE", help="its certificate chain, PEM: needed beyond this machine"
    )
    parser.add_argument("--key", type=Path, metavar="FILE", help="the certificate's private key, PEM")


def certificate_files(
    chain: Path | str | None, key: Path | str | None, host: str, who: str
) -> tuple[Path, Path] | None:
    """The files of certificate and key; None where there are none, and clients are on this machine alone."""
    if not chain and not key:
        if ipaddress.ip_address(host).is_loopback:
            return None
        raise CommandError(
            f"beyond this machine ({host}) {who} need TLS: give --certificate and --key", ExitCode.USAGE
        )
    if not chain or not key:
        raise CommandError("--certificate and --key belong together", ExitCode.USAGE)
    return Path(chain), Path(key)

"""``HOST:PORT``, as people write it. Pure."""

from __future__ import annotations

import re

from schemas.command_line import CommandError, ExitCode

_FORM = re.compile(r"(?P<host>\[[0-9A-Fa-f:.%]+\]|[^\s:\[\]]+):(?P<port>[0-9]{1,5})")


def parse_address(text: str) -> tuple[str, int]:
    """Host and port; an IPv6 address stands in brackets, which are taken off.

    Raises:
        CommandError: the text is not of that form.
    """
    match = _FORM.fullmatch(text)
    if match is None or int(match["port"]) > 0xFFFF:
        raise CommandError(f"{text!r} is no HOST:PORT such as 127.0.0.1:29536", ExitCode.USAGE)
    return match["host"].strip("[]"), int(match["port"])


def show_address(host: str, port: int) -> str:
    """The text of an address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

"""Kinds of files: settings, keys and notes are regular ones. To open a FIFO would wait for ever. Pure."""

from __future__ import annotations

import stat
from pathlib import PurePath
from typing import Final

from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain

_KINDS: Final = {"d": "a directory", "p": "a FIFO", "s": "a socket", "c": "a device", "b": "a device"}


def other_kind(mode: int) -> str:
    """Return the kind of what is no regular file, in words; empty for a regular one.

    Args:
        mode: type and permissions, as of ``stat``.
    """
    return "" if stat.S_ISREG(mode) else _KINDS.get(stat.filemode(mode)[0], "something else")


def check_regular(path: PurePath, mode: int) -> None:
    """Check that what is to be read is a regular file, before it is opened.

    Args:
        path: its place.
        mode: type and permissions, as of ``stat``.

    Raises:
        CommandError: it is a directory, a FIFO, a socket or a device.
    """
    if kind := other_kind(mode):
        raise CommandError(f"{plain(str(path))} is {kind}, and has to be a regular file", ExitCode.USAGE)

"""Reads the configuration file and merges it with the environment and the flags."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from schemas.configuration import TomlSource, merge
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.setting_table import CONFIG_VARIABLE
from schemas.settings import Settings


def load_settings(path: str | None, environ: Mapping[str, str], flags: Mapping[str, object]) -> Settings:
    """The settings in force.

    Args:
        path: the TOML file; if None, the one that the environment names; if it names none, no file.
        environ: environment variables.
        flags: values by dotted key, such as ``can.channel``.

    Raises:
        CommandError: the file cannot be read, or a key or a value is wrong.
    """
    if path == "":
        # As with --config "$FILE" where FILE is not set: a robot must not start with settings that nobody meant.
        raise CommandError("--config names no file: its value is empty", ExitCode.USAGE)
    file = path if path is not None else environ.get(CONFIG_VARIABLE) or None
    return merge(None if file is None else _read(file), environ, flags)


def _read(file: str) -> TomlSource:
    try:
        content = Path(file).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: no name of a file can hold a NUL
        detail = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise CommandError(
            f"cannot read the configuration file {plain(file)!r}: {detail.lower()}", ExitCode.USAGE
        ) from error
    try:
        # Editors on Windows begin a file with a byte order mark.
        return TomlSource(file, content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CommandError(
            f"{plain(file)}:{line}: not UTF-8 text (byte {content[error.start]:#04x})", ExitCode.USAGE
        ) from error

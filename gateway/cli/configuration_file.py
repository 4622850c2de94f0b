"""Reads the configuration file and merges it with the environment and the flags."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

from schemas.command_line import CommandError, ExitCode, other_kind, plain
from schemas.configuration import CONFIG_VARIABLE, SETTINGS, TomlSource, directory_of, merge
from schemas.settings import Settings

ZENOH_ENDING: Final = ".json5"

SYSTEM_FILE: Final = Path("/etc/cruiser/cruiser.toml")  # the settings of a robot's services
OF_THE_ROBOT: Final = frozenset({"doctor", "gateway", "record"})
"""Commands that read these where no file is named: by hand, too, they are about the robot that it is."""

_LOOKING: Final = ("list", "watch", "view", "why")
_DRIVING: Final = ("drive", "stop", "reset", "lease", "park", "unpark", "light", "horn", "odometer")
OWN_FILES: Final[Mapping[str, tuple[str, ...]]] = {
    "gateway": ("robot.toml",),
    "doctor": ("robot.toml",),
    "record": ("recorder.toml",),
    "desk": ("desk.toml",),
    "metrics": ("viewer.toml",),
    **dict.fromkeys((*_LOOKING, *_DRIVING), ("operator.toml", "viewer.toml")),
}
"""Settings files that ``cruiser provision install`` writes for the user of a command."""


def settings_file(
    command: str, path: str | None, environ: Mapping[str, str], action: str | None = None
) -> str | None:
    """Return the settings file of a command; None for none.

    Args:
        path: the value of ``--config``.
        action: of ``record``, by which somebody asks a recorder.
    """
    if path is not None:
        return path
    if CONFIG_VARIABLE in environ:
        return environ[CONFIG_VARIABLE] or None
    is_read = command in OF_THE_ROBOT and action is None and SYSTEM_FILE.exists()
    return str(SYSTEM_FILE) if is_read else None


def load_settings(path: str | None, environ: Mapping[str, str], flags: Mapping[str, object]) -> Settings:
    """The settings in force.

    Args:
        path: the TOML file; if None, the one that the environment names; if it names none, no file.
        flags: values by dotted key, such as ``can.channel``.
    """
    if path == "":
        # As with --config "$FILE" where FILE is not set: a robot must not start with settings that nobody meant.
        raise CommandError("--config is empty: it must name a file", ExitCode.USAGE)
    file = path if path is not None else environ.get(CONFIG_VARIABLE) or None
    settings = merge(None if file is None else _read(file), environ, flags)
    if settings.zenoh.config:
        from gateway.provisioning.key_files import check_kinds  # noqa: PLC0415 - not for who has no such file

        check_kinds(Path(settings.zenoh.config))
    return settings


def unread_file(command: str, path: str | None, environ: Mapping[str, str], settings: Settings) -> str:
    """Return the settings file that somebody probably forgot to name, where a command runs in open mode.

    It is looked for in the working directory and in that of the keys. Empty if there is none, and where the lack
    of a file (``CRUISER_CONFIG=``), the mode, or for all but a gateway the place to connect to is stated.
    """
    stated = {CONFIG_VARIABLE, SETTINGS["authority.mode"].variable} & environ.keys()
    is_placed = command != "gateway" and not settings.zenoh.given.isdisjoint({"connect", "config"})
    if path is not None or stated or is_placed or settings.authority.mode != "open":
        return ""
    places = [Path()]
    with suppress(RuntimeError):  # Nobody knows a home directory of this user.
        places.append(Path(directory_of(settings.authority, environ, Path.home())))
    files = [place / name for place in places for name in OWN_FILES.get(command, ())]
    return next((str(file) for file in files if os.path.isfile(file)), "")  # noqa: PTH113 - it never raises


def _read(file: str) -> TomlSource:
    shown = plain(file)
    if file.endswith(ZENOH_ENDING):
        raise CommandError(
            f"{shown} is a Zenoh file, for --zenoh-config; --config takes a settings file: "
            f"{shown.removesuffix(ZENOH_ENDING)}.toml, written by 'cruiser provision install'",
            ExitCode.USAGE,
        )
    try:
        if kind := other_kind(Path(file).stat().st_mode):
            raise CommandError(f"cannot read the configuration file {shown!r}: it is {kind}", ExitCode.USAGE)
        content = Path(file).read_bytes()
    except (OSError, ValueError) as error:  # ValueError: no name of a file can hold a NUL
        detail = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise CommandError(
            f"cannot read the configuration file {shown!r}: {detail.lower()}", ExitCode.USAGE
        ) from error
    try:
        # Editors on Windows begin a file with a byte order mark.
        return TomlSource(file, content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CommandError(
            f"{shown}:{line}: not UTF-8 text (byte {content[error.start]:#04x})", ExitCode.USAGE
        ) from error

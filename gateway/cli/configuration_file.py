"""The settings file of a command, merged with the environment and the flags."""

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
# commands that read SYSTEM_FILE where no file is named
OF_THE_ROBOT: Final = frozenset({"doctor", "gateway", "record"})

_LOOKING: Final = ("list", "watch", "view", "why", "ros")
_DRIVING: Final = ("drive", "stop", "reset", "lease", "park", "unpark", "light", "horn", "odometer")
OWN_FILES: Final[Mapping[str, tuple[str, ...]]] = {
    "gateway": ("robot.toml",),
    "doctor": ("robot.toml",),
    "record": ("recorder.toml",),
    "desk": ("desk.toml",),
    "metrics": ("viewer.toml",),
    **dict.fromkeys((*_LOOKING, *_DRIVING), ("operator.toml", "viewer.toml")),
}
"""Settings files that ``cruiser provision install`` writes, by the commands of their users."""


def settings_file(
    command: str, path: str | None, environ: Mapping[str, str], action: str | None = None
) -> str | None:
    """Return the settings file of a command; None for none. With an action, ``record`` asks another recorder."""
    if path is not None:
        return path
    if CONFIG_VARIABLE in environ:
        return environ[CONFIG_VARIABLE] or None
    is_read = command in OF_THE_ROBOT and action is None and SYSTEM_FILE.exists()
    return str(SYSTEM_FILE) if is_read else None


def load_settings(path: str | None, environ: Mapping[str, str], flags: Mapping[str, object]) -> Settings:
    """Merge a TOML file (``path``, else the one in the environment), the environment and flags by dotted key."""
    if path == "":
        # --config "$FILE" with FILE unset: a robot must not start with default settings by mistake.
        raise CommandError("--config is empty: it must name a file", ExitCode.USAGE)
    file = path if path is not None else environ.get(CONFIG_VARIABLE) or None
    settings = merge(None if file is None else _read(file), environ, flags)
    if settings.zenoh.config:
        from gateway.provisioning.key_files import check_kinds  # noqa: PLC0415 - only for a Zenoh file

        check_kinds(Path(settings.zenoh.config))
    return settings


def unread_file(command: str, path: str | None, environ: Mapping[str, str], settings: Settings) -> str:
    """Return the settings file that the user probably forgot to name, if a command runs in open mode.

    Looks in the working directory and beside the keys. Empty if there is none, or if the user chose: no file
    (``CRUISER_CONFIG=``), the mode, or, for all but a gateway, the endpoint to connect to.
    """
    stated = {CONFIG_VARIABLE, SETTINGS["authority.mode"].variable} & environ.keys()
    is_placed = command != "gateway" and not settings.zenoh.given.isdisjoint({"connect", "config"})
    if path is not None or stated or is_placed or settings.authority.mode != "open":
        return ""
    places = [Path()]
    with suppress(RuntimeError):  # This user has no home directory.
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

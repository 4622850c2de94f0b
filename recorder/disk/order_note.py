"""The file beside a recorder's logs that keeps its authority's rotations and revocations across a restart."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Final

import msgspec

from recorder.record.admission import OrderNote
from schemas.exit_codes import CommandError, ExitCode
from schemas.file_kinds import check_regular

log = logging.getLogger(__name__)

NAME: Final = ".authority.json"


def read_note(directory: Path) -> OrderNote:
    """Return the note that was saved last; an empty one if there is no file.

    Raises:
        CommandError: it cannot be read. With an empty note, revoked holders would be admitted again.
    """
    path = directory / NAME
    try:
        check_regular(path, path.stat().st_mode)
        return msgspec.json.decode(path.read_bytes(), type=OrderNote)
    except FileNotFoundError:
        return OrderNote()
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise CommandError(
            f"{path} is damaged, and so is what was revoked: {error}; remove it, and show the recorder the newest "
            "list of revocations",
            ExitCode.USAGE,
        ) from error


def save_note(directory: Path, note: OrderNote) -> None:
    """Write it in place of the one before. May wait for the disk; never raises."""
    path, unfinished = directory / NAME, directory / f"{NAME}.unfinished"
    try:
        descriptor = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(msgspec.json.encode(note))
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError as error:
        log.warning("%s cannot be written: %s", path, error.strerror)

"""Tags and comments of people on a log, in a file beside it: a JSON object a line, only ever added to."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from recorder.disk.log_directory import PART_SUFFIX, SUFFIX
from recorder.reading.times import date_of
from schemas.exit_codes import CommandError

NOTES_SUFFIX: Final = ".notes.jsonl"

NOTES_BYTES: Final = 262_144
"""The longest file of notes of a log: some thousand comments."""

NOTE_BYTES: Final = 16_384
"""The longest note as a browser sends it."""

TAG_PATTERN: Final = r"^[\w.-]{1,40}\Z"
"""A tag is one word: it is looked for as one."""


class CommentNote(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="is", tag="comment"
):
    """A comment.

    Attributes:
        who: the name that its author has given; nobody has looked whether it is true.
        at: the moment that it is about, in ISO 8601; empty for the whole log.
        robot: the robot that it is about; empty for all of the log.
        time: of writing, in ISO 8601; the server's, whatever a browser says.
    """

    who: Annotated[str, Meta(min_length=1, max_length=64)]
    text: Annotated[str, Meta(min_length=1, max_length=2000)]
    at: Annotated[str, Meta(max_length=40)] = ""
    robot: Annotated[str, Meta(max_length=200)] = ""
    time: Annotated[str, Meta(max_length=40)] = ""


class TagNote(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="is", tag="tag"):
    """A tag that is put on a log, or taken off."""

    who: Annotated[str, Meta(min_length=1, max_length=64)]
    tag: Annotated[str, Meta(pattern=TAG_PATTERN)]
    off: bool = False
    time: Annotated[str, Meta(max_length=40)] = ""


AnyNote = CommentNote | TagNote

_DECODER: Final[msgspec.json.Decoder[AnyNote]] = msgspec.json.Decoder(AnyNote)


class NoteRefusedError(ValueError):
    """A note is not of its form; the text is for people."""


def read_note(data: bytes, time: str) -> AnyNote:
    """Read a note as a browser sends it.

    Args:
        data: JSON.
        time: the present, in ISO 8601.

    Raises:
        NoteRefusedError: it is none.
    """
    if len(data) > NOTE_BYTES:
        raise NoteRefusedError("the note is too long")
    try:
        note = _DECODER.decode(data)
    except msgspec.MsgspecError as error:
        raise NoteRefusedError(f"this is no note: {error}") from None
    if not (note.who.strip() and note.who.isprintable()):
        raise NoteRefusedError("a note needs the name of whoever writes it")
    if isinstance(note, CommentNote) and not note.text.strip():
        raise NoteRefusedError("the comment is empty")
    if isinstance(note, CommentNote) and note.at and date_of(note.at) is None:
        raise NoteRefusedError("the moment of the note is no time")
    noted: AnyNote = msgspec.structs.replace(note, time=time)
    return noted


def notes_path(log: Path) -> Path:
    """Return the file of a log's notes. It is the same while the log is written and once it is whole."""
    return log.with_name(log.name.removesuffix(PART_SUFFIX).removesuffix(SUFFIX) + NOTES_SUFFIX)


def add_note(path: Path, note: AnyNote) -> None:
    """Add a note to a file. Safe with others who do the same: each note is whole, and none is lost.

    Raises:
        CommandError: the file is full, or the disk does not take it.
    """
    line = msgspec.json.encode(note) + b"\n"
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        with open(os.open(path, flags, 0o664), "r+b", buffering=0) as stream:  # noqa: PTH123 - of a descriptor
            fcntl.flock(stream, fcntl.LOCK_EX)
            size = os.fstat(stream.fileno()).st_size
            if size + len(line) >= NOTES_BYTES:
                raise CommandError(f"{path.name} is full: {size} bytes of notes")
            if size and os.pread(stream.fileno(), 1, size - 1) != b"\n":
                # The power failed while somebody wrote: the rest of that line is lost, and this one shall not be.
                line = b"\n" + line
            if stream.write(line) != len(line):
                raise CommandError(f"{path.name} did not take all of the note: the disk is full")
            os.fsync(stream.fileno())
    except OSError as error:
        raise CommandError(f"cannot write {path.name}: {error.strerror or error}") from error


def read_notes(path: Path) -> tuple[list[AnyNote], int]:
    """Return the notes of a file, oldest first, and the number of lines that are none. No file has no notes."""
    try:
        with open(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK), "rb") as stream:  # noqa: PTH123 - the same
            lines = stream.read(NOTES_BYTES).splitlines()
    except OSError:
        return [], 0
    found: list[AnyNote] = []
    unread = 0
    for line in filter(None, lines):
        try:
            found.append(_DECODER.decode(line))
        except msgspec.MsgspecError:
            unread += 1
    return found, unread


def tags_of(notes: Iterable[AnyNote]) -> list[str]:
    """Return the tags that were put on and not taken off again, in the order in which they came."""
    tags: dict[str, None] = {}
    for note in notes:
        if isinstance(note, TagNote):
            tags.pop(note.tag, None)
            if not note.off:
                tags[note.tag] = None
    return list(tags)

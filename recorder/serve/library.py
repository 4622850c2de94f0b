"""The logs of a directory as their catalog has them, which is kept current beside the answers."""

from __future__ import annotations

import asyncio
import os
import shlex
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from recorder.disk.log_directory import PART_SUFFIX, SUFFIX
from recorder.review.catalog.directory import name_in_row
from recorder.review.catalog.known import CATALOG_NAME
from recorder.review.catalog.rows import INCIDENT, CatalogRow, CatalogUnreadableError, LoggedDriver, LoggedMoment
from recorder.review.catalog.table import SCHEMA, read_table
from recorder.review.timeline.entries import ENDS, EntryKind
from recorder.serve.answers import BEGINS, NearDrives, answer, whole
from recorder.serve.days import DAYS_COLUMNS, LoggedDay, days
from recorder.serve.notes import NOTES_SUFFIX, notes_path, read_notes, tags_of
from recorder.serve.search import (
    FindCondition,
    FindQuery,
    FindSubject,
    FoundDrive,
    columns_of,
    matching,
    newest,
    read_words,
)
from schemas.exit_codes import CommandError, ExitCode
from schemas.web.jobs import ask_review

ANSWERS: Final = 200
"""Answers to a search that are shown, the newest."""

DAYS: Final = 3_700
"""Days of the calendar, the newest."""

WORDS: Final = 1_000
"""The longest search."""

LOOK_S: Final = (3.0, 30.0)
"""Pause between two looks at the directory: at least, and at most, where a look takes long."""

ROUND_S: Final = (30.0, 3600.0)
"""Time in which logs are read before those that are done are shown: at first, and for a log that takes longer."""

AT_ONCE: Final = 1
"""Answers that are read from the catalog at once: the bound on what it unpacks to is the process's."""

NEAR: Final = frozenset({*BEGINS, *(kind.value for kind in ENDS), EntryKind.GATEWAY.value, INCIDENT})
"""Kinds of moments that are shown with a drive: who began, what ended it, and incidents."""

NEAR_MAX: Final = 100 * ANSWERS
"""Moments that are looked through for them, the newest."""

Signature = Mapping[str, tuple[int, int]]
"""Files by their names: length, and time of the last change."""


class LibraryState(msgspec.Struct, frozen=True):
    """The state of a catalog.

    Attributes:
        logs: files in the directory that are whole, or no longer written.
        cataloged: those that the catalog has.
        is_reading: logs are read at present.
        fault: the reason that something is missing, for people.
    """

    logs: int = 0
    cataloged: int = 0
    is_reading: bool = False
    fault: str = ""


class Library:
    """The logs of a directory.

    Args:
        directory: of the logs.
        scratch: a directory for the catalog where there may be none beside the logs.

    Attributes:
        state: that of the catalog.
    """

    def __init__(self, directory: Path, scratch: Path) -> None:
        self._directory = directory
        is_beside = os.access(directory, os.W_OK)
        self.catalog = (directory if is_beside else scratch) / CATALOG_NAME
        self.state = LibraryState()
        self._reading = threading.BoundedSemaphore(AT_ONCE)
        self._tags: dict[str, list[str]] = {}
        self._notes: Signature = {}

    async def keep_current(self, ends: Callable[[], bool]) -> None:
        """Bring the catalog up to date whenever a log has come, changed or gone, until the end."""
        known: Signature | None = None
        round_s = ROUND_S[0]
        while not ends():
            before_s = time.monotonic()
            logs, notes = await asyncio.to_thread(_look, self._directory)
            await asyncio.to_thread(self._learn_tags, notes)
            pause_s = min(max(LOOK_S[0], 10 * (time.monotonic() - before_s)), LOOK_S[1])
            if logs != known:
                had = await asyncio.to_thread(self._cataloged)
                self.state = LibraryState(len(logs), len(had), is_reading=True, fault=self.state.fault)
                is_done, fault = await self._refresh(round_s)
                has = await asyncio.to_thread(self._cataloged)
                # A log that came after the look may be cataloged, and gone at the next look. A catalog that stays
                # as it was is left alone: the directory, or the catalog itself, may be out of reach.
                is_current = has == had or has <= set(map(name_in_row, logs))
                # What took too long is read on in the next round; a log that takes longer by itself gets the time.
                known = logs if is_done and is_current else None
                round_s = ROUND_S[0] if is_done or has != had else min(2 * round_s, ROUND_S[1])
                self.state = LibraryState(len(logs), len(has), not is_done, fault if logs or has else "")
            # What is not done is gone on with, at once if it took its time.
            until_s = (time.monotonic() if known is not None else before_s) + pause_s
            while time.monotonic() < until_s and not ends():  # noqa: ASYNC110 - a signal sets it, not this loop
                await asyncio.sleep(0.2)

    async def _refresh(self, seconds: float) -> tuple[bool, str]:
        """Read what is new. Returns whether that is all, and what is missing."""
        words = ["find", "logs", str(self._directory), "--newest=1", "--catalog", str(self.catalog)]
        done = await ask_review(words, seconds)
        if done.code is None:
            return False, ""
        return True, "" if done.code == ExitCode.OK and self.catalog.exists() else done.fault.rpartition("\n")[2]

    def _cataloged(self) -> set[str]:
        with self._reading:
            return set(self._rows(["file"]).column("file").to_pylist())

    def _learn_tags(self, notes: Signature) -> None:
        if notes == self._notes:
            return
        changed = {name for name, one in notes.items() if self._notes.get(name) != one}
        kept = {name: tags for name, tags in self._tags.items() if name in notes and name not in changed}
        self._tags = kept | {name: tags_of(read_notes(self._directory / name)[0]) for name in changed}
        self._notes = notes

    def tags(self, file: str) -> list[str]:
        """Return the tags of a log, as they were a moment ago."""
        return self._tags.get(notes_path(Path(file)).name, [])

    def all_tags(self) -> list[str]:
        """Return every tag that a log has, in the order of the alphabet."""
        return sorted({tag for tags in list(self._tags.values()) for tag in tags})

    def find(self, words: str, now_ns: int) -> dict[str, Any]:
        """Return the answers to a search, the newest first.

        Args:
            words: as ``cruiser review find`` has them, and besides ``tag=PATTERN`` and ``tag!=PATTERN``.
            now_ns: the present, since 1970.

        Raises:
            CommandError: the words cannot be understood; the text says what can.
        """
        if len(words) > WORDS:
            raise CommandError(f"the search is longer than {WORDS} letters", ExitCode.USAGE)
        rest, tags = _split_tags(words)
        query = read_words(rest, now_ns)
        with self._reading:
            table = self._rows(columns_of(query))
            table = self._tagged(table, tags)
            found, total = newest(table, query, ANSWERS) if table.num_rows else ([], 0)
            near = self._near([one for one in found if isinstance(one, FoundDrive)])
        answers = [{**answer(one, near.get(one.file)), "tags": self.tags(one.file)} for one in reversed(found)]
        return {"subject": query.subject.value, "total": total, "answers": answers}

    def days(self) -> list[LoggedDay]:
        """Return the newest days on which something happened, in their order."""
        with self._reading:
            return days(self._rows(DAYS_COLUMNS))[-DAYS:]

    def log(self, file: str) -> dict[str, Any] | None:
        """Return all that the catalog has of a log; None if it has none of this name."""
        with self._reading:
            table = self._rows(SCHEMA.names)
            rows = table.filter(pc.equal(table.column("file"), file)).to_pylist(maps_as_pydicts="strict")
        return {**whole(msgspec.convert(rows[0], CatalogRow)), "tags": self.tags(file)} if rows else None

    def _rows(self, columns: list[str]) -> pa.Table:
        try:
            return read_table(self.catalog, columns)
        except (FileNotFoundError, CatalogUnreadableError):
            # It is made, or made anew, in a moment.
            return SCHEMA.empty_table().select(columns)

    def _near(self, drives: Sequence[FoundDrive]) -> dict[str, NearDrives]:
        """The part of each log that is shown with these drives, by its file."""
        if not drives:
            return {}
        query = FindQuery(
            FindSubject.MOMENTS,
            kinds=NEAR,
            from_ns=min(one.drive.start_ns for one in drives),
            to_ns=max(one.drive.end_ns for one in drives) + 1,
        )
        table = self._rows([*columns_of(query), "operators"])
        table = table.filter(pc.is_in(table.column("file"), pa.array({one.file for one in drives})))
        near = {
            row["file"]: NearDrives(msgspec.convert(row["operators"], list[LoggedDriver]))
            for row in table.select(["file", "operators"]).to_pylist()
        }
        found = matching(table, query)
        for row in found.slice(max(0, found.num_rows - NEAR_MAX)).to_pylist():
            near[row.pop("file")].moments.append(msgspec.convert(row, LoggedMoment))
        return near

    def _tagged(self, table: pa.Table, tags: list[FindCondition]) -> pa.Table:
        """The rows of the logs that have these tags."""
        if not tags:
            return table
        files = [name for name in table.column("file").to_pylist() if self._has_tags(name, tags)]
        return table.filter(pc.is_in(table.column("file"), pa.array(files, pa.string())))

    def _has_tags(self, file: str, tags: list[FindCondition]) -> bool:
        mine = [tag.lower() for tag in self.tags(file)]
        return all(
            any(fnmatchcase(tag, pattern) for tag in mine for pattern in one.value.lower().split(","))
            == (one.operator == "=")
            for one in tags
        )


def _split_tags(words: str) -> tuple[str, list[FindCondition]]:
    """The words without the conditions on tags, and these."""
    try:
        parts = shlex.split(words)
    except ValueError:
        # Whoever reads them says what is wrong.
        return words, []
    tags = []
    rest = []
    for part in parts:
        field, operator, value = part.partition("!=") if part.startswith("tag!=") else part.partition("=")
        if field == "tag" and operator:
            tags.append(FindCondition(field, operator, value))
        else:
            rest.append(part)
    return shlex.join(rest), tags


def _look(directory: Path) -> tuple[Signature, Signature]:
    """The logs of a directory, and the notes in it. Of a part that may be written the length says nothing."""
    logs: dict[str, tuple[int, int]] = {}
    notes: dict[str, tuple[int, int]] = {}
    try:
        with os.scandir(directory) as entries:
            for entry in entries:
                name = entry.name
                if name.endswith(PART_SUFFIX):
                    logs[name] = (0, 0)
                elif name.endswith((SUFFIX, NOTES_SUFFIX)):
                    try:
                        status = entry.stat(follow_symlinks=False)
                    except OSError:
                        continue
                    (logs if name.endswith(SUFFIX) else notes)[name] = (status.st_size, status.st_mtime_ns)
    except OSError:
        return {}, {}
    return logs, notes

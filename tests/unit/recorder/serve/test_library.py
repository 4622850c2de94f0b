"""The answers of a catalog, as the page has them."""

import asyncio
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import pytest

from recorder.review.catalog.known import CATALOG_NAME
from recorder.review.catalog.rows import INCIDENT, CatalogRow, LoggedDriver
from recorder.review.catalog.table import to_table, write_table
from recorder.serve import library as library_module
from recorder.serve.answers import DRIVE_STOPS
from recorder.serve.library import ANSWERS, Library, LibraryState, _look
from recorder.serve.notes import TagNote, add_note
from schemas.exit_codes import CommandError
from schemas.web.jobs import JobDone
from tests.support.catalog import DRIVE, STOP, row
from tests.support.messages import SECOND, WALL_NS


def library(directory: Path, *rows: CatalogRow) -> Library:
    """The library of a directory with such a catalog."""
    write_table(directory / CATALOG_NAME, to_table(rows))
    return Library(directory, directory)


def answers(of: Library, words: str) -> list[dict[str, Any]]:
    """What is found."""
    return list(of.find(words, WALL_NS)["answers"])


def moment(**changes: Any) -> Any:  # noqa: ANN401 - any field of a moment
    """A stop that is otherwise like STOP."""
    return msgspec.structs.replace(STOP, **changes)


def test_a_drive_has_who_drove_and_its_stops(tmp_path: Path) -> None:
    """Those of its robot and its time; an incident too, whose robot nobody may know."""
    moments = [
        moment(time_ns=WALL_NS - 1, reason="deadman"),
        moment(kind="engaged", is_stop=False, operator="ann", reason="none"),
        STOP,
        moment(time_ns=WALL_NS + 1, robot="cruiser-2", reason="deadman"),
        moment(time_ns=WALL_NS + 2, robot="", kind=INCIDENT, is_stop=False, reason="none"),
        moment(time_ns=DRIVE.end_ns + 1, reason="deadman"),
    ]
    (found,) = answers(library(tmp_path, row(drives=[DRIVE], moments=moments)), "drive")
    assert found["drivers"] == ["ann"]
    assert [(one["kind"], one["reason"]) for one in found["moments"]] == [
        ("stop", "front_bumper"),
        (INCIDENT, "none"),
    ]


def test_who_was_engaged_before_the_log_began_drove(tmp_path: Path) -> None:
    """As far as only one drove in it: of two nobody knows which."""
    ann, bob = (LoggedDriver("cruiser-1", name, 1.0, 1.0) for name in ("ann", "bob"))
    logs = library(tmp_path, row(drives=[DRIVE], operators=[ann]))
    assert answers(logs, "drive")[0]["drivers"] == ["ann"]
    logs = library(tmp_path, row(drives=[DRIVE], operators=[ann, bob]))
    assert answers(logs, "drive")[0]["drivers"] == []


def test_answers_are_bounded_and_the_newest_come_first(tmp_path: Path) -> None:
    """And all are counted; so are the stops of a drive that has very many."""
    moments = [moment(time_ns=WALL_NS + number, last_ns=WALL_NS + number) for number in range(ANSWERS + 7)]
    logs = library(tmp_path, row(drives=[DRIVE], moments=moments))
    found = logs.find("stop", WALL_NS)
    assert (found["total"], len(found["answers"])) == (ANSWERS + 7, ANSWERS)
    assert found["answers"][0]["time"] >= found["answers"][-1]["time"]
    (drive,) = answers(logs, "drive")
    assert (len(drive["moments"]), drive["more_moments"]) == (DRIVE_STOPS, ANSWERS + 7 - DRIVE_STOPS)
    log = logs.log("a.mcap")
    assert log is not None
    assert len(log["moments"]) + log["more_moments"] == ANSWERS + 7


def test_logs_are_found_by_their_tags(tmp_path: Path) -> None:
    """With the other words, and as patterns; large and small letters count alike."""
    logs = library(tmp_path, row(drives=[DRIVE]), row(file="b.mcap", start_ns=WALL_NS + SECOND))
    add_note(tmp_path / "a.notes.jsonl", TagNote(who="ann", tag="Gate-3"))
    add_note(tmp_path / "a.notes.jsonl", TagNote(who="ann", tag="wet"))
    logs._learn_tags(_look(tmp_path)[1])
    assert [one["file"] for one in answers(logs, "log tag=gate-*")] == ["a.mcap"]
    assert [one["file"] for one in answers(logs, "tag!=wet log")] == ["b.mcap"]
    assert answers(logs, "log tag=wet tag=dry,gate-3")[0]["tags"] == ["Gate-3", "wet"]
    assert [one["file"] for one in answers(logs, "drive tag=wet stops>0")] == ["a.mcap"]
    assert answers(logs, "drive tag=dry") == []
    assert logs.all_tags() == ["Gate-3", "wet"]
    add_note(tmp_path / "a.notes.jsonl", TagNote(who="bob", tag="wet", off=True))
    logs._learn_tags(_look(tmp_path)[1])
    assert answers(logs, "log tag=wet") == []


@pytest.mark.parametrize(
    "words", ["drive robot='", "what", "drive robot=nobody", "tag=x nonsense>3", "log lost>many", "stop " * 999]
)
def test_words_that_mean_nothing_are_one_line(tmp_path: Path, words: str) -> None:
    """As on the command line."""
    with pytest.raises(CommandError):
        library(tmp_path, row(drives=[DRIVE])).find(words, WALL_NS)


def test_a_catalog_that_is_not_there_or_damaged_is_empty(tmp_path: Path) -> None:
    """It is made in a moment."""
    logs = Library(tmp_path, tmp_path)
    for content in (None, b"damaged"):
        if content is not None:
            (tmp_path / CATALOG_NAME).write_bytes(content)
        assert answers(logs, "drive robot=cruiser-1") == []
        assert (logs.days(), logs.log("a.mcap")) == ([], None)


def test_where_the_directory_cannot_be_written_the_catalog_is_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The logs of a recorder are its own user's."""
    assert Library(tmp_path, tmp_path / "scratch").catalog.parent == tmp_path
    monkeypatch.setattr("os.access", lambda *_: False)
    assert Library(tmp_path, tmp_path / "scratch").catalog.parent == tmp_path / "scratch"


def test_what_takes_too_long_is_read_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With more time where nothing was done at all; what was done is shown meanwhile."""
    rows = [row(), row(file="b.mcap")]
    for one in rows:
        (tmp_path / one.file).write_bytes(b"log")
    logs = Library(tmp_path, tmp_path)
    given_s: list[float] = []
    seen: list[tuple[int, bool]] = []

    async def ask_slowly(_words: list[str], seconds: float) -> JobDone:
        seen.append((logs.state.cataloged, logs.state.is_reading))
        given_s.append(seconds)
        if len(given_s) < 3:
            return JobDone(None, b"", "no answer")
        write_table(logs.catalog, to_table(rows[: len(given_s) - 2]))
        return JobDone(0 if len(given_s) == 4 else None, b"", "")

    monkeypatch.setattr(library_module, "ask_review", ask_slowly)
    monkeypatch.setattr(library_module, "LOOK_S", (0.0, 0.0))
    asyncio.run(asyncio.wait_for(logs.keep_current(lambda: logs.state == LibraryState(2, 2)), 60))
    assert given_s == [30.0, 60.0, 120.0, 30.0]
    assert seen == [(0, True), (0, True), (0, True), (1, True)]


def test_what_fails_at_once_is_tried_again_after_a_pause(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody may hold all files that the server can open: no process starts, and hurry would help nobody."""
    (tmp_path / "a.mcap").write_bytes(b"log")
    logs = Library(tmp_path, tmp_path)
    tried_s: list[float] = []

    async def not_started(*_: object) -> JobDone:
        tried_s.append(time.monotonic())
        return JobDone(None, b"", "no process can be started: Too many open files")

    monkeypatch.setattr(library_module, "ask_review", not_started)
    monkeypatch.setattr(library_module, "LOOK_S", (0.5, 0.5))
    asyncio.run(asyncio.wait_for(logs.keep_current(lambda: len(tried_s) == 3), 60))
    assert all(later - earlier >= 0.5 for earlier, later in pairwise(tried_s))
    assert logs.state == LibraryState(1, 0, is_reading=True)


def test_a_log_that_came_and_went_while_the_catalog_was_made_is_not_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two looks at the directory are equal, and the catalog between them saw it."""
    (tmp_path / "\udcfc.mcap").write_bytes(b"log")
    stays, goes = row(file="\\xfc.mcap"), row(file="b.mcap")
    logs = Library(tmp_path, tmp_path)
    seen: list[int] = []

    async def ask(*_: object) -> JobDone:
        seen.append(logs.state.cataloged)
        write_table(logs.catalog, to_table([stays, goes] if len(seen) == 1 else [stays]))
        return JobDone(0, b"", "")

    monkeypatch.setattr(library_module, "ask_review", ask)
    monkeypatch.setattr(library_module, "LOOK_S", (0.0, 0.0))
    asyncio.run(asyncio.wait_for(logs.keep_current(lambda: logs.state == LibraryState(1, 1)), 60))
    assert seen == [0, 2]


def test_a_catalog_that_cannot_be_made_anew_is_not_tried_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has a log that is gone, and stays as it is until the directory changes."""
    logs = library(tmp_path, row())
    asked: list[object] = []
    looks: list[Path] = []

    async def ask(*words: object) -> JobDone:
        asked.append(words)
        return JobDone(1, b"", "cruiser review: cannot write the catalog")

    def look(directory: Path) -> Any:  # noqa: ANN401 - what the library's own look gives
        looks.append(directory)
        return _look(directory)

    monkeypatch.setattr(library_module, "ask_review", ask)
    monkeypatch.setattr(library_module, "_look", look)
    monkeypatch.setattr(library_module, "LOOK_S", (0.0, 0.0))
    asyncio.run(asyncio.wait_for(logs.keep_current(lambda: len(looks) == 4), 60))
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("done", "fault"),
    [
        (JobDone(3, b"", "a\ncruiser review: 1 of 1 logs are damaged"), "cruiser review: 1 of 1 logs are damaged"),
        (JobDone(1, b"", "cruiser review: cannot read logs: gone"), "cruiser review: cannot read logs: gone"),
        (JobDone(0, b"", "cruiser review: b.mcap.part is being written, and not in the answer yet"), ""),
    ],
)
def test_what_could_not_be_read_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, done: JobDone, fault: str
) -> None:
    """In one line; a log that is being written is none."""
    (tmp_path / "a.mcap").write_bytes(b"log")
    logs = library(tmp_path, row())

    async def answered(*_: object) -> JobDone:
        return done

    monkeypatch.setattr(library_module, "ask_review", answered)
    asyncio.run(asyncio.wait_for(logs.keep_current(lambda: logs.state.cataloged == 1), 60))
    assert logs.state == LibraryState(1, 1, is_reading=False, fault=fault)

"""Tags and comments beside a log."""

import fcntl
import json
import os
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.serve.notes import (
    NOTE_BYTES,
    NOTES_BYTES,
    CommentNote,
    NoteRefusedError,
    TagNote,
    add_note,
    notes_path,
    read_note,
    read_notes,
    tags_of,
)
from schemas.exit_codes import CommandError
from tests.support.waiting import wait_until

NOW = "2026-01-02T03:04:05Z"


def add_many(path: Path, who: str) -> None:
    """Write as one of several writers."""
    for number in range(50):
        add_note(path, CommentNote(who=who, text=f"{number} " + "x" * 500))


def test_of_what_several_write_at_once_nothing_is_lost(tmp_path: Path) -> None:
    """Threads of one server, and another server on the same directory."""
    path = tmp_path / "a.notes.jsonl"
    other = get_context("spawn").Process(target=add_many, args=(path, "other"))
    other.start()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda who: add_many(path, who), ["ann", "bob", "cid", "dan"]))
    other.join()
    notes, unread = read_notes(path)
    assert (len(notes), unread) == (250, 0)
    for who in ("ann", "other"):
        texts = [note.text for note in notes if isinstance(note, CommentNote) and note.who == who]
        assert [int(text.split()[0]) for text in texts] == list(range(50))


def test_whoever_writes_waits_for_the_one_who_does(tmp_path: Path) -> None:
    """The room in a file is looked at by one at a time: else two would take the last of it."""
    path = tmp_path / "a.notes.jsonl"
    with path.open("wb") as stream, ThreadPoolExecutor(1) as pool:
        fcntl.flock(stream, fcntl.LOCK_EX)
        inode = f":{os.fstat(stream.fileno()).st_ino} "
        writing = pool.submit(add_note, path, CommentNote(who="ann", text="x"))
        # The kernel marks who waits for a lock.
        wait_until(
            lambda: any("->" in line and inode in line for line in Path("/proc/locks").read_text().splitlines())
        )
        stream.write(b"\n" * (NOTES_BYTES - 1))
        stream.flush()
        fcntl.flock(stream, fcntl.LOCK_UN)
        with pytest.raises(CommandError, match="is full"):
            writing.result()


def test_a_line_that_was_cut_off_costs_no_other(tmp_path: Path) -> None:
    """The power failed while somebody wrote: what comes next begins on a line of its own."""
    path = tmp_path / "a.notes.jsonl"
    add_note(path, CommentNote(who="ann", text="first"))
    with path.open("ab") as stream:
        stream.write(b'{"is":"comment","who":"b')
    add_note(path, CommentNote(who="cid", text="last"))
    notes, unread = read_notes(path)
    assert [note.who for note in notes] == ["ann", "cid"]
    assert unread == 1


def test_a_file_takes_so_much_and_no_more(tmp_path: Path) -> None:
    """What is in it stays, and whoever writes is told; somebody else's larger file is read to the bound."""
    path = tmp_path / "a.notes.jsonl"
    note = CommentNote(who="ann", text="x" * 2000)
    while path.stat().st_size < NOTES_BYTES - 2100 if path.exists() else True:
        add_note(path, note)
    with pytest.raises(CommandError, match=r"a\.notes\.jsonl is full"):
        add_note(path, note)
    assert path.stat().st_size <= NOTES_BYTES
    assert read_notes(path)[1] == 0
    path.write_bytes(b"{}\n" * NOTES_BYTES)
    assert read_notes(path) == ([], NOTES_BYTES // 3 + 1)


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    """Neither to read nor to write: it may lead anywhere."""
    (tmp_path / "secret").write_text('{"is":"comment","who":"a","text":"b"}\n')
    (tmp_path / "a.notes.jsonl").symlink_to(tmp_path / "secret")
    assert read_notes(tmp_path / "a.notes.jsonl") == ([], 0)
    with pytest.raises(CommandError, match="cannot write"):
        add_note(tmp_path / "a.notes.jsonl", CommentNote(who="ann", text="x"))


def test_a_tag_is_put_on_and_taken_off() -> None:
    """The last word counts; the order is that in which they came."""
    notes = [
        TagNote(who="a", tag=tag, off=off) for tag, off in (("x", False), ("y", False), ("x", True), ("z", False))
    ]
    assert tags_of([*notes, CommentNote(who="a", text="x")]) == ["y", "z"]
    assert tags_of([*notes, TagNote(who="b", tag="x")]) == ["y", "z", "x"]


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"is": "comment", "who": "ann", "text": " "}, "is empty"),
        ({"is": "comment", "who": " ", "text": "x"}, "name"),
        ({"is": "comment", "who": "a\nb", "text": "x"}, "name"),
        ({"is": "comment", "who": "ann", "text": "x" * 2001}, "no note"),
        ({"is": "comment", "who": "ann", "text": "x", "at": "yesterday"}, "no time"),
        ({"is": "comment", "who": "ann", "text": "x", "role": "admin"}, "no note"),
        ({"is": "tag", "who": "ann", "tag": "two words"}, "no note"),
        ({"is": "tag", "who": "ann", "tag": "<b>"}, "no note"),
        ({"is": "other", "who": "ann"}, "no note"),
        ([], "no note"),
    ],
)
def test_what_is_not_of_its_form_is_refused(said: object, why: str) -> None:
    """In a line that says what is wrong."""
    with pytest.raises(NoteRefusedError, match=why):
        read_note(json.dumps(said).encode(), NOW)


@given(st.binary(max_size=NOTE_BYTES + 10))
def test_whatever_a_browser_sends_is_a_note_or_refused(data: bytes) -> None:
    """Nothing else."""
    try:
        note = read_note(data, NOW)
    except NoteRefusedError:
        return
    assert note.time == NOW


@given(st.text(min_size=1, max_size=500).filter(str.strip))
def test_a_text_is_read_as_it_was_written(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    """Line ends, quotes and any other character; the time is the server's own, whatever a browser claims."""
    path = tmp_path_factory.mktemp("notes") / "a.notes.jsonl"
    try:
        sent = msgspec.json.encode(CommentNote(who="ann", text=text, time="1999"))
    except UnicodeEncodeError:
        return
    note = read_note(sent, NOW)
    add_note(path, note)
    assert read_notes(path) == ([CommentNote(who="ann", text=text, time=NOW)], 0)


def test_notes_stay_with_a_log_that_becomes_whole() -> None:
    """A log that is being written is called otherwise."""
    whole = notes_path(Path("logs/a.mcap"))
    assert whole == notes_path(Path("logs/a.mcap.part")) == Path("logs/a.notes.jsonl")

"""The note that says which logs are safe elsewhere."""

from pathlib import Path

import pytest

from recorder.disk import files
from recorder.disk.files import NAME, SafeLogReader, UploadedLog, UploadNote
from schemas.command_line import CommandError

LOG = "cruiser-1-20270115T080000Z.mcap"


def line(name: str = LOG, size: int = 7, modified_ns: int = 1) -> UploadedLog:
    return UploadedLog(name, size, modified_ns, "00", "s3://logs", name)


def test_the_next_start_knows_what_was_safe(tmp_path: Path) -> None:
    """A reader that looked before sees it as well."""
    reader = SafeLogReader(tmp_path)
    assert reader.read() == {}
    with UploadNote(tmp_path) as note:
        note.add(line())
        assert note.safe() == {LOG: (7, 1, "00")}
    assert reader.read() == SafeLogReader(tmp_path).read() == {LOG: (7, 1, "00")}


@pytest.mark.parametrize("torn", [b"", b"\n", b'{"file":"b', b"\xff\x00", b"[]\n", b'{"file":"b"}\n'])
def test_a_line_that_was_torn_costs_itself_alone(tmp_path: Path, torn: bytes) -> None:
    """By a power cut; the lines before it and after it hold."""
    with UploadNote(tmp_path) as note:
        note.add(line("a"))
    with (tmp_path / NAME).open("ab") as stream:
        stream.write(torn)
    with UploadNote(tmp_path) as note:
        note.add(line("c"))
        assert note.safe() == {"a": (7, 1, "00"), "c": (7, 1, "00")}


def test_logs_that_are_gone_are_forgotten_once_they_are_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The note does not grow for as long as the robot lives."""
    monkeypatch.setattr(files, "GONE_LINES", 3)
    with UploadNote(tmp_path) as note:
        for name in "abcd":
            note.add(line(name))
        note.forget({"a", "b"})
        assert set(note.safe()) == set("abcd")
        note.forget({"b"})
        assert set(note.safe()) == {"b"}
        note.add(line("e"))
    assert set(SafeLogReader(tmp_path).read()) == {"b", "e"}


def test_a_note_that_is_no_file_marks_nothing(tmp_path: Path) -> None:
    """Retention is as it was before, and an upload says why it does not begin."""
    (tmp_path / NAME).mkdir()
    assert SafeLogReader(tmp_path).read() == {}
    with pytest.raises(CommandError, match="directory"):
        UploadNote(tmp_path)

"""What a recorder in signed mode keeps of its authority across a restart."""

import stat
from pathlib import Path

import pytest

from recorder.disk.order_note import NAME, read_note, save_note
from recorder.record.admission import OrderNote
from schemas.exit_codes import CommandError, ExitCode


def test_what_was_saved_is_read(tmp_path: Path) -> None:
    """The newest; nothing before the first. It is its owner's alone."""
    assert read_note(tmp_path) == OrderNote()
    for note in (OrderNote(["one"]), OrderNote(["one", "two"])):
        save_note(tmp_path, note)
        assert read_note(tmp_path) == note
    assert stat.S_IMODE((tmp_path / NAME).stat().st_mode) == 0o600
    assert [path.name for path in tmp_path.iterdir()] == [NAME]


@pytest.mark.parametrize("content", [b"", b"junk", b"[]", b"\xff"])
def test_a_damaged_file_is_no_empty_one(tmp_path: Path, content: bytes) -> None:
    """Who was revoked would be let in again."""
    (tmp_path / NAME).write_bytes(content)
    with pytest.raises(CommandError, match=r"authority\.json is damaged.*remove it") as raised:
        read_note(tmp_path)
    assert raised.value.code == ExitCode.USAGE


def test_a_disk_that_takes_nothing_stops_no_recorder(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It is said."""
    save_note(tmp_path / "gone", OrderNote(["one"]))
    assert "cannot be written" in caplog.text

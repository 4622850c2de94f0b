"""What every file of a log begins with. Files are tested through ``LogDirectory``, which begins them."""

from io import BytesIO

import pytest
from mcap.reader import make_reader

from recorder.disk import files
from recorder.disk.files import Prologue
from recorder.mcap.writer import LogChannel, McapFile
from recorder.record.actions import CloseLog, DeclareChannel, LogAction, SyncLog, WriteAttachment, WriteMetadata


def written(prologue: Prologue) -> tuple[list[dict[str, str]], list[tuple[str, bytes]], list[str]]:
    """Metadata, attachments and topics of a file that begins so."""
    stream = BytesIO()
    file = McapFile(stream, "test")
    prologue.write_to(file)
    file.finish()
    reader = make_reader(BytesIO(stream.getvalue()), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    return (
        [one.metadata for one in reader.iter_metadata()],
        [(one.name, one.data) for one in reader.iter_attachments()],
        [channel.topic for channel in summary.channels.values()],
    )


def test_channels_and_the_newest_of_what_lasts_are_repeated() -> None:
    """Metadata and attachments by name; nothing that belongs to one file alone. A copy goes its own way."""
    prologue = Prologue()
    actions: list[LogAction] = [
        DeclareChannel("x", LogChannel(1, "t/1", "s", b"")),
        WriteMetadata("x", "cruiser", {"a": "1"}, lasts=True),
        WriteAttachment("x", "a", "text/plain", b"1", 1),
        WriteMetadata("x", "cruiser.once", {}),
        WriteMetadata("x", "cruiser", {"a": "2"}, lasts=True),
        WriteAttachment("x", "a", "text/plain", b"2", 2),
        SyncLog("x"),
        CloseLog("x"),
    ]
    for action in actions:
        prologue.add(action)
    copied = prologue.copy()
    prologue.add(DeclareChannel("x", LogChannel(2, "t/2", "s", b"")))
    assert written(prologue) == ([{"a": "2"}], [("a", b"2")], ["t/1", "t/2"])
    assert written(copied) == ([{"a": "2"}], [("a", b"2")], ["t/1"])


def test_names_without_end_cost_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot may name its DBC anew for ever: the oldest attachments go."""
    monkeypatch.setattr(files, "ATTACHMENTS_MAX", 3)
    prologue = Prologue()
    for number in (1, 2, 3, 1, 4):
        prologue.add(WriteAttachment("x", f"a/{number}", "text/plain", b"", number))
    assert [name for name, _ in written(prologue)[1]] == ["a/3", "a/1", "a/4"]

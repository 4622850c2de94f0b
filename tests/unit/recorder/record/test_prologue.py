"""What a file that continues another begins with."""

import pytest

from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import ChunkBuilder
from recorder.record import prologue as prologue_module
from recorder.record.effects import CloseLog, DeclareChannel, SyncLog, WriteAttachment, WriteChunk, WriteMetadata
from recorder.record.prologue import Prologue


def test_channels_and_the_newest_of_what_lasts_are_repeated() -> None:
    """Metadata and attachments by name; nothing that belongs to one file alone."""
    prologue = Prologue()
    builder = ChunkBuilder()
    builder.add(1, 0, 0, 0, b"")
    chunk = builder.seal()
    assert chunk is not None
    channels = [DeclareChannel(LogChannel(number, f"t/{number}", "s", b"")) for number in (1, 2)]
    attachment = WriteAttachment("a", "text/plain", b"2", 2)
    for effect in (
        channels[0],
        WriteMetadata("cruiser", {"a": "1"}, lasts=True),
        WriteAttachment("a", "text/plain", b"1", 1),
        WriteChunk(chunk),
        WriteMetadata("cruiser.received", {}),
        WriteMetadata("cruiser", {"a": "2"}, lasts=True),
        attachment,
        channels[1],
        SyncLog(),
        CloseLog(),
    ):
        prologue.take(effect)
    assert prologue.effects == [WriteMetadata("cruiser", {"a": "2"}, lasts=True), attachment, *channels]


def test_names_without_end_cost_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot may name its DBC anew for ever: the oldest attachments go."""
    monkeypatch.setattr(prologue_module, "ATTACHMENTS_MAX", 3)
    prologue = Prologue()
    for number in (1, 2, 3, 1, 4):
        prologue.take(WriteAttachment(f"a/{number}", "text/plain", b"", number))
    assert [one.name for one in prologue.effects if isinstance(one, WriteAttachment)] == ["a/3", "a/1", "a/4"]

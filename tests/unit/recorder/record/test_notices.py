"""What a person is told of what became of files."""

import pytest

from recorder.record.actions import (
    FULL,
    ROOM,
    Deleted,
    DiskBack,
    DiskFault,
    DiskRoom,
    Ended,
    Lost,
    Notice,
    Opened,
    Recovered,
    announcement_of,
)
from schemas.decisions import Severity
from schemas.recording import RecorderEventKind


@pytest.mark.parametrize(
    ("notice", "kind", "severity", "file", "text"),
    [
        (DiskFault("it is gone"), RecorderEventKind.DISK, Severity.ERROR, "", "it is gone"),
        (DiskBack(), RecorderEventKind.DISK, Severity.INFO, "", "again"),
        (Deleted("a.mcap", 7), RecorderEventKind.DELETED, Severity.INFO, "a.mcap", "7 bytes"),
        (Lost("a", {1: 3, 2: 4}, 0, 0, "a.mcap"), RecorderEventKind.DISK, Severity.ERROR, "a.mcap", "7 messages"),
        (Recovered("a.mcap", 7), RecorderEventKind.RECOVERED, Severity.INFO, "a.mcap", "7 messages"),
    ],
)
def test_what_is_worth_telling_is_told(
    notice: Notice, kind: RecorderEventKind, severity: Severity, file: str, text: str
) -> None:
    """With the file that it is about, also by its name in the text, and what is to be known of it."""
    word = announcement_of(notice)
    assert word is not None
    assert (word.kind, word.severity, word.file) == (kind, severity, file)
    assert file in word.text
    assert text in word.text


@pytest.mark.parametrize(
    "notice",
    [Opened("a", "b"), Ended("a", "b", 1), Lost("a", {}, 0, 0), DiskRoom(has_room=True, has_incident_room=True)],
)
def test_what_happens_all_the_time_is_not(notice: Notice) -> None:
    """Files come and go; losses are told as gaps, and room where it makes a difference."""
    assert announcement_of(notice) is None


def test_what_ends_a_recording_is_no_mere_information() -> None:
    """What begins it again is; and room on the disk does not claim that a recorder that stands by records."""
    assert [word.severity for word in (FULL, ROOM)] == [Severity.ERROR, Severity.INFO]
    assert "recording" not in ROOM.text

"""What operators ask of a recorder, and the replies: some come when a file has been opened or ended. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

import msgspec

from recorder.record.effects import Doing
from recorder.record.notices import Ended, Notice, Opened
from recorder.record.recording import Recording
from schemas.codec import PayloadFault
from schemas.recording import (
    Backfill,
    BackfillPiece,
    Mark,
    RecorderHealth,
    RecorderReply,
    RecorderState,
    Split,
    Start,
    StopRecording,
)
from schemas.requests import Request

REPLY_NS: Final = 2_000_000_000
"""A reply that waits for the disk waits no longer; then it says so."""


class Asked(Protocol):
    """A request, and how to answer it."""

    @property
    def operator(self) -> str:
        """Who asks."""
        ...

    @property
    def request(self) -> Request | PayloadFault:
        """What is asked, or what is wrong with it."""
        ...

    @property
    def reply(self) -> Callable[[RecorderReply | BackfillPiece], None]:
        """Sends a reply."""
        ...

    @property
    def done(self) -> Callable[[], None]:
        """Says that no more will come."""
        ...


class _Pending(msgspec.Struct):
    """A reply that waits until files of these logs are opened, or ended."""

    asked: Asked
    detail: str
    awaits: set[str]
    notice: type[Opened | Ended]
    until_ns: int
    files: list[str]


class Orders:
    """Carries requests out on a recording.

    Args:
        recording: what is recorded.
        health: the recorder's, as it is now.
        backfill: answers such a request, on a thread of its own.
    """

    def __init__(
        self, recording: Recording, health: Callable[[], RecorderHealth], backfill: Callable[[Asked], None]
    ) -> None:
        self._recording = recording
        self._health = health
        self._backfill = backfill
        self._pending: list[_Pending] = []

    def take(self, asked: Asked, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        """Do what is asked. Nothing in a request raises."""
        recording, request = self._recording, asked.request
        writing = recording.writing
        doings: Sequence[Doing] = ()
        match request:
            case PayloadFault():
                self._refuse(asked, request.detail)
            case Backfill():
                self._backfill(asked)
            case Start():
                doings = recording.start(asked.operator, now_ns, wall_ns)
                self._answer(asked, _STATES[recording.state], [])
            case StopRecording():
                doings = recording.stop(asked.operator, now_ns, wall_ns)
                self._wait(asked, _STATES[recording.state], writing, Ended, now_ns)
            case Split():
                doings = recording.roll("split", now_ns)
                detail = "the next samples begin new files" if writing else "no file is being written"
                self._wait(asked, detail, writing, Ended, now_ns)
            case Mark():
                doings = self._mark(asked, request, now_ns, wall_ns)
            case _:
                self._answer(asked, _STATES[recording.state], sorted(recording.files.values()))
        return doings

    def take_notice(self, notice: Notice) -> None:
        """A file was opened or ended: somebody may wait for that."""
        if not self._pending or not isinstance(notice, Opened | Ended):
            return
        for one in self._pending:
            if isinstance(notice, one.notice) and notice.log in one.awaits:
                one.awaits.discard(notice.log)
                one.files.append(notice.file)

    def tick(self, now_ns: int) -> None:
        """Send the replies that are due."""
        due = [one for one in self._pending if not one.awaits or now_ns >= one.until_ns]
        for one in due:
            self._pending.remove(one)
            late = "; the disk has not done it yet" if one.awaits else ""
            self._answer(one.asked, one.detail + late, sorted(one.files))

    def _mark(self, asked: Asked, mark: Mark, now_ns: int, wall_ns: int) -> Sequence[Doing]:
        because = f"mark by {asked.operator}: {mark.text}" if mark.text else f"mark by {asked.operator}"
        marked, doings = self._recording.mark(mark.robot, because, now_ns, wall_ns)
        if marked:
            opened = [file for file in marked.values() if file]
            awaits = {name for name, file in marked.items() if not file}
            self._wait(asked, "an incident keeps what came before and after", awaits, Opened, now_ns, opened)
        elif not self._recording.has_incident_room:
            self._refuse(asked, "the disk may hold no more incidents")
        else:
            whose = f"of {mark.robot} " if mark.robot else ""
            self._refuse(asked, f"nothing {whose}has been heard")
        return doings

    def _wait(
        self,
        asked: Asked,
        detail: str,
        awaits: set[str],
        notice: type[Opened | Ended],
        now_ns: int,
        files: Sequence[str] = (),
    ) -> None:
        self._pending.append(_Pending(asked, detail, set(awaits), notice, now_ns + REPLY_NS, list(files)))
        self.tick(now_ns)

    def _answer(self, asked: Asked, detail: str, files: list[str]) -> None:
        asked.reply(RecorderReply(ok=True, detail=detail, files=files, health=self._health()))
        asked.done()

    def _refuse(self, asked: Asked, detail: str) -> None:
        if isinstance(asked.request, Backfill):
            asked.reply(refusal(detail))
        else:
            asked.reply(RecorderReply(ok=False, detail=detail, files=[], health=self._health()))
        asked.done()


def refusal(detail: str) -> BackfillPiece:
    """A backfill that is refused."""
    return BackfillPiece(ok=False, detail=detail, mcap=b"", messages=0, next_ns=0, is_last=True)


_STATES: Final = {
    RecorderState.RECORDING: "recording",
    RecorderState.STOPPED: "stopped: nothing is written but incidents",
    RecorderState.FULL: "the disk may hold no more: nothing is written but incidents",
}

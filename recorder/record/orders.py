"""Requests of operators to a recorder, and the replies: some wait until a file is opened or ended. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import msgspec

from recorder.record.actions import Action
from recorder.record.notices import Ended, Notice, Opened
from recorder.record.recorder import Recorder
from schemas.codec import PayloadFault
from schemas.recording import (
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
"""The longest wait of a reply for the disk; one that ends so says so."""


class OperatorRequest(msgspec.Struct, frozen=True):
    """A request, and how to answer it.

    Attributes:
        operator: the sender.
        request: the request, or the fault of the payload.
        reply: sends the reply.
        done: reports that it was sent; whoever answers must call it.
    """

    operator: str
    request: Request | PayloadFault
    reply: Callable[[RecorderReply], None]
    done: Callable[[], None]


class _Pending(msgspec.Struct):
    """A reply that waits until files of these logs are opened, or ended."""

    asked: OperatorRequest
    detail: str
    awaits: set[str]
    notice: type[Opened | Ended]
    until_ns: int
    files: list[str]


class Orders:
    """Executes requests on a recorder.

    Args:
        recorder: executes them.
        health: returns the recorder's present health.
    """

    def __init__(self, recorder: Recorder, health: Callable[[], RecorderHealth]) -> None:
        self._recorder = recorder
        self._health = health
        self._pending: list[_Pending] = []

    def obey(self, asked: OperatorRequest, now_ns: int, wall_ns: int) -> Sequence[Action]:
        """Do what a request asks. Nothing in a request raises."""
        recorder, request = self._recorder, asked.request
        writing = recorder.writing
        actions: Sequence[Action] = ()
        match request:
            case PayloadFault():
                self._refuse(asked, request.detail)
            case Start():
                actions = recorder.start(asked.operator, now_ns, wall_ns)
                self._answer(asked, _STATES[recorder.state], [])
            case StopRecording():
                actions = recorder.stop(asked.operator, now_ns, wall_ns)
                self._wait(asked, _STATES[recorder.state], writing, Ended, now_ns)
            case Split():
                actions = recorder.roll("split", now_ns)
                detail = "the next samples begin new files" if writing else "no file is being written"
                self._wait(asked, detail, writing, Ended, now_ns)
            case Mark():
                actions = self._mark(asked, request, now_ns, wall_ns)
            case _:
                self._answer(asked, _STATES[recorder.state], sorted(recorder.files.values()))
        return actions

    def receive_notice(self, notice: Notice) -> None:
        """Note a file that was opened or ended: a reply may wait for that."""
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

    def _mark(self, asked: OperatorRequest, mark: Mark, now_ns: int, wall_ns: int) -> Sequence[Action]:
        because = f"mark by {asked.operator}: {mark.text}" if mark.text else f"mark by {asked.operator}"
        marked, actions = self._recorder.mark(mark.robot, because, now_ns, wall_ns)
        if marked:
            opened = [file for file in marked.values() if file]
            awaits = {name for name, file in marked.items() if not file}
            self._wait(asked, "an incident keeps what came before and after", awaits, Opened, now_ns, opened)
        elif not self._recorder.has_incident_room:
            self._refuse(asked, "the disk may hold no more incidents")
        else:
            whose = f"of {mark.robot} " if mark.robot else ""
            self._refuse(asked, f"nothing {whose}has been heard")
        return actions

    def _wait(
        self,
        asked: OperatorRequest,
        detail: str,
        awaits: set[str],
        notice: type[Opened | Ended],
        now_ns: int,
        files: Sequence[str] = (),
    ) -> None:
        self._pending.append(_Pending(asked, detail, set(awaits), notice, now_ns + REPLY_NS, list(files)))
        self.tick(now_ns)

    def _answer(self, asked: OperatorRequest, detail: str, files: list[str]) -> None:
        asked.reply(RecorderReply(ok=True, detail=detail, files=files, health=self._health()))
        asked.done()

    def _refuse(self, asked: OperatorRequest, detail: str) -> None:
        asked.reply(RecorderReply(ok=False, detail=detail, files=[], health=self._health()))
        asked.done()


_STATES: Final = {
    RecorderState.RECORDING: "recording",
    RecorderState.STOPPED: "stopped: nothing is written but incidents",
    RecorderState.FULL: "the disk may hold no more: nothing is written but incidents",
}

"""The questions that a recorder answers from afar, ``status`` and ``mark``, and the replies. Pure.

Nobody signs them: whoever reaches the recorder may ask. So marks are bounded: see ``MARKS_AT_ONCE``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import msgspec

from recorder.record.actions import Action, Notice, Opened
from recorder.record.recorder import Recorder
from schemas.codec import PayloadFault
from schemas.recording import Mark, RecorderHealth, RecorderReply, RecorderState
from schemas.requests import Request

REPLY_NS: Final = 2_000_000_000  # the longest wait of a reply for the disk; one that ends so says so

MARKS_AT_ONCE: Final = 6
"""Marks that may follow each other closely. Their incidents take room that those of a fault may need."""

MARK_EVERY_NS: Final = 300_000_000_000
"""After them one more is taken in so long: a flood of marks keeps a fifth of what is recorded at most."""


class OperatorRequest(msgspec.Struct, frozen=True):
    """A request, and how to answer it.

    Attributes:
        request: the request, or the fault of the payload.
        reply: sends the reply, of which there must be one.
    """

    operator: str
    request: Request | PayloadFault
    reply: Callable[[RecorderReply], None]


class _Pending(msgspec.Struct):
    """A reply to a mark that waits until files of these logs are opened."""

    asked: OperatorRequest
    awaits: set[str]
    until_ns: int
    files: list[str]


class Orders:
    """Executes requests on a recorder.

    Args:
        has_mark_room: returns whether marks may take more of the budget.
    """

    def __init__(
        self, recorder: Recorder, health: Callable[[], RecorderHealth], has_mark_room: Callable[[], bool]
    ) -> None:
        self._recorder = recorder
        self._health = health
        self._has_mark_room = has_mark_room
        self._pending: list[_Pending] = []
        self._spent_to_ns = 0  # the time until which the marks that were taken have used up what is allowed

    def obey(self, asked: OperatorRequest, now_ns: int, wall_ns: int) -> Sequence[Action]:
        """Do what a request asks. Nothing in a request raises."""
        match asked.request:
            case PayloadFault():
                self._answer(asked, asked.request.detail, [], ok=False)
            case Mark():
                return self._mark(asked, asked.request, now_ns, wall_ns)
            case _:
                self._answer(asked, _STATES[self._recorder.state], sorted(self._recorder.files.values()))
        return ()

    def receive_notice(self, notice: Notice) -> None:
        """Note a file that was opened: a reply may wait for that."""
        if not isinstance(notice, Opened):
            return
        for one in self._pending:
            if notice.log in one.awaits:
                one.awaits.discard(notice.log)
                one.files.append(notice.file)

    def tick(self, now_ns: int) -> None:
        due = [one for one in self._pending if not one.awaits or now_ns >= one.until_ns]
        for one in due:
            self._pending.remove(one)
            late = "; the disk has not done it yet" if one.awaits else ""
            self._answer(one.asked, f"an incident keeps what came before and after{late}", sorted(one.files))

    def _mark(self, asked: OperatorRequest, mark: Mark, now_ns: int, wall_ns: int) -> Sequence[Action]:
        spent_to_ns = max(now_ns, self._spent_to_ns)
        wait_ns = spent_to_ns - now_ns - (MARKS_AT_ONCE - 1) * MARK_EVERY_NS
        if wait_ns > 0:
            self._answer(asked, f"too many marks; the next one is taken in {wait_ns / 1e9:.0f} s", [], ok=False)
            return ()
        # On a full disk the reserve is for incidents of faults.
        is_full = self._recorder.state is RecorderState.FULL
        if is_full or not self._recorder.has_incident_room or not self._has_mark_room():
            self._answer(asked, "the disk has no more room for marks", [], ok=False)
            return ()
        because = f"mark by {asked.operator}: {mark.text}" if mark.text else f"mark by {asked.operator}"
        marked, actions = self._recorder.mark(mark.robot, because, now_ns, wall_ns)
        if marked:
            self._spent_to_ns = spent_to_ns + MARK_EVERY_NS
            opened = [file for file in marked.values() if file]
            awaits = {name for name, file in marked.items() if not file}
            self._pending.append(_Pending(asked, awaits, now_ns + REPLY_NS, opened))
            self.tick(now_ns)
        else:
            whose = f"of {mark.robot} " if mark.robot else ""
            self._answer(asked, f"nothing {whose}has been heard", [], ok=False)
        return actions

    def _answer(self, asked: OperatorRequest, detail: str, files: list[str], *, ok: bool = True) -> None:
        asked.reply(RecorderReply(ok=ok, detail=detail, files=files, health=self._health()))


_STATES: Final = {
    RecorderState.RECORDING: "recording",
    RecorderState.STOPPED: "standing by: nothing is written but incidents",
    RecorderState.FULL: "the disk may hold no more: nothing is written but incidents",
}

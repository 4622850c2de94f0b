"""The remote requests to a recorder, ``status`` and ``mark``, and the replies. Pure.

Requests are unsigned: any client may send them. So marks are bounded: see ``MARKS_AT_ONCE``.
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

REPLY_NS: Final = 2_000_000_000  # longest wait of a reply for the disk

MARKS_AT_ONCE: Final = 6  # marks in a burst: their incidents take disk space that incidents of faults may need
MARK_EVERY_NS: Final = 300_000_000_000
"""Interval of further marks: a flood of them preserves at most a fifth of the recording."""


class OperatorRequest(msgspec.Struct, frozen=True):
    """A request, or the fault of its payload; ``reply`` must be called once."""

    operator: str
    request: Request | PayloadFault
    reply: Callable[[RecorderReply], None]


class _Pending(msgspec.Struct):
    """A reply to a mark that waits for files of these logs to be opened."""

    asked: OperatorRequest
    awaits: set[str]
    until_ns: int
    files: list[str]


class Orders:
    """Executes requests on a recorder; ``has_mark_room`` returns whether marks may use more disk space."""

    def __init__(
        self, recorder: Recorder, health: Callable[[], RecorderHealth], has_mark_room: Callable[[], bool]
    ) -> None:
        self._recorder = recorder
        self._health = health
        self._has_mark_room = has_mark_room
        self._pending: list[_Pending] = []
        self._spent_to_ns = 0  # the accepted marks use up the allowance until this time

    def handle(self, asked: OperatorRequest, now_ns: int, wall_ns: int) -> Sequence[Action]:
        """Execute a request. Nothing in a request raises."""
        match asked.request:
            case PayloadFault():
                self._answer(asked, asked.request.detail, [], ok=False)
            case Mark():
                return self._mark(asked, asked.request, now_ns, wall_ns)
            case _:
                self._answer(asked, _STATES[self._recorder.state], sorted(self._recorder.files.values()))
        return ()

    def receive_notice(self, notice: Notice) -> None:
        """Note an opened file: a reply may wait for it."""
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
            late = "; not yet on disk" if one.awaits else ""
            self._answer(one.asked, f"incident recorded{late}", sorted(one.files))

    def _mark(self, asked: OperatorRequest, mark: Mark, now_ns: int, wall_ns: int) -> Sequence[Action]:
        spent_to_ns = max(now_ns, self._spent_to_ns)
        wait_ns = spent_to_ns - now_ns - (MARKS_AT_ONCE - 1) * MARK_EVERY_NS
        if wait_ns > 0:
            self._answer(asked, f"too many marks; try again in {wait_ns / 1e9:.0f} s", [], ok=False)
            return ()
        # On a full disk the reserve is for the incidents of faults.
        is_full = self._recorder.state is RecorderState.FULL
        if is_full or not self._recorder.has_incident_room or not self._has_mark_room():
            self._answer(asked, "the disk space for marks is used up", [], ok=False)
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
            whose = f" from {mark.robot}" if mark.robot else ""
            self._answer(asked, f"no data received{whose}", [], ok=False)
        return actions

    def _answer(self, asked: OperatorRequest, detail: str, files: list[str], *, ok: bool = True) -> None:
        asked.reply(RecorderReply(ok=ok, detail=detail, files=files, health=self._health()))


_STATES: Final = {
    RecorderState.RECORDING: "recording",
    RecorderState.STOPPED: "standing by: recording incidents only",
    RecorderState.FULL: "disk full: recording incidents only",
}

"""One log of a recording: its session, its incidents, and which files they are in. Pure.

What its session asks for goes into the log as far as that is written, and into the ring whatever happens. What is
to be done about it goes through an ``Outlet``, which all logs of a recording share.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from heapq import heapify, heappop, heappush
from typing import Final

from recorder.encoding.fast_path import FastPath
from recorder.record.effects import (
    Alarm,
    AskInfo,
    AskKept,
    CloseLog,
    Doing,
    Effect,
    FileEffect,
    OnLog,
    OpenLog,
    SyncLog,
    WriteChunk,
    WriteMetadata,
)
from recorder.record.gaps import Gaps
from recorder.record.incidents import INCIDENT_NAME, IncidentPlan, Incidents
from recorder.record.notices import Ended, Lost, Opened, Word, cut_incident_word, incident_word, no_incident_word
from recorder.record.session import Plan, Session
from schemas.recorder_settings import OWNED_KEY_LIMIT
from schemas.recording import GapReason

INCIDENT_MARK: Final = "!"
"""Behind a log's name it is that of its incidents: no robot's name holds it."""


WORDS_MAX: Final = 1000


class Outlet:
    """What the logs of a recording share.

    Attributes:
        doings: what is to be done.
        gaps: what is lost, until it is told.
        fast_paths: by key; see ``fast_path``.
        left_out: why chunks are not written that are not; None is no loss.
        has_incident_room: incidents may be begun.
        incidents: that were begun.
        words: what is to be told.
    """

    def __init__(self) -> None:
        self.doings: list[Doing] = []
        self.gaps = Gaps()
        self.fast_paths: dict[str, FastPath] = {}
        self.left_out: GapReason | None = None
        self.has_incident_room = True
        self.incidents = 0
        self.words: deque[Word] = deque(maxlen=WORDS_MAX)

    def take_words(self) -> list[Word]:
        """What is to be told."""
        words = list(self.words)
        self.words.clear()
        return words


class RobotLog:
    """The log of one robot, or of all.

    Args:
        plan: what to record; its name is the log's.
        incident: what an incident's file holds.
        outlet: where what is to be done goes.
    """

    def __init__(self, plan: Plan, incident: IncidentPlan, outlet: Outlet) -> None:
        self.name = plan.name
        self.session = Session(plan)
        self.incidents = Incidents(plan.name, incident)
        self._outlet = outlet
        self.is_written = False
        """A file of it was asked for, and is not ended."""
        self.file = ""
        """The file that is being written, without its directory; empty if there is none, or not yet."""
        self.incident_file = ""
        """The same of an incident."""
        self._is_incident_told = True
        """Whether the latest incident has been opened, and that was told."""
        self._named = ""
        """The incident that the present file of the log names."""
        self._fast_keys: list[str] = []
        """Its keys that take the fast path, while a file is written."""

    @property
    def incident_name(self) -> str:
        """The name of the log of its incidents."""
        return self.name + INCIDENT_MARK

    def carry_on(self, effects: Iterable[Effect], now_ns: int) -> None:
        """What the session asks for."""
        written: list[OpenLog | FileEffect] = []
        kept: list[Effect] = []
        for effect in effects:
            if isinstance(effect, AskInfo | AskKept):
                self._outlet.doings.append(effect)
            elif isinstance(effect, Alarm):
                if self._outlet.has_incident_room:
                    self.begin_incident(effect.because, now_ns, effect.wall_ns)
                else:
                    self._outlet.words.append(no_incident_word(self.name, effect.because))
            elif isinstance(effect, WriteChunk | SyncLog) and not self.is_written:
                kept.append(effect)
                if isinstance(effect, WriteChunk):
                    self._leave_out(effect)
            else:
                kept.append(effect)
                written.append(effect)
                if isinstance(effect, OpenLog | CloseLog):
                    self.is_written = self.session.is_awaited = isinstance(effect, OpenLog)
                    self._named = ""
                    self._close_fast_paths()
        if written:
            self._outlet.doings.append(OnLog(self.name, tuple(written)))
        if kept:
            self._write_incident(self.incidents.take(kept, now_ns))

    def find_fast_path(self, key: str) -> None:
        """Have the samples of a key take the fast path, if it has one."""
        paths = self._outlet.fast_paths
        if key in paths or len(paths) >= OWNED_KEY_LIMIT:
            return
        path = self.session.fast_path(key)
        if path is not None:
            paths[key] = path
            self._fast_keys.append(key)

    def begin_incident(self, because: str, now_ns: int, wall_ns: int) -> None:
        """Something has happened: keep what came before, and what comes."""
        # Where no file has been begun yet, nothing has been said of the robots.
        self.carry_on(self.session.describe(), now_ns)
        effects = self.incidents.begin(now_ns, wall_ns, because, self.file if self.is_written else "")
        if effects:
            self._is_incident_told = False
            self.incident_file = ""
            self._outlet.incidents += 1
        self._write_incident(effects)

    def end_incident(self, now_ns: int) -> None:
        """End the incident, if there is one."""
        if self.incidents.is_open:
            # What is in hand was received in time.
            self.carry_on(self.session.seal(), now_ns)
            self._write_incident(self.incidents.close())

    def cut_incident(self, now_ns: int) -> None:
        """End the incident, if there is one, for want of room."""
        if self.incidents.is_open:
            self.end_incident(now_ns)
            self._outlet.words.append(cut_incident_word(self.name, self.incident_file))

    def take_opened(self, notice: Opened, now_ns: int) -> Word | None:
        """A file of the log, or of an incident of it, was begun. What is to be told of that."""
        if notice.log == self.name:
            self.file = notice.file
            self.session.is_awaited = False
            self._write_incident(self.incidents.go_on_in(notice.file))
            if self.incidents.is_open and self.incident_file:
                self._name_incident(now_ns)
            return None
        self.incident_file = notice.file
        if self._is_incident_told:
            return None  # The incident goes on in another file, after a fault of the disk.
        self._is_incident_told = True
        self._name_incident(now_ns)
        return incident_word(notice.file, self.incidents.about["because"])

    def take_ended(self, notice: Ended) -> None:
        """A file of the log, or of an incident of it, is whole."""
        if notice.log == self.name and self.file == notice.file:
            self.file = ""
        elif self.incident_file == notice.file:
            self.incident_file = ""

    def take_lost(self, lost: Lost) -> None:
        """The disk did not take messages. Those of an incident the log itself may have."""
        if lost.log == self.name:
            for topic, count in self.session.channels.lose_written(lost.counts, GapReason.DISK).items():
                self._outlet.gaps.add(self.name, topic, GapReason.DISK, count, lost.first_ns, lost.last_ns)

    def _leave_out(self, effect: WriteChunk) -> None:
        """A chunk that only the ring holds. That the disk is full is a loss; that somebody stopped us is none."""
        chunk, reason = effect.chunk, self._outlet.left_out
        for topic, count in self.session.channels.lose_written(chunk.counts, reason).items():
            if reason is not None:
                self._outlet.gaps.add(self.name, topic, reason, count, chunk.start_ns, chunk.end_ns)

    def _close_fast_paths(self) -> None:
        """The next sample of each key takes the slow path, which begins a file where there is none."""
        for key in self._fast_keys:
            del self._outlet.fast_paths[key]
        self._fast_keys.clear()

    def _name_incident(self, now_ns: int) -> None:
        if self.is_written and self._named != self.incident_file:
            self._named = self.incident_file
            entries = {**self.incidents.about, "file": self.incident_file}
            self.carry_on([WriteMetadata(INCIDENT_NAME, entries)], now_ns)

    def _write_incident(self, effects: Sequence[OpenLog | FileEffect]) -> None:
        if effects:
            self._outlet.doings.append(OnLog(self.incident_name, tuple(effects)))


def trim_rings(logs: Iterable[RobotLog], now_ns: int, limit_bytes: int) -> None:
    """Forget what is too old for an incident that would begin now, and the oldest of all if it is too much."""
    total_bytes = 0
    rings = []
    for log in logs:
        log.incidents.trim(now_ns)
        total_bytes += log.incidents.ring_bytes
        rings.append(log.incidents)
    if total_bytes <= limit_bytes:
        return
    heads = [(ring.oldest_ns, number) for number, ring in enumerate(rings) if ring.oldest_ns is not None]
    heapify(heads)
    while heads and total_bytes > limit_bytes:
        _, number = heappop(heads)
        total_bytes -= rings[number].forget_oldest()
        oldest_ns = rings[number].oldest_ns
        if oldest_ns is not None:
            heappush(heads, (oldest_ns, number))

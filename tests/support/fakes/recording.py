"""A recorder's surroundings in memory: a slow disk, a writer that may lose chunks, a source, and a request."""

import errno
import os
import stat
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from itertools import islice
from typing import Any

import pytest

from recorder.disk.files import Prologue
from recorder.encoding.samples import ReceivedSample
from recorder.mcap.writer import McapFile
from recorder.record.actions import (
    Action,
    CloseLog,
    DeclareChannel,
    Ended,
    LogAction,
    Lost,
    Notice,
    Opened,
    OpenLog,
    Publish,
    Query,
    WriteChunk,
)
from recorder.record.orders import OperatorRequest
from recorder.record.recorder import RecorderPlan
from schemas.codec import PayloadFault
from schemas.recording import RecorderEvent, RecorderReply, RecordGap
from schemas.requests import Request
from tests.support.logs import PLAN, Disk
from tests.support.messages import ROOT

RECORDER_PLAN = RecorderPlan(
    root=ROOT, recorder="bench", per_robot=True, log=PLAN, ring_bytes=1_000_000, sample_max_bytes=1_000_000
)


def failing(number: int) -> Callable[..., Any]:
    """A step of a disk that fails with this system error."""

    def fail(*_arguments: object, **_named: object) -> None:
        raise OSError(number, os.strerror(number))

    return fail


class SlowDisk:
    """Syncs of files wait, and then may fail, on demand; those of directories do not."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.goes_on = threading.Event()
        self.goes_on.set()
        self.fails = False
        self.asked: list[int] = []  # length of the file at each sync
        for name in ("fdatasync", "fsync"):
            monkeypatch.setattr(os, name, partial(self._sync, getattr(os, name)))

    def _sync(self, how: Callable[[int], None], descriptor: int) -> None:
        status = os.fstat(descriptor)
        if stat.S_ISREG(status.st_mode):
            self.asked.append(status.st_size)
            assert self.goes_on.wait(60)
            if self.fails:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
        how(descriptor)


class MemoryFile:
    def __init__(self, name: str, opened: OpenLog) -> None:
        self.name = name
        self.opened = opened
        self.disk = Disk()
        self.mcap = McapFile(self.disk, "test")
        self.is_ended = False


class MemoryWriter:
    """Writes the files of several logs into memory, and loses chunks on demand."""

    def __init__(self) -> None:
        self.files: dict[str, list[MemoryFile]] = {}  # of each log
        self.said: list[RecorderEvent | RecordGap] = []
        self.asked: list[Query] = []
        self.notices: list[Notice] = []
        self.loses = False  # chunks are lost, but for those of incidents
        # Messages lost, by topic and log time: a sample of many may lose a part.
        self.lost: Counter[tuple[str, int]] = Counter()
        self._prologues: dict[str, Prologue] = {}
        self._topics: dict[tuple[str, int], str] = {}

    def apply(self, actions: Iterable[Action]) -> None:
        for action in actions:
            if isinstance(action, LogAction):
                self._apply(action)
            elif isinstance(action, Publish):
                self.said.append(action.message)
            elif isinstance(action, Query):
                self.asked.append(action)

    def open_file(self, log: str) -> MemoryFile | None:
        files = self.files.get(log)
        return files[-1] if files and not files[-1].is_ended else None

    def _apply(self, action: LogAction) -> None:
        log = action.log
        file = self.open_file(log)
        if isinstance(action, OpenLog):
            assert file is None, "opened twice"
            files = self.files.setdefault(log, [])
            file = MemoryFile(f"{action.name}-{len(files)}{'.incident' * action.is_incident}.mcap", action)
            files.append(file)
            if action.is_incident:
                self._prologues[log] = self._prologues[action.name].copy()
            self._prologues.setdefault(log, Prologue()).write_to(file.mcap)
            self.notices.append(Opened(log, file.name))
            return
        self._prologues.setdefault(log, Prologue()).add(action)
        if isinstance(action, DeclareChannel):
            self._topics[log, action.channel.channel_id] = action.channel.topic
        if isinstance(action, WriteChunk):
            assert file is not None, "written before it is open"
            if self.loses and not file.opened.is_incident:
                self._lose(action)
                return
        if file is not None:
            action.write_to(file.mcap)
            if isinstance(action, CloseLog):
                file.is_ended = True
                self.notices.append(Ended(log, file.name, file.mcap.size))

    def _lose(self, action: WriteChunk) -> None:
        chunk = action.chunk
        for channel_id, entries in chunk.index.items():
            self.lost.update((self._topics[action.log, channel_id], time_ns) for time_ns in entries[::2])
        self.notices.append(Lost(action.log, chunk.counts, chunk.start_ns, chunk.end_ns))


class FakeSource:
    """A source with these samples; answers queries on a key with its replies, the last one again and again."""

    def __init__(
        self, samples: Iterable[ReceivedSample] = (), replies: dict[str, list[ReceivedSample]] | None = None
    ) -> None:
        self.asked: list[str] = []
        self.room = 64
        self._samples = iter(samples)
        self._replies = replies or {}
        self._answers: list[ReceivedSample] = []
        self.is_exhausted = self.is_behind = False

    @property
    def is_asking(self) -> bool:
        return bool(self._answers)

    @property
    def query_room(self) -> int:
        return self.room - len(self._answers)

    @property
    def is_connected(self) -> bool:
        return not self.is_exhausted

    def tokens_gone(self) -> list[str]:
        return []

    def drain(self, limit: int) -> list[ReceivedSample]:
        taken = list(islice(self._samples, limit))
        self.is_behind = len(taken) == limit
        if not self.is_behind:
            self.is_exhausted = True
        answers, self._answers = self._answers, []
        return [*taken, *answers]

    def ask(self, key: str, parameters: str = "") -> None:
        if parameters:
            return
        self.asked.append(key)
        if key in self._replies:
            replies = self._replies[key]
            self._answers.append(replies.pop(0) if len(replies) > 1 else replies[0])


class FakeAsked:
    def __init__(self, request: Request | PayloadFault) -> None:
        self.asked = OperatorRequest("operator-1", request, self.reply)
        self.replies: list[RecorderReply] = []

    def reply(self, answer: RecorderReply) -> None:
        assert not self.replies
        self.replies.append(answer)

    @property
    def is_done(self) -> bool:
        return bool(self.replies)

    @property
    def answer(self) -> RecorderReply:
        (answer,) = self.replies
        return answer

"""The loop of a recording: samples from Zenoh into the session, its effects out to the ports.

It never waits for the disk: files are written by ``ports.log_writer`` on a thread of its own.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Final, Protocol

import msgspec

from recorder.effects import AskInfo, AskKept, Effect, FileEffect, OpenLog
from recorder.ports.log_directory import LogDirectory
from recorder.ports.log_writer import LogWriter
from recorder.sample import Sample
from recorder.session import KeyCount, Session
from schemas.subjects import KEPT_FIRST

log = logging.getLogger(__name__)

PASS_SAMPLES: Final = 2000
"""Samples between two ticks at most."""

IDLE_S: Final = 0.005
"""Pause when nothing has come in."""

LAST_ANSWERS_NS: Final = 500_000_000
"""How long the end waits for robots that have not yet said who they are."""

LAST_SAMPLES_NS: Final = 2_000_000_000
"""How long the end goes on writing what had already come in."""


class Source(Protocol):
    """Where samples come from."""

    @property
    def is_asking(self) -> bool:
        """Whether a query is still without its reply."""
        ...

    @property
    def is_connected(self) -> bool:
        """Whether any Zenoh node is connected."""
        ...

    def drain(self, limit: int) -> Iterable[Sample]:
        """The samples that have come in."""
        ...

    def ask(self, key: str, parameters: str = "") -> None:
        """Query a key; the replies come with the samples."""
        ...


class Recorded(msgspec.Struct, frozen=True):
    """What a recording has come to.

    Attributes:
        path: the newest log; None if there is none.
        files: how many there are; ``bytes`` of them all.
        lost: messages that were received, and that the disk did not take.
        keys: per topic, what was recorded and what was missed.
    """

    path: str | None
    files: int
    messages: int
    lost: int
    bytes: int
    channels: int
    keys: dict[str, KeyCount]


class Recorder:
    """Runs a session.

    Args:
        session: what to record.
        source: where samples come from.
        directory: where logs go.
        library: who writes, for the file's header.
    """

    def __init__(self, session: Session, source: Source, directory: LogDirectory, library: str) -> None:
        self._session = session
        self._source = source
        self._writer = LogWriter(directory, library)
        self._was_connected: bool | None = None

    def run(self, stopped: Callable[[], bool], rolls: Callable[[], bool] = lambda: False) -> Recorded:
        """Record until stopped, whatever the disk does. A new file begins each time ``rolls()`` is true."""
        try:
            while not stopped():
                if rolls():
                    self._carry_out(self._session.roll("signal"))
                if not self._step():
                    time.sleep(IDLE_S)
            self._end()
        finally:
            self._writer.close()
        return self._recorded()

    def _step(self) -> bool:
        """One pass. False if nothing had come in."""
        receive = self._session.receive_sample
        busy = False
        for sample in self._source.drain(PASS_SAMPLES):
            busy = True
            effects = receive(sample, time.monotonic_ns(), time.time_ns())
            if effects:
                self._carry_out(effects)
        self._carry_out(self._session.tick(time.monotonic_ns(), self._writer.size))
        self._watch_link()
        return busy

    def _watch_link(self) -> None:
        """Say when the link to Zenoh comes and goes: a silent recorder must not look like a silent robot."""
        is_connected = self._source.is_connected
        if is_connected == self._was_connected:
            return
        if is_connected:
            log.info("connected to Zenoh")
        else:
            log.warning(
                "no Zenoh node is connected%s; trying on", "" if self._was_connected is None else " any more"
            )
        self._was_connected = is_connected

    def _end(self) -> None:
        start_ns = time.monotonic_ns()
        while self._step() and time.monotonic_ns() - start_ns < LAST_SAMPLES_NS:
            pass
        self._carry_out(self._session.ask_last(time.monotonic_ns()))
        asked_ns = time.monotonic_ns()
        while self._source.is_asking and time.monotonic_ns() - asked_ns < LAST_ANSWERS_NS:
            self._step()
            time.sleep(IDLE_S)
        self._carry_out(self._session.close())

    def _carry_out(self, effects: Sequence[Effect]) -> None:
        written: list[OpenLog | FileEffect] = []
        for effect in effects:
            if isinstance(effect, AskInfo):
                self._source.ask(effect.key)
            elif isinstance(effect, AskKept):
                self._source.ask(effect.key, f"{KEPT_FIRST}={effect.first}")
            else:
                written.append(effect)
        if written:
            self._writer.submit(written)

    def _recorded(self) -> Recorded:
        counts = self._session.counts
        return Recorded(
            path=self._writer.path,
            files=self._writer.files,
            messages=sum(count.messages for count in counts.values()) - self._writer.lost,
            lost=self._writer.lost,
            bytes=self._writer.bytes,
            channels=len(counts),
            keys=counts,
        )

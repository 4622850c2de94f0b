"""The loop of a recorder: samples from Zenoh into ``record.recorder``, its actions out to the disk and to Zenoh.

It never waits for the disk: ``disk.log_writer`` writes the files on its own thread. Samples that arrive faster
than they are recorded wait in the bounded inbox.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, islice
from typing import Final, Protocol

import msgspec

from recorder.disk.keeper import DiskKeeper, DiskUse, LeftoverThread
from recorder.disk.log_writer import LogWriter
from recorder.encoding.samples import ReceivedSample
from recorder.record.accounting import KeyReport, total
from recorder.record.actions import QUERIES_PER_TICK, Action, LogAction, Publish, Query
from recorder.record.orders import OperatorRequest, Orders
from recorder.record.recorder import HealthReport, Recorder, SampleInbox, Vitals
from schemas.command_line import plain
from schemas.messages import Message
from schemas.recording import GapReason, RecorderEvent, RecorderHealth
from schemas.subjects import KEPT_FIRST

log = logging.getLogger(__name__)

PASS_SAMPLES: Final = 1000  # most samples between two ticks
PASS_BYTES: Final = 4_000_000  # most bytes of samples from the inbox between two ticks
INTAKE_SAMPLES: Final = 20_000  # most samples moved into the inbox between two ticks
PASS_NS: Final = 20_000_000  # longest time for samples between two ticks: one may take as long as a thousand
SLICE_SAMPLES: Final = 100  # samples on the fast path between two looks at the clock
TICK_NS: Final = 20_000_000  # pause between two ticks: with a thousand logs each takes its time
LINK_NS: Final = 200_000_000  # pause between two looks at the link
IDLE_S: Final = 0.01  # pause without samples
LAST_ANSWERS_NS: Final = 500_000_000  # at the end, longest wait for replies
LAST_SAMPLES_NS: Final = 2_000_000_000  # at the end, longest time to record samples received before


class SampleSource(Protocol):
    """A source of samples."""

    @property
    def is_asking(self) -> bool:
        """True if a query is still without its reply."""

    @property
    def query_room(self) -> int:
        """Number of queries that may still be sent."""

    @property
    def is_connected(self) -> bool:
        """True if any Zenoh node is connected."""

    @property
    def is_behind(self) -> bool:
        """True if more had come in than the last ``drain`` returned."""

    def drain(self, limit: int) -> Sequence[ReceivedSample]:
        """At most ``limit`` samples that have come in."""

    def tokens_gone(self) -> Iterable[str]:
        """Keys of the gateways' liveliness tokens lost since the last call."""

    def ask(self, key: str, parameters: str = "") -> None:
        """Query a key; the replies come with the samples."""


class Control(Protocol):
    """The source of operators' requests, which also publishes the recorder's own messages."""

    def drain(self) -> Iterable[OperatorRequest]:
        """The requests that have come in."""

    def publish(self, message: Message) -> None:
        """Publish a message under the recorder's own keys."""


class Recorded(msgspec.Struct, frozen=True):
    """The result of a recording.

    Attributes:
        path: the newest log; None if there is none.
        files: their number, incidents included; ``bytes`` is their total size.
        lost: the sum of the next five, each as in ``KeyReport``.
        is_hung: the disk did not respond at the end: the data written last may be lost, too.
        keys: the report of each topic.
    """

    path: str | None
    files: int
    messages: int
    lost: int
    lost_link: int
    lost_queue: int
    lost_size: int
    lost_full: int
    lost_disk: int
    bytes: int
    channels: int
    incidents: int
    keys: dict[str, KeyReport]
    is_hung: bool = False
    unfinished: int = 0


class RecorderLoop:
    """Runs a recorder."""

    def __init__(
        self,
        recorder: Recorder,
        source: SampleSource,
        writer: LogWriter,
        inbox: SampleInbox,
        health: HealthReport,
        keeper: DiskKeeper | None = None,
        leftovers: LeftoverThread | None = None,
    ) -> None:
        self._recorder = recorder
        self._source = source
        self._writer = writer
        self._inbox = inbox
        self._health = health
        self._was_connected: bool | None = None
        self._ticked_ns = self._link_seen_ns = 0
        self._control: Control | None = None
        self._orders: Orders | None = None
        self._keeper = keeper
        self._leftovers = leftovers
        self._reporters = [one for one in (writer, keeper, leftovers) if one is not None]

    def attach(self, control: Control) -> None:
        """Execute operators' requests, and publish events, gaps and health."""
        self._control = control
        keeper = self._keeper
        self._orders = Orders(self._recorder, self._health_now, lambda: keeper is None or keeper.use.has_mark_room)

    def run(self, stopped: Callable[[], bool], rolls: Callable[[], bool] = lambda: False) -> Recorded:
        """Record until stopped. A new file begins each time ``rolls()`` is true."""
        try:
            while not stopped():
                if rolls():
                    self._apply(self._recorder.roll("signal", time.monotonic_ns()))
                if not self._step():
                    time.sleep(IDLE_S)
            self._end()
        finally:
            self._writer.close()
        self._receive_notices(time.monotonic_ns(), time.time_ns())
        return self._recorded()

    def _step(self) -> bool:
        busy = self._take_samples()
        now_ns, wall_ns = time.monotonic_ns(), time.time_ns()
        if now_ns - self._ticked_ns < TICK_NS:
            return busy
        self._ticked_ns = now_ns
        self._receive_notices(now_ns, wall_ns)
        for key in self._source.tokens_gone():
            self._recorder.lose_token(key, now_ns)
        self._apply(self._recorder.tick(now_ns, wall_ns, self._writer.sizes))
        # While samples wait, send one query per tick: a recorder that is never idle must ask, too.
        most = min(self._source.query_room, 1 if self._inbox else QUERIES_PER_TICK)
        self._apply(self._recorder.ask(now_ns, most))
        if self._control is not None:
            self._obey(self._control, now_ns, wall_ns)
        if now_ns - self._link_seen_ns >= LINK_NS:
            self._link_seen_ns = now_ns
            self._watch_link()
        return busy

    def _take_samples(self) -> bool:
        """True if any sample had come in, or was waiting."""
        if self._inbox:
            self._take_in()
            self._receive(self._inbox.take(PASS_SAMPLES, PASS_BYTES))
            return True
        samples = self._source.drain(PASS_SAMPLES)
        is_behind = self._source.is_behind
        left = iter(samples)
        self._receive(left)
        self._put_by(left)
        if is_behind:
            # Zenoh's own ring would drop samples uncounted.
            self._take_in()
        return bool(samples)

    def _receive(self, samples: Iterator[ReceivedSample]) -> None:
        """Record samples for at most PASS_NS; the others stay in the iterator."""
        end_ns = time.monotonic_ns() + PASS_NS

        def is_late() -> bool:
            return time.monotonic_ns() >= end_ns

        for first in samples:
            some = chain([first], islice(samples, SLICE_SAMPLES - 1))
            self._apply(self._recorder.receive(some, time.monotonic_ns(), is_late))
            if is_late():
                return

    def _take_in(self) -> None:
        self._put_by(self._source.drain(INTAKE_SAMPLES))

    def _put_by(self, samples: Iterable[ReceivedSample]) -> None:
        """Queue samples in the inbox, and count those it drops."""
        for sample in samples:
            for key, received_ns in self._inbox.put(sample):
                self._recorder.drop(key, GapReason.QUEUE, time.monotonic_ns(), received_ns)

    def _receive_notices(self, now_ns: int, wall_ns: int) -> None:
        for reporter in self._reporters:
            for notice in reporter.notices():
                if self._orders is not None:
                    self._orders.receive_notice(notice)
                if self._leftovers is not None:
                    self._leftovers.receive_notice(notice)
                self._apply(self._recorder.receive_notice(notice, now_ns, wall_ns))

    def _obey(self, control: Control, now_ns: int, wall_ns: int) -> None:
        if self._orders is not None:
            for asked in control.drain():
                self._apply(self._orders.handle(asked, now_ns, wall_ns))
            self._orders.tick(now_ns)
        if self._health.is_due(now_ns):
            cpu_ns = time.process_time_ns()
            control.publish(self._health.next(self._recorder, self._vitals(), cpu_ns, now_ns, wall_ns))

    def _health_now(self) -> RecorderHealth:
        return self._health.now(self._recorder, self._vitals(), time.monotonic_ns(), time.time_ns())

    def _vitals(self) -> Vitals:
        use = DiskUse() if self._keeper is None else self._keeper.use
        return Vitals(
            files=len(self._writer.sizes),
            files_ended=self._writer.files,
            ended_bytes=self._writer.bytes,
            queue_bytes=self._inbox.bytes,
            disk_queue_bytes=self._writer.waiting_bytes,
            disk_free_bytes=use.free,
            disk_used_bytes=use.used,
            incident_bytes=use.incidents,
        )

    def _watch_link(self) -> None:
        """Log changes of the link to Zenoh: a silent recorder must not look like a silent robot."""
        is_connected = self._source.is_connected
        if is_connected == self._was_connected:
            return
        if is_connected:
            log.info("connected to Zenoh")
        else:
            log.warning(
                "no Zenoh node is connected%s; retrying", "" if self._was_connected is None else " any more"
            )
        self._was_connected = is_connected

    def _end(self) -> None:
        start_ns = time.monotonic_ns()
        while self._step() and time.monotonic_ns() - start_ns < LAST_SAMPLES_NS:
            pass
        asked_ns = time.monotonic_ns()
        self._recorder.ask_last(asked_ns)
        while (now_ns := time.monotonic_ns()) - asked_ns < LAST_ANSWERS_NS:
            self._apply(self._recorder.ask(now_ns, self._source.query_room))
            if not self._source.is_asking:
                break
            self._step()
            time.sleep(IDLE_S)
        for sample in self._inbox.take(len(self._inbox), self._inbox.bytes):
            # No time was left for it.
            self._recorder.drop(sample.key, GapReason.QUEUE, time.monotonic_ns(), sample.received_ns)
        self._apply(self._recorder.close(time.monotonic_ns(), time.time_ns()))

    def _apply(self, actions: Sequence[Action]) -> None:
        if not actions:
            return
        on_logs = [action for action in actions if isinstance(action, LogAction)]
        if on_logs:
            self._writer.submit(on_logs)
        for action in actions:
            if isinstance(action, Query):
                self._source.ask(action.key, "" if action.first is None else f"{KEPT_FIRST}={action.first}")
            elif isinstance(action, Publish):
                self._publish(action.message)

    def _publish(self, message: Message) -> None:
        if isinstance(message, RecorderEvent):
            log.info("%s", plain(message.text))
        if self._control is not None:
            self._control.publish(message)

    def _recorded(self) -> Recorded:
        counts = self._recorder.counts
        all_keys = total(counts.values())
        lost_link, lost_queue, lost_size = all_keys.lost_link, all_keys.lost_queue, all_keys.lost_size
        # The writer also counts losses after its last notice was read.
        lost_full, lost_disk = all_keys.lost_full, self._writer.lost
        return Recorded(
            path=self._writer.path,
            files=self._writer.files,
            messages=sum(count.written for count in counts.values()),
            lost=lost_link + lost_queue + lost_size + lost_full + lost_disk,
            lost_link=lost_link,
            lost_queue=lost_queue,
            lost_size=lost_size,
            lost_full=lost_full,
            lost_disk=lost_disk,
            bytes=self._writer.bytes,
            channels=len(counts),
            incidents=self._recorder.incidents,
            keys=counts,
            is_hung=self._writer.is_hung,
        )

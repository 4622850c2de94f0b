"""Rerun: recorded inputs through this version's arbiter, and the comparison of its output with the log.

``Tape`` plays a robot's runs: journal messages hold the inputs of the gateway's core, in order. A run with missing
messages is split into parts without a gap. Messages that a recorder queried later come behind newer ones, so early
ones are held until their turn, up to a bound.

``Comparison`` compares recorded and rerun messages byte for byte. Either side may be ahead; compared messages are
released, so memory holds only the distance.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, Final

import msgspec

from gateway.rerun import rerun
from recorder.encoding.routes import Route
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress, Row, Selection, read_rows
from recorder.reading.survey import Configurations, settings_from
from recorder.reading.topics import UNREADABLE, typed_decoder
from schemas import codec
from schemas.codec import Sample
from schemas.decisions import Journal
from schemas.journal import COMMAND_RULES
from schemas.subjects import BY_NAME

JOURNAL: Final = "journal"  # the subject
HELD_MAX: Final = 600  # journals that wait for earlier ones, half a minute: queried ones come within seconds
HELD_BYTES: Final = 64 * 1024 * 1024  # their total length
JOURNAL_BYTES: Final = (
    1024 * 1024
)  # longest inputs of a journal: 50 ms take a few kilobytes, a checkpoint ten more


class PartEnd(msgspec.Struct, frozen=True):
    """The extent of a part of a run: its first input in the run, from 0, and the gaps around it."""

    run: int
    first: int
    inputs: int
    detail: str


class Tape:
    """Plays the journals of one robot part by part; other rows go to ``take``. ``end`` is the last part's."""

    def __init__(self, rows: Iterator[Row], take: Callable[[Row], None], faults: Faults) -> None:
        self._rows = rows
        self._take = take
        self._faults = faults
        self._run: int | None = None
        self._held: dict[int, Journal] = {}
        self._reached = 0  # the place behind the run's played inputs
        self._next: Journal | None = None  # the first of the next run
        self._past: set[int] = set()
        self.end = PartEnd(0, 0, 0, "")

    def next_part(self) -> bool:
        """Advance to the beginning of the next part; False if there is none."""
        if self._held:
            return True
        if self._run is not None:
            self._past.add(self._run)
            self._run = None
        journal = self._next or self._read()
        self._next = None
        if journal is None:
            return False
        self._run, self._reached = journal.run, 0
        self._held[journal.first] = journal
        return True

    @property
    def next_time_ns(self) -> int:
        """The publish time of the first journal of the part; 0 if there is none."""
        return self._held[min(self._held)].time_ns if self._held else 0

    def journals(self) -> Iterator[Journal]:
        """The journals of the part, in order; then ``end`` describes the part."""
        run = self._run
        if run is None:
            return
        # A part behind a gap has waited for the missing inputs; a run's beginning may still come.
        while not self._reached and 0 not in self._held and self._waits():
            pass
        first = expected = 0 if 0 in self._held else min(self._held)
        self.end = PartEnd(run, first, 0, "")
        before, self._reached, is_over = self._reached, max(self._reached, first), False
        while not is_over:
            while (due := self._held.pop(expected, None)) is not None:
                expected = self._reached = expected + due.count
                yield due
            is_over = not self._waits()
        gaps = [(before, first), *([(expected, min(self._held))] if self._held else [])]
        missing = [f"inputs {begin} to {end - 1} are missing" for begin, end in gaps if begin < end]
        self.end = PartEnd(run, first, expected - first, "; ".join(missing))

    def break_off(self, detail: str) -> None:
        """End the part at an unusable journal. Another part begins behind it."""
        inputs = max(self._reached - self.end.first, 0)
        self.end = msgspec.structs.replace(self.end, inputs=inputs, detail=detail)

    def _waits(self) -> bool:
        """Read another journal of the run; False if there is none, or too many wait."""
        held_bytes = sum(len(one.inputs) for one in self._held.values())
        if self._next is not None or len(self._held) >= HELD_MAX or held_bytes > HELD_BYTES:
            return False
        journal = self._read()
        if journal is None:
            return False
        if journal.run != self._run:
            self._next = journal
            return False
        if journal.first >= self._reached:
            self._held.setdefault(journal.first, journal)
        return True

    def _read(self) -> Journal | None:
        """The next journal of an unfinished run."""
        for row in self._rows:
            if row.topic.subject != JOURNAL or row.topic.decode is None:
                self._take(row)
                continue
            try:
                journal = row.topic.decode(row.data)
            except UNREADABLE as error:
                self._faults.add(f"{row.topic.name}: a journal that cannot be read: {error}")
                continue
            if isinstance(journal, Journal) and len(journal.inputs) > JOURNAL_BYTES:
                self._faults.add(f"{row.topic.name}: a journal of {len(journal.inputs)} bytes is too long")
                continue
            # An empty one would be held for ever.
            if isinstance(journal, Journal) and journal.count and journal.run not in self._past:
                return journal
        return None


DIFFERENCES_MAX: Final = 1000  # differences that are listed; the rest are only counted
WAITING_MAX: Final = (
    200_000  # messages that wait for their counterpart; the oldest beyond it are given up and counted
)
COPIES_MAX: Final = 100_000  # compared messages of a subject that are remembered, to recognise copies
BATCH_NS: Final = 100_000_000  # longest delay of batched messages: the end of a run may be missing from them

Key = tuple[str, int, int | bytes]
"""Subject, publish time since 1970, and a distinction of messages of that time."""

WORDS: Final = frozenset({"detail", "stop_detail", "text"})
"""Fields of decisions, states and events with texts for people; the reason is in another field."""


class Difference(msgspec.Struct, frozen=True):
    """A message that differs.

    Attributes:
        what: ``changed`` or ``only recorded``.
        fields: the fields of a changed one that differ: recorded and rerun values.
        message: the whole message if it was only recorded.
    """

    subject: str
    time_ns: int
    what: str
    fields: dict[str, tuple[Any, Any]] = {}
    message: Any = None


class Comparison:
    """Compares the two sides.

    Attributes:
        unrecorded: rerun messages that are not in the log, by subject.
        reworded: messages that differ only in texts for people, as of another version.
        given_up: messages that waited too long for their counterpart, or came too long after it.
        begins_ns, ends_ns: times of the first rerun message with a sequence, and of the newest one, since 1970.
    """

    def __init__(self, decode: Callable[[str, bytes], Any]) -> None:
        self._decode = decode
        self.same: Counter[str] = Counter()
        self.differences: list[Difference] = []
        self.difference_count = 0
        self.unrecorded: Counter[str] = Counter()
        self.reworded = 0
        self.given_up = 0
        self.begins_ns: int | None = None
        self.ends_ns = 0
        self._recorded: OrderedDict[Key, bytes] = OrderedDict()
        self._others: OrderedDict[tuple[Key, bytes], None] = OrderedDict()
        """Further records under the same key, which were inserted."""
        self._again: OrderedDict[Key, bytes] = OrderedDict()
        self._compared: dict[str, OrderedDict[Key, int]] = {}
        self._forgotten: dict[str, Key] = {}

    def record(self, key: Key, data: bytes) -> None:
        """Take a recorded message."""
        again = self._again.pop(key, None)
        if again is not None:
            self._compare(key, data, again)
        elif self._is_copy(key, data):
            return
        elif key not in self._recorded:
            self._wait(self._recorded, key, data)
        elif self._recorded[key] != data:
            self._wait(self._others, (key, data), None)

    def say_again(self, key: Key, data: bytes) -> None:
        """Take a rerun message."""
        if self.begins_ns is None and key[0] not in FRAMES:
            # Not with a received frame: after a start at rest the next state comes at another time.
            self.begins_ns = key[1]
        self.ends_ns = max(self.ends_ns, key[1])
        recorded = self._recorded.get(key)
        if (key, data) in self._others:
            # An earlier record under the same key has no counterpart.
            del self._others[key, data]
            self._compare(key, data, data)
        elif recorded is not None:
            del self._recorded[key]
            self._compare(key, recorded, data)
        else:
            self._wait(self._again, key, data)

    def end(self) -> list[tuple[Key, bytes]]:
        """End the rerun. Returns the later records, which belong to the next part.

        Records before the first rerun message are ignored.
        """
        # The last batch may never have been published.
        last_ns = self.ends_ns - BATCH_NS
        self.unrecorded.update(subject for subject, time_ns, _ in self._again if time_ns <= last_ns)
        self._again.clear()
        later: list[tuple[Key, bytes]] = []
        for key, data in (*self._recorded.items(), *self._others):
            subject, time_ns, _ = key
            if time_ns > last_ns:
                later.append((key, data))
            elif time_ns >= (self.begins_ns or 0):
                self._differ(Difference(subject, time_ns, "only recorded", message=self._decode(subject, data)))
        self._recorded.clear()
        self._others.clear()
        return later

    def _is_copy(self, key: Key, data: bytes) -> bool:
        """True of a copy of a compared message, or if it is too late to tell."""
        compared = self._compared.setdefault(key[0], OrderedDict()).get(key)
        if compared is not None:
            return compared == hash(data)
        is_forgotten = key[0] in self._forgotten and key <= self._forgotten[key[0]]
        self.given_up += is_forgotten
        return is_forgotten

    def _compare(self, key: Key, recorded: bytes, again: bytes) -> None:
        subject = key[0]
        compared = self._compared.setdefault(subject, OrderedDict())
        compared[key] = hash(recorded)
        if len(compared) > COPIES_MAX:
            self._forgotten[subject], _ = compared.popitem(last=False)
        if recorded == again:
            self.same[subject] += 1
            return
        then, now = self._decode(subject, recorded), self._decode(subject, again)
        fields = {
            name: (before, after)
            for name in then.__struct_fields__
            if (before := getattr(then, name)) != (after := getattr(now, name))
        }
        if fields and fields.keys() <= WORDS:
            self.reworded += 1
        else:
            self._differ(Difference(subject, key[1], "changed", fields))

    def _differ(self, difference: Difference) -> None:
        self.difference_count += 1
        if len(self.differences) < DIFFERENCES_MAX:
            self.differences.append(difference)

    def _wait(self, waiting: OrderedDict[Any, Any], key: Hashable, data: bytes | None) -> None:
        waiting[key] = data
        if len(waiting) > WAITING_MAX:
            waiting.popitem(last=False)
            # Before the first rerun message nothing is compared.
            self.given_up += self.begins_ns is not None


SENT: Final = "can/{bus}/tx"
DECIDED: Final = ("safety/decision", "safety/event", "safety/state", SENT)
"""The subjects of the arbiter's decisions."""

RECEIVED: Final = "can/{bus}/rx"
FRAMES: Final = (SENT, RECEIVED)
COMPARED: Final = (*DECIDED, RECEIVED)
"""The subjects that must be equal. No rule changes received frames: they show whether the log is authentic."""

NO_CONFIGURATION: Final = "the log does not hold the robot's configuration"
NO_PLACE: Final = "there is no place to begin: no checkpoint of this version, and the gateway was never at rest"
OTHER_RULES: Final = (
    "made under other rules, so it can be rerun from its first input only"  # and the log begins later
)
BROKEN_OFF: Final = "the following inputs cannot be rerun"
DETAIL_MAX: Final = 300  # characters of an error


class RerunResult(msgspec.Struct, frozen=True):
    """The rerun of a part of a run.

    Attributes:
        first: the place of its first input, from 0: behind a gap a run continues in another result.
        inputs: number of inputs without a gap.
        detail: missing parts, or the reason why nothing was rerun; empty if all was.
        start_ns, end_ns: of the rerun messages, nanoseconds since 1970; 0 without any.
        same: number of messages that are equal byte for byte, by subject.
        difference_count: messages that differ; ``differences`` are the first ones.
        unrecorded, given_up, reworded: as in ``Comparison``.
        rules: the command rules of the run, as in ``schemas.journal``.
    """

    robot: str
    run: int
    first: int
    inputs: int
    detail: str
    start_ns: int
    end_ns: int
    same: dict[str, int]
    unrecorded: dict[str, int]
    difference_count: int
    differences: list[Difference]
    given_up: int
    reworded: int = 0
    rules: int = COMMAND_RULES

    @property
    def differs_ns(self) -> int | None:
        """The time of the first difference; None if there is none."""
        return min((one.time_ns for one in self.differences), default=None)


def rerun_parts(player: RerunPlayer) -> Iterator[RerunResult]:
    """Rerun every run of a player with its own settings."""
    while player.next_part():
        yield _rerun(player)


def _rerun(player: RerunPlayer) -> RerunResult:
    text = player.configuration()
    if text is None:
        return player.skip(NO_CONFIGURATION)
    start_ns = 0
    try:
        for sample in rerun(settings_from(text), player.journals()):
            if sample.subject in _ROUTES:
                for key, data in records_of(sample):
                    start_ns = start_ns or key[1]
                    player.comparison.say_again(key, data)
    except UNREADABLE as error:
        player.break_off(error)
    return player.result(start_ns)


class RerunPlayer:
    """The successive runs of one robot; ``comparison`` is the current run's."""

    def __init__(
        self,
        robot: str,
        logs: Sequence[LogFile],
        configurations: Configurations,
        faults: Faults,
        progress: Progress,
    ) -> None:
        self.comparison = Comparison(_decode)
        self._robot = robot
        self._configurations = configurations
        wanted = {JOURNAL, *COMPARED}
        selection = Selection(lambda topic: topic.robot == robot and topic.subject in wanted)
        self._tape = Tape(read_rows(logs, selection, faults, progress), self._record, faults)
        self._rules = COMMAND_RULES
        self._faults = faults

    def next_part(self) -> bool:
        """Advance to the next run, or to the next part of one."""
        return self._tape.next_part()

    def journals(self) -> Iterator[Journal]:
        """The journals of the part, in order."""
        for journal in self._tape.journals():
            self._rules = journal.rules
            yield journal

    def configuration(self) -> str | None:
        """The TOML text in force in the current run; None if the log does not hold it."""
        return self._configurations.at(self._tape.next_time_ns)

    def break_off(self, error: Exception) -> None:
        """End the part at an unusable journal."""
        self._tape.break_off(f"{BROKEN_OFF}: {error!r}"[:DETAIL_MAX])
        self._faults.add(f"{self._robot}: run {self._tape.end.run}: {self._tape.end.detail}")

    def skip(self, detail: str) -> RerunResult:
        """Skip the run."""
        for _ in self.journals():
            pass
        return msgspec.structs.replace(self._result(0), inputs=0, detail=detail)

    def result(self, start_ns: int) -> RerunResult:
        """Sum up the run; later records are left for the next one."""
        result = self._result(start_ns)
        if start_ns:
            return result
        why = NO_PLACE if self._rules == COMMAND_RULES else OTHER_RULES
        return msgspec.structs.replace(result, detail="; ".join(filter(None, (result.detail, why))))

    def _result(self, start_ns: int) -> RerunResult:
        comparison, self.comparison = self.comparison, Comparison(_decode)
        end = self._tape.end
        for key, data in comparison.end():
            self.comparison.record(key, data)
        return RerunResult(
            robot=self._robot,
            run=end.run,
            first=end.first,
            inputs=end.inputs,
            detail=end.detail,
            start_ns=start_ns,
            end_ns=comparison.ends_ns,
            same=dict(comparison.same),
            unrecorded=dict(comparison.unrecorded),
            difference_count=comparison.difference_count,
            differences=comparison.differences,
            given_up=comparison.given_up,
            reworded=comparison.reworded,
            rules=self._rules,
        )

    def _record(self, row: Row) -> None:
        try:
            key = key_of(row.topic.subject, row.sequence, row.publish_ns, row.data)
        except UNREADABLE as error:
            self._faults.add(f"{row.topic.name}: a record that cannot be read: {error}")
            return
        self.comparison.record(key, row.data)


def key_of(subject: str, sequence: int, time_ns: int, data: bytes) -> Key:
    """The key that distinguishes a record of its subject, on either side.

    Each run counts its sequences from 0, so the key has the time. Batches of frames may be split differently, so
    frames have their identifier instead of a sequence: each is sent at most once in a tick.
    """
    return subject, time_ns, identifier_in(data) if subject in FRAMES else sequence


def identifier_in(data: bytes) -> bytes:
    """The identifier of a frame's record."""
    if data[:1] == _TIME_TAG and data[9:10] == _IDENTIFIER_TAG:
        return data[10:14]
    identifier: int = _decode(SENT, data).identifier
    return identifier.to_bytes(4, "little")


_TIME_TAG: Final = b"\x09"  # a frame's record begins with field 1, of 8 bytes
_IDENTIFIER_TAG: Final = b"\x1d"  # then field 3, of 4 bytes: fixed widths come first in recorder.encoding.protobuf


def message_of(sample: Sample) -> Any:  # noqa: ANN401 - of any subject
    """The message of a sample; ValueError if it cannot be decoded: forged inputs may produce anything."""
    message = codec.decode(BY_NAME[sample.subject], sample.payload)
    if isinstance(message, codec.PayloadFault):
        raise ValueError(f"the rerun {sample.subject} is no message: {message.detail}")  # noqa: TRY004
    return message


def records_of(sample: Sample) -> Iterator[tuple[Key, bytes]]:
    """The records that a recorder would write of a sample."""
    message = message_of(sample)
    for time_ns, data in _ROUTES[sample.subject].transcode(message):
        yield key_of(sample.subject, message.sequence, time_ns, data), data


_ROUTES: Final = {name: Route(0, BY_NAME[name], "") for name in COMPARED}


def _decode(subject: str, data: bytes) -> Any:  # noqa: ANN401 - of any class of a record
    return typed_decoder(_ROUTES[subject].kind)(data)

"""Recorded runs through today's arbiter: one log after its journal, and what differs.

The recorded frames and requests through today's arbiter: are the decisions the same?

A robot's runs, out of its logs: the journal in its order, and beside it what the gateway said.

A journal message holds what the gateway's core was given, in order. Where none is missing a run is whole; else it
falls into parts, each without a gap. What a recorder asked for later stands behind newer messages, so what is
ahead of its time is held until its turn, up to a bound.

The comparison of what was recorded with what the same inputs give again, byte for byte.

Either side may be ahead of the other. What both have is compared and forgotten, so memory holds no more than their
distance.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, Final, Protocol

import msgspec

from gateway.rerun import rerun
from recorder.encoding.routes import Route
from recorder.reading.logs import Faults, LogFile
from recorder.reading.rows import Progress, Row, Selection, read_rows
from recorder.reading.survey import Configurations, settings_from
from recorder.reading.topics import UNREADABLE, typed_decoder
from schemas import codec
from schemas.decisions import Journal
from schemas.journal import COMMAND_RULES
from schemas.settings import Settings
from schemas.subjects import BY_NAME

JOURNAL: Final = "journal"
"""The subject."""

HELD_MAX: Final = 600
"""Journals that wait for those before them, half a minute's: what a recorder asks for comes within seconds."""

HELD_BYTES: Final = 64 * 1024 * 1024
"""The length of all that wait."""

JOURNAL_BYTES: Final = 1024 * 1024
"""The longest inputs of a journal: a twentieth of a second has some kilobytes, and a checkpoint some ten more."""


class PartEnd(msgspec.Struct, frozen=True):
    """The extent of a part of a run.

    Attributes:
        run: the run's number.
        first: the place of its first input in the run, from 0.
        inputs: their number.
        detail: the gap before or behind it; empty if there is none.
    """

    run: int
    first: int
    inputs: int
    detail: str


class Tape:
    """Plays the rows of one robot: its journals part by part, everything else to whoever takes it.

    Attributes:
        end: the end of the part that was played last.

    Args:
        rows: of one robot, by log time.
        take: takes each row that is no journal, in its place between the journals.
        faults: takes what cannot be read.
    """

    def __init__(self, rows: Iterator[Row], take: Callable[[Row], None], faults: Faults) -> None:
        self._rows = rows
        self._take = take
        self._faults = faults
        self._run: int | None = None
        self._held: dict[int, Journal] = {}
        self._reached = 0
        """The place behind all that was played of the run."""
        self._next: Journal | None = None
        """The first of the run that follows."""
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
        """The publish time of the first journal of the part that has come; 0 if none has."""
        return self._held[min(self._held)].time_ns if self._held else 0

    def journals(self) -> Iterator[Journal]:
        """Yield the journals of the part that has come, in order; at the end ``end`` describes the part."""
        run = self._run
        if run is None:
            return
        # A part behind a gap has waited for what is missing; a run's beginning may still come.
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
        """End the part: the journal played last cannot be used. Another part begins behind it."""
        inputs = max(self._reached - self.end.first, 0)
        self.end = msgspec.structs.replace(self.end, inputs=inputs, detail=detail)

    def _waits(self) -> bool:
        """Read one more journal of the run; False if it has no more, or too many wait already."""
        if self._next is not None or self._is_full:
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

    @property
    def _is_full(self) -> bool:
        return len(self._held) >= HELD_MAX or sum(len(one.inputs) for one in self._held.values()) > HELD_BYTES

    def _read(self) -> Journal | None:
        """The next journal of a run that is not over."""
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
                self._faults.add(
                    f"{row.topic.name}: a journal of {len(journal.inputs)} bytes, which no gateway says"
                )
                continue
            # Nothing to run is in an empty one, and it would be held for ever.
            if isinstance(journal, Journal) and journal.count and journal.run not in self._past:
                return journal
        return None


DIFFERENCES_TOLD: Final = 1000
"""Differences that are listed one by one; the rest are only counted."""

WAITING_MAX: Final = 200_000
"""Records and samples that wait for their counterpart; beyond it the oldest are given up, and counted."""

COPIES_MAX: Final = 100_000
"""Compared messages of a subject that are remembered: two recorders write each of them."""

SAME_RUN_NS: Final = 10_000_000_000
"""The two sides of a message have the same time. Where they do not by far, a sequence has begun anew."""

BATCH_NS: Final = 100_000_000
"""Longest delay of what a gateway says in batches: the end of a run may be missing from them."""

Key = tuple[str, Hashable]
"""The subject, and a value that distinguishes its messages."""


class RecordedOutput(msgspec.Struct, frozen=True, gc=False):
    """A record: its publish time in nanoseconds since 1970, and its bytes."""

    time_ns: int
    data: bytes


class Difference(msgspec.Struct, frozen=True):
    """A message that is not the same.

    Attributes:
        subject: in the table of subjects.
        time_ns: nanoseconds since 1970.
        what: ``changed`` or ``only recorded``.
        fields: of a changed one each field that differs: what was recorded, and what comes out again.
        message: of one that was only recorded the whole of it.
    """

    subject: str
    time_ns: int
    what: str
    fields: dict[str, tuple[Any, Any]] = {}
    message: Any = None


class Comparison:
    """Compares the two sides.

    Args:
        decode: the bytes of a subject's record to its message, to say what differs.

    Attributes:
        same: number of equal messages, by subject.
        differences: the first ones.
        difference_count: all of them.
        unrecorded: messages that come out again and are not in the log, by subject: it lost them, or was not to
            hold them.
        given_up: messages that waited too long for their counterpart, or came too long after it.
        begins_ns, ends_ns: the times of the first message with a sequence and of the newest of all that came out
            again, since 1970; ``begins_ns`` is None before.
    """

    def __init__(self, decode: Callable[[str, bytes], Any]) -> None:
        self._decode = decode
        self.same: Counter[str] = Counter()
        self.differences: list[Difference] = []
        self.difference_count = 0
        self.unrecorded: Counter[str] = Counter()
        self.given_up = 0
        self.begins_ns: int | None = None
        self.ends_ns = 0
        self._recorded: OrderedDict[Key, RecordedOutput] = OrderedDict()
        self._others: OrderedDict[tuple[Key, RecordedOutput], None] = OrderedDict()
        self._again: OrderedDict[Key, RecordedOutput] = OrderedDict()
        self._compared: dict[str, OrderedDict[Hashable, int]] = {}
        self._forgotten: dict[str, Any] = {}

    def record(self, key: Key, said: RecordedOutput) -> None:
        """A message of the log."""
        again = _counterpart(self._again, key, said)
        if again is not None:
            self._compare(key, said, again)
        elif said.time_ns > self.ends_ns or not self._is_copy(key, said):
            self._wait_recorded(key, said)

    def say_again(self, key: Key, said: RecordedOutput) -> None:
        """A message that comes out of the inputs."""
        if self.begins_ns is None and isinstance(key[1], int):
            # Not with a frame that was received: behind a place of rest the next state comes at another time.
            self.begins_ns = said.time_ns
        self.ends_ns = max(self.ends_ns, said.time_ns)
        if self._others and (key, said) in self._others:
            # What was recorded before it under the same key does not come again.
            del self._others[key, said]
            recorded: RecordedOutput | None = said
        else:
            recorded = _counterpart(self._recorded, key, said)
        if recorded is not None:
            self._compare(key, recorded, said)
        else:
            self._wait(self._again, key, said)

    def end(self) -> list[tuple[Key, RecordedOutput]]:
        """Nothing more comes out. Returns what was recorded later than that: it belongs to what follows.

        What was recorded before the first message that came out again belongs to nothing.
        """
        # What was said last is in a batch that may not have been published any more.
        last_ns = self.ends_ns - BATCH_NS
        self.unrecorded.update(key[0] for key, said in self._again.items() if said.time_ns <= last_ns)
        self._again.clear()
        later: list[tuple[Key, RecordedOutput]] = []
        begins_ns = self.begins_ns or 0
        for key, said in (*self._recorded.items(), *self._others):
            if said.time_ns > self.ends_ns - BATCH_NS:
                later.append((key, said))
            elif said.time_ns >= begins_ns and not self._is_copy(key, said):
                self._differ(
                    Difference(key[0], said.time_ns, "only recorded", message=self._decode(key[0], said.data))
                )
        self._recorded.clear()
        self._others.clear()
        return later

    def _is_copy(self, key: Key, said: RecordedOutput) -> bool:
        """Report whether it is a second copy of what was compared already, or comes too late to tell."""
        subject, value = key
        compared = self._compared.setdefault(subject, OrderedDict()).get(value)
        if compared is not None:
            return compared == hash(said)
        is_forgotten = subject in self._forgotten and value <= self._forgotten[subject]
        self.given_up += is_forgotten
        return is_forgotten

    def _compare(self, key: Key, recorded: RecordedOutput, again: RecordedOutput) -> None:
        subject = key[0]
        compared = self._compared.setdefault(subject, OrderedDict())
        compared[key[1]] = hash(recorded)
        if len(compared) > COPIES_MAX:
            self._forgotten[subject], _ = compared.popitem(last=False)
        if recorded.data == again.data:
            self.same[subject] += 1
            return
        if self.difference_count >= DIFFERENCES_TOLD:
            self.difference_count += 1
            return
        then, now = self._decode(subject, recorded.data), self._decode(subject, again.data)
        fields = {
            name: (before, after)
            for name in then.__struct_fields__
            if (before := getattr(then, name)) != (after := getattr(now, name))
        }
        self._differ(Difference(subject, recorded.time_ns, "changed", fields))

    def _differ(self, difference: Difference) -> None:
        self.difference_count += 1
        if len(self.differences) < DIFFERENCES_TOLD:
            self.differences.append(difference)

    def _wait_recorded(self, key: Key, said: RecordedOutput) -> None:
        """Keep it, beside what waits under its key: of another run, or put in by somebody."""
        first = self._recorded.get(key)
        if first is None:
            self._wait(self._recorded, key, said)
        elif first != said:
            if abs(first.time_ns - said.time_ns) > SAME_RUN_NS:
                self._recorded[key], said = said, first
            self._wait(self._others, (key, said), None)

    def _wait(self, waiting: OrderedDict[Any, Any], key: Hashable, said: RecordedOutput | None) -> None:
        waiting[key] = said
        if len(waiting) > WAITING_MAX:
            waiting.popitem(last=False)
            # Before anything came out again nothing was to be compared.
            self.given_up += self.begins_ns is not None


def _counterpart(
    waiting: OrderedDict[Key, RecordedOutput], key: Key, said: RecordedOutput
) -> RecordedOutput | None:
    """The other side of a message, if it waits. One of another run, with the same sequence, is none."""
    other = waiting.get(key)
    if other is None or abs(other.time_ns - said.time_ns) > SAME_RUN_NS:
        return None
    del waiting[key]
    return other


SENT: Final = "can/{bus}/tx"
DECIDED: Final = ("safety/decision", "safety/event", "safety/state", SENT)
"""The subjects that tell what the arbiter decided."""

RECEIVED: Final = "can/{bus}/rx"
COMPARED: Final = (*DECIDED, RECEIVED)
"""The subjects that must come out the same. No rule changes received frames: they show whether the log is true."""

NO_CONFIGURATION: Final = "the log does not hold the robot's configuration"
NO_PLACE: Final = (
    "it holds no checkpoint of this version, and the gateway was never at rest in it: there is no place to begin"
)
OTHER_RULES: Final = "made under other rules, it can be run again from its first input alone"
"""A reason for running nothing again: the log begins in the run, and its rules were others."""


BROKEN_OFF: Final = "the inputs that follow cannot be run again"

DETAIL_MAX: Final = 300
"""Characters of an error that are shown."""


class SampleAgain(Protocol):
    """A sample that comes out again: the subject's name and the MessagePack payload."""

    @property
    def subject(self) -> str: ...  # noqa: D102 - the class says it
    @property
    def payload(self) -> bytes: ...  # noqa: D102


Rerun = Callable[[Settings, Iterable[Journal]], Iterator[SampleAgain]]
"""Settings, and the journals of one run from its first input on, to all that comes out."""


class RerunResult(msgspec.Struct, frozen=True):
    """A run, run again.

    Attributes:
        run: its number.
        first: the place of the first input that was there, from 0: behind a gap a run continues in another result.
        inputs: so many there were without a gap.
        detail: the missing part of the run, or why nothing was run again; empty if all was.
        start_ns, end_ns: of what came out again, nanoseconds since 1970; 0 if nothing did.
        same: number of messages that are equal byte for byte, by subject.
        unrecorded: messages that come out again and are not in the log.
        difference_count: messages that differ; ``differences`` are the first ones.
        given_up: messages that waited too long for their counterpart to be compared.
        rules: the command rules under which the run was made, as in ``schemas.journal``.
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
    rules: int = COMMAND_RULES

    @property
    def differs_ns(self) -> int | None:
        """The time of the first difference; None if there is none."""
        return min((one.time_ns for one in self.differences), default=None)


def rerun_parts(player: RerunPlayer, again: Rerun = rerun) -> Iterator[RerunResult]:
    """Every run that a player plays, run again with the settings that it had."""
    while player.next_part():
        yield _rerun(player, again)


def _rerun(player: RerunPlayer, again: Rerun) -> RerunResult:
    text = player.configuration()
    if text is None:
        return player.skip(NO_CONFIGURATION)
    start_ns = 0
    try:
        for sample in again(settings_from(text), player.journals()):
            if sample.subject in _ROUTES:
                for key, said in records_of(sample):
                    start_ns = start_ns or said.time_ns
                    player.comparison.say_again(key, said)
    except UNREADABLE as error:
        player.break_off(error)
    return player.result(start_ns)


class RerunPlayer:
    """The runs of one robot, one after the other.

    Args:
        robot: its name.
        logs: in the order of their beginnings.
        configurations: those of its runs.
        faults: takes what cannot be read.
        progress: receives the number of bytes that were read.

    Attributes:
        comparison: of the run that has come.
    """

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
        """The journals of the part, in their order."""
        for journal in self._tape.journals():
            self._rules = journal.rules
            yield journal

    def configuration(self) -> str | None:
        """The TOML text that was in force in the run that has come; None if the log does not hold it."""
        return self._configurations.at(self._tape.next_time_ns)

    def break_off(self, error: Exception) -> None:
        """The journal cannot be used from here on: this part ends."""
        self._tape.break_off(f"{BROKEN_OFF}: {error!r}"[:DETAIL_MAX])
        self._faults.add(f"{self._robot}: run {self._tape.end.run}: {self._tape.end.detail}")

    def skip(self, detail: str) -> RerunResult:
        """The run is not run again."""
        for _ in self.journals():
            pass
        return msgspec.structs.replace(self._result(0), inputs=0, detail=detail)

    def result(self, start_ns: int) -> RerunResult:
        """Sum up the run; what was recorded behind its end is kept for the next one."""
        result = self._result(start_ns)
        if start_ns:
            return result
        why = NO_PLACE if self._rules == COMMAND_RULES else OTHER_RULES
        return msgspec.structs.replace(result, detail="; ".join(filter(None, (result.detail, why))))

    def _result(self, start_ns: int) -> RerunResult:
        comparison, self.comparison = self.comparison, Comparison(_decode)
        end = self._tape.end
        for key, said in comparison.end():
            self.comparison.record(key, said)
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
            rules=self._rules,
        )

    def _record(self, row: Row) -> None:
        try:
            key = key_of(row.topic.subject, row.sequence, row.publish_ns, row.data)
        except UNREADABLE as error:
            self._faults.add(f"{row.topic.name}: a record that cannot be read: {error}")
            return
        self.comparison.record(key, RecordedOutput(row.publish_ns, row.data))


def key_of(subject: str, sequence: int, time_ns: int, data: bytes) -> Key:
    """Return the key that distinguishes a record of its subject, on either side.

    It is the sequence; but batches of frames may be cut elsewhere when they come again, so of these it is time and
    identifier: each goes out once in a tick at most.
    """
    if subject not in {SENT, RECEIVED}:
        return subject, sequence
    return subject, (time_ns, identifier_in(data))


def identifier_in(data: bytes) -> bytes:
    """The identifier of a frame's record."""
    if data[:1] == _TIME_TAG and data[9:10] == _IDENTIFIER_TAG:
        return data[10:14]
    identifier: int = _decode(SENT, data).identifier
    return identifier.to_bytes(4, "little")


_TIME_TAG: Final = b"\x09"
"""A record of a frame begins with the field 1, of 8 bytes."""

_IDENTIFIER_TAG: Final = b"\x1d"
"""The field 3, of 4 bytes, follows: fixed widths come first, see ``recorder.encoding.protobuf``."""


def message_of(sample: SampleAgain) -> Any:  # noqa: ANN401 - of any subject
    """The message of a sample.

    Raises:
        ValueError: it is none: inputs that somebody made up may make a core say anything.
    """
    message = codec.decode(BY_NAME[sample.subject], sample.payload)
    if isinstance(message, codec.PayloadFault):
        raise ValueError(f"{sample.subject} that comes out is no message: {message.detail}")  # noqa: TRY004
    return message


def records_of(sample: SampleAgain) -> Iterator[tuple[Key, RecordedOutput]]:
    """The records that a recorder would write of a sample."""
    message = message_of(sample)
    for time_ns, data in _ROUTES[sample.subject].transcode(message):
        yield key_of(sample.subject, message.sequence, time_ns, data), RecordedOutput(time_ns, data)


_ROUTES: Final = {name: Route(0, BY_NAME[name], "") for name in COMPARED}


def _decode(subject: str, data: bytes) -> Any:  # noqa: ANN401 - of any class of a record
    return typed_decoder(_ROUTES[subject].kind)(data)

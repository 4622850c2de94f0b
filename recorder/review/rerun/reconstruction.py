"""The parts that logs lack of a robot, made again out of its journal, as a log of their own that nobody wrote.

A gateway keeps its journal for some minutes, and a recorder that could not hear or write asks for it later. Its
states, its feedback and its frames it cannot ask for. But the journal holds all that the gateway's core was given:
given to the core again, it says the same again. What is made so stays apart from what was recorded: its topics
are others, and whoever wants both has to say so (``Selection.is_filled``) and sees which is which.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from io import BytesIO
from itertools import groupby, islice
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import BinaryIO, Final

import msgspec

from recorder.encoding.protobuf_schema import descriptor_set, schema_name
from recorder.encoding.routes import Route
from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import ChunkBuilder
from recorder.mcap.writer import McapFile
from recorder.reading.configurations import Configurations, configurations_of, settings_from
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile, logs_of
from recorder.reading.rows import END_OF_TIME_NS, Progress, Row, Selection, read_rows
from recorder.reading.survey import survey
from recorder.reading.topics import ORIGIN, RECONSTRUCTED_CHUNK, UNREADABLE
from recorder.review.rerun.holes import STATES, StateHole, holes, pieces
from recorder.review.rerun.player import (
    DECIDED,
    DETAIL_MAX,
    Rerun,
    SampleAgain,
    identifier_in,
    installed,
    message_of,
)
from recorder.review.rerun.tapes import JOURNAL, Tape
from schemas.command_rules import COMMAND_RULES
from schemas.decisions import Journal
from schemas.exit_codes import CommandError
from schemas.messages import CanFrames, Feedback, RobotState
from schemas.settings import Settings
from schemas.subjects import BY_NAME, SUBJECTS

FROM_JOURNAL: Final = "from the journal"
OTHERWISE: Final = "from the journal, by an arbiter that decides otherwise than the recorded one"

MADE_AGAIN: Final = frozenset(
    {*DECIDED, *(one.name for one in SUBJECTS if issubclass(one.type, Feedback | CanFrames | RobotState))}
)
"""The subjects that follow from the journal; health, which does not, is lost."""

BACK_NS: Final = (15_000_000_000, 75_000_000_000, 600_000_000_000)
"""The journal is taken from so long before a hole, for a place to begin; if there is none, from longer before."""

BEHIND_NS: Final = 1_500_000_000
"""The inputs that are needed behind a hole, so that all that belongs in it has come out."""

LATER_NS: Final = 120_000_000_000
"""Samples that a recorder asks for later are received within this time behind a hole."""

TOGETHER_NS: Final = 60_000_000_000
"""Holes that are so near to each other are filled at once..."""

STRETCH_NS: Final = 120_000_000_000
"""...up to this length, and longer ones in parts: all of one part is in memory while it is made."""

BESIDE_NS: Final = 15_000_000_000
"""So long before a hole what comes out again is held against what was recorded."""

HOLES_MAX: Final = 64
"""Holes, or rows of near ones, that are filled; what is missing beyond is told as missing."""

RECORDS_MAX: Final = 1_500_000
"""Messages of one part that are held, recorded ones and others: two minutes of a saturated bus have a million."""

SAID_MAX: Final = 256 * 1024 * 1024
"""Their length in bytes."""

CONTENT_MAX: Final = 512 * 1024 * 1024
"""The length of all that is made for one question; what is missing beyond is told as missing."""

TOO_MUCH: Final = "more follows from its journal than a gateway says in such a time"

_CHUNK_BYTES: Final = 1 << 20

_Recorded = tuple[str, int, object]
"""The identity of a message: topic, publish time, and its sequence, or the identifier of a frame."""


def filled(
    logs: Sequence[LogFile],
    faults: Faults,
    progress: Progress = lambda _: None,
    *,
    from_ns: int = 0,
    to_ns: int = END_OF_TIME_NS,
) -> list[LogFile]:
    """Return logs, and among them one for each of their holes, which is made when it is first read.

    Args:
        logs: in the order of their beginnings.
        faults: takes what cannot be read.
        progress: is called with no bytes.
        from_ns: the first log time of which holes are looked for...
        to_ns: ...and the first one that is too late.

    Returns:
        The logs alone, where no gateway is installed that could run a journal again.
    """
    near = [log for log in logs if log.start_ns < to_ns and log.end_ns >= from_ns]
    found = [one for one in holes(near, faults, progress) if one.log_from_ns < to_ns and one.log_to_ns >= from_ns]
    if not found:
        return list(logs)
    try:
        again: Rerun = installed("rerun")
    except CommandError:
        return list(logs)
    about = survey(logs, faults)
    made: list[LogFile] = []
    room = _ContentBudget()
    for robot, its in groupby(sorted(found, key=attrgetter("robot", "log_from_ns")), attrgetter("robot")):
        of_robot = logs_of(robot, logs)
        configurations = configurations_of(robot, of_robot, about, faults)
        before: HoleFilling | None = None
        parts = (part for one in its for part in pieces(one, STRETCH_NS))
        for row in islice(_rows_of_near(parts), HOLES_MAX):
            # In the midst of a hole nothing was recorded that a part of it could be held against.
            is_next = before is not None and before.holes[-1].to_ns == row[0].from_ns
            known = sorted([*of_robot, *(made[-1:] if is_next else [])], key=_beginning)
            before = HoleFilling(row, known, configurations, again, faults, progress, room)
            made.append(_file(before, logs))
    return sorted([*logs, *made], key=_beginning)


_beginning = attrgetter("start_ns")


def _rows_of_near(found: Iterable[StateHole]) -> Iterator[list[StateHole]]:
    row: list[StateHole] = []
    for one in found:
        is_near = row and one.log_from_ns - row[-1].log_to_ns <= TOGETHER_NS
        if row and (not is_near or one.log_to_ns - row[0].log_from_ns > STRETCH_NS):
            yield row
            row = []
        row.append(one)
    if row:
        yield row


class _ContentBudget:
    """The bytes that may still be made for a question."""

    def __init__(self) -> None:
        self.left = CONTENT_MAX


def _file(filling: HoleFilling, logs: Sequence[LogFile]) -> LogFile:
    first, last = filling.holes[0], filling.holes[-1]
    robots = frozenset(
        (root, name) for log in logs for root, name in log.robots if first.robot in {name, f"{root}/{name}"}
    )
    return LogFile(
        Path(filling.url),
        0,
        first.log_from_ns,
        last.log_to_ns,
        robots,
        logs[0].namesakes,
        stored=filling,
        is_reconstructed=True,
        published_from_ns=first.from_ns,
    )


class HoleFilling:
    """The content of holes of one robot that are near to each other; a ``StoredLog`` that is made when it is read.

    Args:
        holes: by their times.
        logs: that have them; with the part before it, where it is a part of a long hole.
        configurations: of the robot's runs.
        again: runs a journal again.
        faults: takes what cannot be read.
        progress: is called with no bytes.
        room: for the content.
    """

    def __init__(
        self,
        holes: Sequence[StateHole],
        logs: Sequence[LogFile],
        configurations: Configurations,
        again: Rerun,
        faults: Faults,
        progress: Progress,
        room: _ContentBudget,
    ) -> None:
        self.holes = holes
        self._logs = logs
        self._configurations = configurations
        self._again = again
        self._faults = faults
        self._look: Progress = lambda _: progress(0)
        self._room = room
        self._content: bytes | None = None

    @property
    def is_made(self) -> bool:
        """True once somebody has read it."""
        return self._content is not None

    @property
    def url(self) -> str:
        """A name for people."""
        return f"the journal of {self.holes[0].robot}"

    @property
    def size(self) -> int:
        """The length of the content in bytes."""
        return len(self._made)

    def open(self) -> BinaryIO:
        """Return a stream of the content."""
        return BytesIO(self._made)

    def fetch(self, start: int, end: int) -> None:
        """All is there."""

    @property
    def _made(self) -> bytes:
        if self._content is None:
            best = _Remaking(self.holes)
            for back_ns in BACK_NS if self._has_journal() else ():
                remaking = self._remake(back_ns)
                if remaking.is_too_much:
                    self._faults.add(f"{self.holes[0].robot}: what is missing is not reconstructed: {TOO_MUCH}")
                    break
                if remaking.begins_ns < best.begins_ns:
                    best = remaking
                if best.begins_ns <= self.holes[0].from_ns:
                    break
            self._content = best.content()
            if len(self._content) > self._room.left:
                self._faults.add(
                    f"{self.holes[0].robot}: what is missing is not reconstructed: of all holes it would be "
                    f"more than {CONTENT_MAX} bytes; ask for one robot, or with --from and --to"
                )
                self._content = _Remaking(self.holes).content()
            self._room.left -= len(self._content)
        return self._content

    def _remake(self, back_ns: int) -> _Remaking:
        first, last = self.holes[0], self.holes[-1]
        inputs_from_ns, inputs_to_ns = first.from_ns - back_ns, last.to_ns + BEHIND_NS
        wanted = MADE_AGAIN | {JOURNAL}

        def is_needed(row: Row) -> bool:
            since_ns = inputs_from_ns if row.topic.subject == JOURNAL else remaking.beside_ns
            return since_ns <= row.publish_ns <= inputs_to_ns

        remaking = _Remaking(self.holes)
        selection = self._selection(wanted, max(0, first.log_from_ns - back_ns))
        rows = read_rows(self._logs, selection, self._faults, self._look)
        tape = Tape(filter(is_needed, rows), remaking.record, self._faults)
        while tape.next_part():
            text = self._configurations.at(tape.next_time_ns)
            settings = None if text is None else self._settings(text)
            if settings is None:
                for _ in tape.journals():
                    pass
                continue
            try:
                for sample in self._again(settings, remaking.watch(self._looked_at(tape.journals()))):
                    self._look(0)
                    remaking.say_again(sample)
                    if remaking.is_too_much:
                        return remaking
            except UNREADABLE as error:
                tape.break_off("")
                detail = f"{error}"[:DETAIL_MAX]
                self._faults.add(f"{first.robot}: its journal cannot be run again from there on: {detail}")
        return remaking

    def _looked_at(self, journals: Iterator[Journal]) -> Iterator[Journal]:
        """The same journals. A run may be made to take long, and to say nothing meanwhile."""
        for journal in journals:
            self._look(0)
            yield journal

    def _settings(self, text: str) -> Settings | None:
        """The settings of a run; None if this version cannot read them."""
        try:
            return settings_from(text)
        except CommandError as error:
            self._faults.add(f"{self.holes[0].robot}: its configuration cannot be read: {error}")
            return None

    def _has_journal(self) -> bool:
        """Report whether anything of the holes is in the journal."""
        rows = read_rows(
            self._logs, self._selection({JOURNAL}, self.holes[0].log_from_ns), self._faults, self._look
        )
        return any(one.from_ns <= row.publish_ns < one.to_ns for row in rows for one in self.holes)

    def _selection(self, subjects: frozenset[str] | set[str], from_ns: int) -> Selection:
        robot = self.holes[0].robot
        return Selection(
            lambda topic: topic.robot == robot and topic.subject in subjects,
            from_ns,
            self.holes[-1].log_to_ns + LATER_NS,
            is_filled=True,
        )


class _Again(msgspec.Struct, frozen=True, gc=False):
    """A message that came out again, of a time that logs lack. Times are nanoseconds since 1970."""

    log_ns: int
    publish_ns: int
    sequence: int
    data: bytes


class _Remaking:
    """Holds what comes out again against what was recorded, and keeps what was not.

    Args:
        holes: of one robot, by their times.

    Attributes:
        begins_ns: the earliest time of what came out again, since 1970.
        beside_ns: what was published before that is not looked at.
    """

    def __init__(self, holes: Sequence[StateHole]) -> None:
        self.begins_ns = END_OF_TIME_NS
        self.beside_ns = holes[0].from_ns - BESIDE_NS
        self._holes = holes
        self._recorded: dict[_Recorded, int] = {}
        self._said: dict[_Recorded, int] = {}
        self._missing: dict[str, dict[_Recorded, _Again]] = {}
        self._subjects: dict[str, str] = {}
        self._is_otherwise = False
        self._records, self._bytes = RECORDS_MAX, SAID_MAX

    @property
    def is_too_much(self) -> bool:
        """More was recorded, or came out again, than is held: then nothing of it is of use."""
        return self._records < 0 or self._bytes < 0

    def watch(self, journals: Iterator[Journal]) -> Iterator[Journal]:
        """Yield the journals, looked at."""
        for journal in journals:
            self._is_otherwise |= journal.rules != COMMAND_RULES
            yield journal

    def record(self, row: Row) -> None:
        """A message of the logs."""
        if self.is_too_much:
            return
        self._records -= 1
        name = row.topic.name
        self._recorded[name, row.publish_ns, _part(row.topic.subject, row.sequence, row.data)] = hash(row.data)

    def say_again(self, sample: SampleAgain) -> None:
        """A sample of which the messages came out again."""
        if sample.subject not in MADE_AGAIN:
            return
        message = message_of(sample)
        bus = message.bus if isinstance(message, CanFrames) else ""
        topic = f"{self._holes[0].key}/{sample.subject.format(bus=bus)}"
        self._subjects[topic] = sample.subject
        for publish_ns, data in _route(sample.subject).transcode(message):
            self.begins_ns = min(self.begins_ns, publish_ns)
            if publish_ns < self.beside_ns:
                continue
            self._records -= 1
            self._bytes -= len(data)
            key = topic, publish_ns, _part(sample.subject, message.sequence, data)
            hole = next((one for one in self._holes if one.from_ns <= publish_ns < one.to_ns), None)
            if hole is None:
                self._said[key] = hash(data)
                continue
            log_ns = min(max(publish_ns + hole.late_ns, hole.log_from_ns), hole.log_to_ns - 1)
            self._missing.setdefault(topic, {})[key] = _Again(log_ns, publish_ns, message.sequence, data)

    def content(self) -> bytes:
        """The log of what is missing."""
        stream = BytesIO()
        file = McapFile(stream, "cruiser-gateway")
        origin = FROM_JOURNAL if self._is_as_recorded() else OTHERWISE
        messages = []
        for channel_id, topic in enumerate(filter(self._fits, sorted(self._missing)), 1):
            kind = _route(self._subjects[topic]).kind
            name = f"{topic}/{RECONSTRUCTED_CHUNK}"
            file.add_channel(
                LogChannel(channel_id, name, schema_name(kind), descriptor_set(kind), metadata={ORIGIN: origin})
            )
            lacking = (one for key, one in self._missing[topic].items() if key not in self._recorded)
            messages += [(one.log_ns, channel_id, one) for one in lacking]
        builder = ChunkBuilder(_CHUNK_BYTES)
        for log_ns, channel_id, one in sorted(messages, key=itemgetter(0)):
            builder.add(channel_id, one.sequence, log_ns, one.publish_ns, one.data)
            if builder.is_full:
                _flush(builder, file)
        _flush(builder, file)
        file.finish()
        return stream.getvalue()

    def _is_as_recorded(self) -> bool:
        """Report whether the arbiter says all that was recorded beside the holes as it was recorded.

        Where of its states none was recorded, and others were, the journal is that of another robot or run.
        """
        own = {topic for topic, subject in self._subjects.items() if subject in DECIDED}
        said = {key: one for key, one in self._said.items() if key[0] in own}
        for topic in own & self._missing.keys():
            said |= {key: hash(one.data) for key, one in self._missing[topic].items() if key in self._recorded}
        return (
            not self._is_otherwise
            and self._is_known()
            and all(one == self._recorded.get(key, one) for key, one in said.items())
        )

    def _is_known(self) -> bool:
        """Report whether a state beside the holes was recorded, or none that could have been."""
        topic = f"{self._holes[0].key}/{STATES}"
        said = [one for one in self._said if one[0] == topic]
        first_ns, last_ns = min((one[1] for one in said), default=0), max((one[1] for one in said), default=0)
        heard = (one for one in self._recorded if one[0] == topic and first_ns <= one[1] <= last_ns)
        return any(one in self._recorded for one in said) or next(heard, None) is None

    def _fits(self, topic: str) -> bool:
        """Report whether a topic may be filled: feedback only if it comes out beside the holes as it was recorded.

        A core that begins at a place of rest, or with its run, counts or dates some of it anew: nothing that it
        decides depends on that.
        """
        if self._subjects[topic] in DECIDED:
            return True
        beside = [self._recorded.get(key) == said for key, said in self._said.items() if key[0] == topic]
        return 2 * sum(beside) > len(beside)


def _part(subject: str, sequence: int, data: bytes) -> object:
    """Return the part by which messages of one topic and one time are told apart."""
    if BY_NAME[subject].type is CanFrames:
        return identifier_in(data)
    return sequence if subject in DECIDED else None


@cache
def _route(subject: str) -> Route:
    return Route(0, BY_NAME[subject], "")


def _flush(builder: ChunkBuilder, file: McapFile) -> None:
    chunk = builder.seal()
    if chunk is not None:
        file.write_chunk(chunk)

"""The recorded frames and requests through today's arbiter: are the decisions the same?"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final, Protocol

import msgspec

from gateway.rerun import rerun
from recorder.encoding.routes import Route
from recorder.reading.configurations import Configurations, settings_from
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress, Row, Selection, read_rows
from recorder.reading.topics import UNREADABLE, typed_decoder
from recorder.review.rerun.comparison import Comparison, Difference, Key, RecordedOutput
from recorder.review.rerun.tapes import JOURNAL, Tape
from schemas import codec
from schemas.decisions import Journal
from schemas.journal import COMMAND_RULES
from schemas.settings import Settings
from schemas.subjects import BY_NAME

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
"""The field 3, of 4 bytes, follows: fixed widths come first, see ``recorder.encoding.transcode``."""


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

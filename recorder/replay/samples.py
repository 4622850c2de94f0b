"""Turns the rows of a log into the Zenoh samples that it was made from. Pure.

A record of ours becomes its typed message and that its MessagePack payload, a RawSample the payload that it kept,
frames of one batch a batch. What never was a Zenoh sample (other makers' channels, lines for viewers) is passed
over.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final

import msgspec

from recorder.encoding.routes import RAW_CHUNK
from recorder.reading.faults import Faults
from recorder.reading.topics import UNREADABLE, Topic
from recorder.replay.rows import ReplayRun
from schemas import codec, keys
from schemas.can_word import BITRATE_SWITCH, ERROR, ERROR_STATE_INDICATOR, EXTENDED, FD, REMOTE
from schemas.messages import CanFrame, CanFrames, Message, RawSample
from schemas.subjects import COMMAND_CHUNK, Subject

DEFAULT_ROOT: Final = "replay"
"""The root of a replay, which nobody takes for a robot's."""

_PLAIN: Final = re.compile(r"[^/*$?#]+(/[^/*$?#]+)*")
"""A key that names one thing: a log may hold anything, and a wildcard would reach many."""

_RAW_ENDING: Final = f"/{RAW_CHUNK}"
_LAST_NS: Final = 2**63 - 1

ENCODING_BYTES_MAX: Final = 255
"""Zenoh takes no longer encoding: its session panics over one, and sends nothing from then on."""

DELETED: Final = "deleted"
"""The reason with which the recorder keeps a sample that deletes its key."""

Wants = Callable[[str], bool]
"""Reports whether a key of the log is wanted."""


class ReplaySample(msgspec.Struct, frozen=True):
    """A sample to be published again.

    Attributes:
        time_ns: when it is due, in the log's time.
        key: its destination.
        encoding: Zenoh's, with the schema.
        subject: its row in the table of subjects; None if it has none.
        message: its content; None of a sample that was kept as it was.
        raw: the payload of such a sample.
        attachment: likewise; empty if there was none.
        is_delete: it says that the key was deleted.
    """

    time_ns: int
    key: str
    encoding: str
    subject: Subject | None = None
    message: Message | None = None
    raw: bytes = b""
    attachment: bytes = b""
    is_delete: bool = False

    def payload(self, shift_ns: int = 0) -> bytes:
        """The payload, with all its receive times so much later. A payload that nobody can read stays as it is."""
        if self.message is None:
            return self.raw
        return codec.encode(shifted(self.message, shift_ns) if shift_ns else self.message)


def shifted(message: Message, shift_ns: int) -> Message:
    """The message, so much later: its ``time_ns``, and those of the frames in it."""

    def later(time_ns: int) -> int:
        return min(max(0, time_ns + shift_ns), _LAST_NS)

    changes: dict[str, Any] = {"time_ns": later(message.time_ns)}
    if isinstance(message, CanFrames):
        changes["frame_time_ns"] = list(map(later, message.frame_time_ns))
    return msgspec.structs.replace(message, **changes)


class KeyMap:
    """From the key in the log to the one under the replay's root.

    The log's root is replaced. If the log has several, each stays, behind the new one: else two robots of the same
    name would become one. A key under none of them is put behind the new root whole.

    Args:
        root: the destination.
        log_roots: the roots of the robots in the log.
    """

    def __init__(self, root: str, log_roots: Sequence[str]) -> None:
        self._root = root
        self._replaced = f"{log_roots[0]}/" if len(log_roots) == 1 else ""

    def __call__(self, key: str) -> str | None:
        """The new key. None if nothing may be published there: a command, or a key that reaches many."""
        if _PLAIN.fullmatch(key) is None or COMMAND_CHUNK in key.split("/"):
            return None
        return f"{self._root}/{key.removeprefix(self._replaced)}"


def roots_of(topics: Iterable[Topic]) -> list[str]:
    """The roots of the robots, and of the recorders, that topics are about."""
    ours = [keys.parse(topic.name) for topic in topics if topic.kind not in {None, RawSample}]
    return sorted({parts.root for parts in ours if parts is not None})


def overlap(one: str, other: str) -> bool:
    """Report whether one of two roots is the other, or begins it: what is under the longer is then under both."""
    shorter, longer = sorted((f"{one}/", f"{other}/"), key=len)
    return longer.startswith(shorter)


def root_of_token(key: str) -> str:
    """The root of the gateway whose liveliness token this is."""
    return key.rsplit("/", 2)[0]


def may_hold(topic: Topic, wants: Wants) -> bool:
    """Report whether samples of wanted keys may be in a topic."""
    if topic.kind is RawSample:
        # Its samples tell their keys; only of a broken one of a known key the topic does too.
        key = topic.name.removesuffix(_RAW_ENDING)
        return key == topic.name or wants(key)
    return _subject_of(topic) is not None and wants(topic.name)


class Samples:
    """Makes samples of runs of rows.

    Args:
        new_key: from the key in the log to the new one.
        wants: a test of keys in the log.
        faults: takes what cannot be decoded.

    Attributes:
        withheld: samples that must not be published: commands, keys that name more than one thing,
            and what has an encoding that is too long for Zenoh.
    """

    def __init__(self, new_key: KeyMap, wants: Wants, faults: Faults) -> None:
        self._new_key = new_key
        self._wants = wants
        self._faults = faults
        self._known: dict[Topic, tuple[str | None, Subject | None]] = {}
        self.withheld = 0

    def of(self, runs: Iterable[ReplayRun]) -> Iterator[ReplaySample]:
        """The samples, in the order of the runs."""
        for run in runs:
            try:
                sample = self._sample(run)
            except UNREADABLE as error:
                self._faults.add(f"{run.topic.name}: a message cannot be decoded: {error}")
                continue
            if sample is not None:
                yield sample

    def _sample(self, run: ReplayRun) -> ReplaySample | None:
        topic = run.topic
        decode = topic.decode
        if decode is None:
            return None
        if topic.kind is RawSample:
            return self._raw(run.time_ns, decode(run.rows[0].data))
        known = self._known.get(topic)
        if known is None:
            known = self._known[topic] = (self._new_key(topic.name), _subject_of(topic))
        key, subject = known
        if key is None or subject is None:
            self.withheld += key is None
            return None
        if topic.kind is CanFrame:
            message = batch([decode(row.data) for row in run.rows], run.rows[0].sequence)
        else:
            message = decode(run.rows[0].data)
        return ReplaySample(run.time_ns, key, subject.encoding, subject, message)

    def _raw(self, time_ns: int, raw: RawSample) -> ReplaySample | None:
        if not self._wants(raw.key):
            return None
        key = self._new_key(raw.key)
        if key is None or len(raw.encoding.encode()) > ENCODING_BYTES_MAX:
            self.withheld += 1
            return None
        return ReplaySample(
            time_ns,
            key,
            raw.encoding,
            raw=raw.payload,
            attachment=raw.attachment,
            is_delete=raw.reason == DELETED,
        )


def batch(frames: Sequence[CanFrame], sequence: int) -> CanFrames:
    """Frames of a log as the batch that they came in. Of that the log keeps neither ``dropped`` nor the time."""
    return CanFrames(
        time_ns=max(frame.time_ns for frame in frames),
        sequence=sequence,
        bus=frames[0].bus,
        dropped=0,
        frame_time_ns=[frame.time_ns for frame in frames],
        can_id=[word_of(frame) for frame in frames],
        fd_flags=[fd_flags_of(frame) for frame in frames],
        length=[frame.dlc for frame in frames],
        data=[frame.data for frame in frames],
    )


def word_of(frame: CanFrame) -> int:
    """Identifier and kind of a frame in one word."""
    return (
        frame.identifier
        | (EXTENDED if frame.is_extended else 0)
        | (REMOTE if frame.is_remote else 0)
        | (ERROR if frame.is_error else 0)
    )


def fd_flags_of(frame: CanFrame) -> int:
    """CAN FD's flags of a frame."""
    return (
        (FD if frame.is_fd else 0)
        | (BITRATE_SWITCH if frame.bitrate_switch else 0)
        | (ERROR_STATE_INDICATOR if frame.error_state_indicator else 0)
    )


def _subject_of(topic: Topic) -> Subject | None:
    """The row of the table that a topic's messages are of; None if key and schema do not fit, or are not ours."""
    parts = keys.parse(topic.name)
    if parts is None:
        return None
    recorded = CanFrame if parts.subject.type is CanFrames else parts.subject.type
    return parts.subject if topic.kind is recorded else None

"""Entries of what happened: their texts, the robots' clocks, stops, repeats and missing samples.

A message's own time is used as long as its clock agrees with the recorder's; else the arbiter's tick gives the
order.

A stop is an end of command that no client asked for. Later reports of it by a guard or the next gateway, and
further causes before the robot is engaged again, belong to the same stop.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Hashable, Iterable, Iterator
from enum import Enum
from itertools import islice, pairwise
from operator import itemgetter
from typing import Final

import msgspec

from schemas.decisions import GUARD_STOP_ENDED, EventKind, Severity, is_same_run
from schemas.messages import ControllerState, Count, GatewayHealth, TimeNs
from schemas.reasons import AS_ASKED, Reason
from schemas.requests import Tick
from schemas.settings import TICK_NS

NEAR_NS: Final = 1_000_000_000  # clocks that differ by less agree

FAR_NS: Final = 60_000_000_000
"""No sample takes this long: a larger difference is the clock's, from the first sample on."""

_SURE_AFTER: Final = 5  # samples that must agree before a clock counts as behind by less than ``FAR_NS``
SETTLE_NS: Final = 3_000_000_000  # time over which they must be received: samples that waited come in one burst
_TICKS_NEAR: Final = 500  # over so many ticks (5 s) the tick measures time


class RobotClock:
    """The clock of one robot.

    No sample is received before it is sent, and any may be late: the smallest difference between receipt and the
    robot's time is the best estimate of the offset, and a smaller one corrects it.

    Attributes:
        offset_ns: added to its times; 0 while it agrees with the recorder's.
        corrected_ns: by how much the last state corrected the offset, and so the times before it; 0 if the clock
            was set.
    """

    def __init__(self) -> None:
        self.offset_ns = 0
        self.corrected_ns = 0
        self._tick: int | None = None
        self._publish_ns = self._log_ns = 0
        self._told_ns = 0  # the offset of the last entry about it
        self._begin(0)

    def _begin(self, log_ns: int) -> None:
        """Start over: earlier states say nothing about this clock."""
        self._least_ns: int | None = None
        self._since_ns = log_ns
        self._states = 0
        self._is_settled = False

    def hear(self, tick: int, publish_ns: int, log_ns: int) -> str:
        """Add a state of the arbiter. Returns a sentence about a change of the clock, or an empty text."""
        self.corrected_ns = 0
        if self._tick is not None and tick <= self._tick and is_same_run(tick, self._tick):
            return ""
        said = ""
        before_ns = self.offset_ns
        is_near = self._is_near(tick)
        set_ns = self._set_by(publish_ns, log_ns, tick)
        if not is_near:
            self._begin(log_ns)
        elif set_ns:
            said = f"the robot's clock was set by {set_ns / 1e9:+.1f} s"
            self._least_ns = self.offset_ns - set_ns
            self._is_settled = True
        self._weigh(log_ns - publish_ns, log_ns)
        if said:
            self._told_ns = self.offset_ns
        elif is_near:
            self.corrected_ns = self.offset_ns - before_ns
        self._tick, self._publish_ns, self._log_ns = tick, publish_ns, log_ns
        return said or self._news()

    def _weigh(self, off_ns: int, log_ns: int) -> None:
        """Take the difference between receipt and the robot's time; the smallest counts, once it is sure."""
        self._states += 1
        self._least_ns = off_ns if self._least_ns is None else min(self._least_ns, off_ns)
        is_behind = NEAR_NS < self._least_ns <= FAR_NS
        is_sure = self._states >= _SURE_AFTER and log_ns - self._since_ns >= SETTLE_NS
        if is_behind and not is_sure and not self._is_settled:
            return
        self._is_settled = True
        self.offset_ns = 0 if 0 <= self._least_ns <= NEAR_NS else self._least_ns

    def _news(self) -> str:
        if abs(self.offset_ns - self._told_ns) <= NEAR_NS:
            return ""
        self._told_ns = self.offset_ns
        if abs(self.offset_ns) <= NEAR_NS:
            return "the robot's clock agrees with the recorder's again"
        way = "behind" if self.offset_ns > 0 else "ahead of"
        seconds = abs(self.offset_ns) / 1e9
        return f"the robot's clock is {seconds:.1f} s {way} the recorder's; times here are the recorder's"

    def place(self, publish_ns: int, log_ns: int, tick: int | None = None) -> int:
        """The recorder's time of a message that the robot dates ``publish_ns``; never after its receipt."""
        set_ns = 0 if tick is None else self._set_by(publish_ns, log_ns, tick)
        return min(publish_ns + self.offset_ns - set_ns, log_ns)

    def _is_near(self, tick: int) -> bool:
        """True if the tick is so near to the last state's that it measures time."""
        return self._tick is not None and abs(tick - self._tick) <= _TICKS_NEAR

    def _set_by(self, publish_ns: int, log_ns: int, tick: int) -> int:
        """The step of the clock since the last state, by the ticks; else 0."""
        if self._tick is None or not self._is_near(tick):
            return 0
        set_ns = publish_ns - self._publish_ns - (tick - self._tick) * TICK_NS
        # After a pause of the gateway the receipt is as late as the clock says; else the clock was set.
        received_ns = log_ns - self._log_ns
        paused = abs((publish_ns - self._publish_ns) - received_ns) <= NEAR_NS
        return 0 if paused or abs(set_ns) <= NEAR_NS else set_ns


class EntryKind(Enum):
    """The kind of an entry: those of ``safety/event``, and others found in a log."""

    LEASE = "lease"
    ENGAGED = "engaged"
    STOP = "stop"
    STOPPED = "stopped"
    LATCH = "latch"
    RESET = "reset"
    TAKEOVER = "takeover"
    FAULT = "fault"
    GUARD = "guard"
    REFUSAL = "refusal"
    REQUEST = "request"
    GATEWAY = "gateway"
    RECORDER = "recorder"
    GAP = "gap"
    CLOCK = "clock"
    END = "end"


OF_EVENT: Final = {kind: EntryKind(kind.value) for kind in EventKind}  # a newer version may have others

STOP_KINDS: Final = frozenset({EntryKind.STOP, EntryKind.TAKEOVER, EntryKind.GUARD})
"""Entries that end the command of the robot without a request for it."""

ENDS: Final = STOP_KINDS | {EntryKind.END}  # those, and the ends that a client asked for


def kind_of(kind: EntryKind, reason: Reason) -> EntryKind:
    return EntryKind.END if kind is EntryKind.STOP and reason in AS_ASKED else kind


class EntrySource(Enum):
    """The part of the log that an entry comes from; ``state``: derived from two states of the arbiter."""

    EVENT = "event"
    STATE = "state"
    DECISION = "decision"
    HEALTH = "health"
    RECORDER = "recorder"
    LOG = "log"


class Entry(msgspec.Struct, frozen=True, kw_only=True):
    """An entry of the timeline.

    Attributes:
        time_ns: in nanoseconds since 1970, by the robot's clock, or by the recorder's if they differ by over a
            second. A fault from ``gateway/health``, which comes once a second, happened between ``time_ns`` and
            ``last_ns``.
        last_ns: the end, or the time of the last of ``count`` entries; else as ``time_ns``.
        robot: empty if it is about no robot.
        count: number of similar entries shown as one.
        holder: the lease's holder then; empty if there was none or it is unknown.
        is_late: it comes after entries that happened later.
        is_stop: a stop begins with it.
    """

    time_ns: TimeNs
    last_ns: TimeNs
    robot: str
    kind: EntryKind
    severity: Severity
    source: EntrySource
    text: str
    count: Count = 1
    reason: Reason = Reason.NONE
    operator: str = ""
    holder: str = ""
    request: str = ""
    tick: Tick | None = None
    is_late: bool = False
    is_stop: bool = False

    @property
    def tells_of_guard(self) -> bool:
        """True if it says how a stop by the guard ended, which is no stop itself."""
        return self.kind is EntryKind.GUARD and self.text.startswith(GUARD_STOP_ENDED)


FAILURES_IN_WORDS: Final = {
    "checksum": "checksums fail",
    "implausible": "impossible values",
    "alive_counter": "alive counter fails",
    "period": "wrong period",
    "silence": "silent",
}

_FRAME_COUNTS: Final[tuple[tuple[str, str, str], ...]] = (
    ("checksum_faults", "checksum", "wrong checksum"),
    ("implausible", "implausible", "impossible value"),
    ("lost", "alive_lost", "frame missing"),
)
"""Counters of each frame whose rise makes an entry, and the kind of fault that needs no further entry then."""

DROPPED: Final = "inbox_drops"

_COUNTS: Final[tuple[tuple[str, str], ...]] = (
    ("bus_losses", "the CAN bus was lost"),
    ("bus_drops", "frame dropped: not read in time, or garbled"),
    ("publish_failures", "Zenoh did not accept a sample"),
    (DROPPED, "request dropped unread: too many arrived"),
)
"""Counters since the gateway's start whose rise makes an entry."""

_HARMLESS: Final = frozenset({"unknown_identifier", "remote_frame", "error_frame", "fd_frame"})
"""Mostly frames of other nodes on the bus."""

_FAULTS: Final = {"period": "frame at a wrong interval", "silence": "frame did not come"}
"""Kinds of faults in words, without a frame's name."""


class Risen(msgspec.Struct, frozen=True):
    """A fault that began or ended since the health before.

    Attributes:
        what: the same for similar faults.
        about: the feedback frames concerned.
        is_end: it happened by the time of this health; else at an unknown time after the one before.
    """

    what: str
    text: str
    count: int = 1
    about: tuple[str, ...] = ()
    severity: Severity = Severity.WARNING
    kind: EntryKind = EntryKind.FAULT
    is_end: bool = False


def risen(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    """The faults that are new since the message before; without one of the same run, the present ones."""
    yield from _bus(before, now)
    # Gathered over all frames, since a pulled cable silences all of them.
    were = {} if before is None else {frame.name: frame.failures for frame in before.feedback}
    new, over = dict[str, list[str]](), dict[str, list[str]]()
    for frame in now.feedback:
        was, are = set(were.get(frame.name, ())), set(frame.failures)
        for found, failures in ((new, are - was), (over, was - are)):
            for failure in sorted(failures):
                found.setdefault(failure, []).append(frame.name)
    for failure, names in new.items():
        yield Risen(failure, FAILURES_IN_WORDS.get(failure, failure), len(names), tuple(names))
    for failure, names in over.items():
        text = f"recovered ({failure})"
        yield Risen(f"{failure} over", text, len(names), tuple(names), Severity.INFO, is_end=True)
    if before is not None:
        yield from _counts(before, now)


def _counts(before: GatewayHealth, now: GatewayHealth) -> Iterator[Risen]:
    pairs = [(frame, was) for frame in now.feedback for was in before.feedback if was.name == frame.name]
    said = {failure for frame, was in pairs for failure in frame.failures if failure not in was.failures}
    for field, kind, words in _FRAME_COUNTS:
        grown = {frame.name: getattr(frame, field) - getattr(was, field) for frame, was in pairs}
        rises = {name: rise for name, rise in grown.items() if rise > 0}
        if rises:
            said.add(kind)
            # The gateway counts a late frame as lost only seconds after its time.
            yield Risen(words, words, sum(rises.values()), tuple(rises), is_end=field == "lost")
    for kind, count in now.faults.items():
        rise = count - before.faults.get(kind, 0)
        if rise > 0 and kind not in said:
            severity = Severity.INFO if kind in _HARMLESS else Severity.WARNING
            words = _FAULTS.get(kind, f"fault of a frame: {kind}")
            yield Risen(f"fault {kind}", words, rise, severity=severity)
    for field, words in _COUNTS:
        rise = getattr(now, field) - getattr(before, field)
        if rise > 0:
            yield Risen(field, words, rise)


def _bus(before: GatewayHealth | None, now: GatewayHealth) -> Iterator[Risen]:
    if not now.bus_up and (before is None or before.bus_up):
        detail = f": {now.bus_detail}" if now.bus_detail else ""
        yield Risen("bus down", f"the CAN bus {now.bus} is down{detail}", severity=Severity.ERROR)
    if before is not None and now.bus_up and not before.bus_up:
        yield Risen("bus up", f"the CAN bus {now.bus} is up again", severity=Severity.INFO, is_end=True)
    if before is not None and now.variant is not before.variant:
        text = f"the firmware variant changed from {before.variant.value} to {now.variant.value}"
        yield Risen("variant", text, severity=Severity.INFO, kind=EntryKind.GATEWAY, is_end=True)
    was = ControllerState.UNKNOWN if before is None else before.controller
    if now.controller is not was and now.controller is not ControllerState.UNKNOWN:
        yield Risen("controller", f"the CAN controller changed from {was.value} to {now.controller.value}")


APART_NS: Final = 10_000_000_000
"""A cause this long after the last one is another stop: the robot was moved in between."""


class Stops:
    """Finds the stops among the entries of one robot, by time."""

    def __init__(self) -> None:
        self._caused_ns: int | None = None  # the time of the stop's newest cause; None once the robot is engaged
        self._has_guard_latch = False

    def mark(self, entry: Entry) -> Entry:
        """Return the entry, with ``is_stop`` if a stop begins with it."""
        if entry.kind is EntryKind.ENGAGED:
            self._caused_ns = None
        elif entry.kind is EntryKind.RESET:
            self._has_guard_latch = False
        elif self._stops(entry):
            before_ns, self._caused_ns = self._caused_ns, entry.time_ns
            is_apart = entry.kind in STOP_KINDS and before_ns is not None and entry.time_ns - before_ns > APART_NS
            if before_ns is None or is_apart:
                return msgspec.structs.replace(entry, is_stop=True)
        return entry

    def _stops(self, entry: Entry) -> bool:
        """True if the command has ended with this entry."""
        if entry.kind is EntryKind.LATCH and entry.reason is Reason.GUARD:
            # Each gateway that finds the latch reports it at its start.
            is_new, self._has_guard_latch = not self._has_guard_latch, True
            return is_new
        if entry.kind is EntryKind.GATEWAY:
            return entry.severity is Severity.ERROR
        return entry.kind in STOP_KINDS and entry.reason is not Reason.NONE and not entry.tells_of_guard


IDS_KEPT: Final = 50_000  # samples of a topic that are remembered: a quarter of an hour of decisions

PIECES_MAX: Final = 1000

SPELL_NS: Final = 2_500_000_000  # similar entries within this time of each other are one spell

LATE_NS: Final = 60_000_000_000
"""A spell ends after this time without an addition; messages that were queried late may come out of order."""

SPELLS_MAX: Final = 10_000  # limit of open spells; beyond it the oldest ends
NAMES_MAX: Final = 30  # limit of names in a spell; a chassis has ten feedback frames


class SequenceHole(msgspec.Struct, frozen=True):
    """Missing samples: their number, and the times of the last one before and the first one after."""

    count: int
    after_ns: int
    before_ns: int


class Sequences:
    """The sequence numbers of one topic in one run, in any order."""

    def __init__(self) -> None:
        self._pieces: list[tuple[int, int, int, int]] = []
        """First and last sequence of each piece without holes, and their times."""
        self._told: list[SequenceHole] = []

    def add(self, sequence: int, time_ns: int) -> None:
        pieces = self._pieces
        at = bisect_right(pieces, sequence, key=itemgetter(0))
        if at and sequence <= pieces[at - 1][1]:
            return
        piece = (sequence, sequence, time_ns, time_ns)
        if at < len(pieces) and pieces[at][0] == sequence + 1:
            behind = pieces.pop(at)
            piece = (sequence, behind[1], time_ns, behind[3])
        if at and pieces[at - 1][1] == sequence - 1:
            pieces[at - 1] = (pieces[at - 1][0], piece[1], pieces[at - 1][2], piece[3])
        else:
            pieces.insert(at, piece)
        if len(pieces) > PIECES_MAX:
            self._told.append(_hole(pieces[0], pieces[1]))
            del pieces[0]

    def holes(self) -> list[SequenceHole]:
        """The ranges of missing samples between the first and the last one."""
        return self._told + [_hole(*pair) for pair in pairwise(self._pieces)]


def _hole(before: tuple[int, int, int, int], behind: tuple[int, int, int, int]) -> SequenceHole:
    return SequenceHole(behind[0] - before[1] - 1, before[3], behind[2])


class Repeats:
    """Finds repeated samples: an incident beside its log, or two recorders' logs."""

    def __init__(self, kept: int = IDS_KEPT) -> None:
        self._kept = kept
        self._ids: set[tuple[int, int]] = set()
        self._order: deque[tuple[int, int]] = deque()

    def is_new(self, publish_ns: int, sequence: int) -> bool:
        """True for the first sample with this publish time and sequence, as far as remembered."""
        one = (publish_ns, sequence)
        if one in self._ids:
            return False
        self._ids.add(one)
        self._order.append(one)
        if len(self._order) > self._kept:
            self._ids.discard(self._order.popleft())
        return True


class _Spell(msgspec.Struct):
    entry: Entry
    first_ns: int
    last_ns: int
    count: int
    touched_ns: int
    about: dict[str, None]


class Spells:
    """Gathers similar entries."""

    def __init__(self) -> None:
        self._open: dict[Hashable, _Spell] = {}
        self._over: list[Entry] = []

    def add(self, key: Hashable, entry: Entry, log_ns: int, about: Iterable[str] = ()) -> None:
        """Add an entry to the spell of its key.

        The spell has the text of its last entry, preceded by the names that all of them are ``about``.
        """
        spell = self._open.get(key)
        if spell is not None:
            if spell.first_ns - SPELL_NS <= entry.time_ns <= spell.last_ns + SPELL_NS:
                if entry.time_ns >= spell.last_ns:
                    spell.entry, spell.last_ns = entry, entry.last_ns
                spell.first_ns = min(spell.first_ns, entry.time_ns)
                spell.count += entry.count
                spell.touched_ns = log_ns
                spell.about = _first_names((*spell.about, *about))
                return
            del self._open[key]
            self._over.append(_told(spell))
        elif len(self._open) >= SPELLS_MAX:
            self._over.append(_told(self._open.pop(next(iter(self._open)))))
        self._open[key] = _Spell(entry, entry.time_ns, entry.last_ns, entry.count, log_ns, _first_names(about))

    def take(self, log_ns: int | None = None) -> list[Entry]:
        """The spells that are over at this log time; without one, all."""
        over, self._over = self._over, []
        ended = [
            key
            for key, spell in self._open.items()
            if log_ns is None or not 0 <= log_ns - spell.touched_ns <= LATE_NS
        ]
        return over + [_told(self._open.pop(key)) for key in ended]


def _first_names(names: Iterable[str]) -> dict[str, None]:
    return dict.fromkeys(islice(dict.fromkeys(names), NAMES_MAX))


def _told(spell: _Spell) -> Entry:
    text, names = spell.entry.text, ", ".join(spell.about)
    if names:
        count = f"{'at least ' if len(spell.about) == NAMES_MAX else ''}{len(spell.about)} frames"
        text = f"{names}: {text}" if len(spell.about) == 1 else f"{count} ({names}): {text}"
    return msgspec.structs.replace(
        spell.entry, time_ns=spell.first_ns, last_ns=spell.last_ns, count=spell.count, text=text
    )

"""Faults on demand: their words, and those in force.

- ``HOST:PORT``, as people write it. Pure.
- The faults in force: begun, counted down, ended. Pure; time is an argument.

The faults that can be asked for while the chassis runs, and their words: one fault a line. Pure.

``parse`` turns a line into a typed value, or into the reason why it is none with the nearest right word.
``GRAMMAR`` is the list of lines that people see in the help.
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from enum import Enum
from itertools import accumulate
from typing import Final, NamedTuple, TypeVar

import msgspec

from gateway.chassis.frame import ERROR, EXTENDED, IDENTIFIER_MASK, STANDARD_MASK, Frame
from gateway.sim.body import BOUNCE_NS, CONDITION_BOUNDS, FOREIGN_PERIOD_NS, REBOOT_NS, Conditions
from schemas.command_line import CommandError, ExitCode
from schemas.messages import Variant
from schemas.subjects import BY_DBC_MESSAGE

_FORM = re.compile(r"(?P<host>\[[0-9A-Fa-f:.%]+\]|[^\s:\[\]]+):(?P<port>[0-9]{1,5})")


def parse_address(text: str) -> tuple[str, int]:
    """Host and port; an IPv6 address stands in brackets, which are taken off.

    Raises:
        CommandError: the text is not of that form.
    """
    match = _FORM.fullmatch(text)
    if match is None or int(match["port"]) > 0xFFFF:
        raise CommandError(f"{text!r} is no HOST:PORT such as 127.0.0.1:29536", ExitCode.USAGE)
    return match["host"].strip("[]"), int(match["port"])


def show_address(host: str, port: int) -> str:
    """The text of an address."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


GRAMMAR: Final = """\
  silence MESSAGE              it is not sent; its counter stands still
  checksum MESSAGE             its checksum is wrong
  stuck MESSAGE                its alive counter stands still
  skip MESSAGE [by N]          its alive counter rises by N, 2 unless told
  drop MESSAGE every N         each N-th is lost on the way: the counter goes on
  drop MESSAGE next N          the next N are lost on the way
  freeze MESSAGE               its values stay as they are; its counter goes on and its checksum is right
  foreign ID [HEX|error] [every DURATION]
                               frames of another identifier: 3 digits standard, 8 extended
  bumper front|rear|both on|off [bounce]
                               hit, or free again; with 'bounce' the contact chatters first
  transmitter remote|command   the remote control takes over, or gives back
  sticks SPEED_MPS ANGLE_DEG   what the remote control asks for in remote mode
  scale wrong|right            drive command and feedback in the other variant's scale, wheel speeds not
  variant coarse|fine          another firmware
  slope DEG                    -30 to 30, nose up positive, whichever way the robot turns
  payload KG                   0 to 100
  pedal GAIN                   0 to 1: how much of the brake the brake pedal applies
  motor STRENGTH               0 to 1: how much of its force the motor has; 1 is whole
  brake GRIP                   0 to 1: how much of its grip the parking brake has; it reads applied all the same
  reboot                       the control unit reboots, 2 s unless told otherwise: no feedback, no drive, all
                               commands forgotten, counters from 0
  clear                        everything as it was at the start

MESSAGE is a feedback frame's name in the DBC, or 'all'. A MESSAGE fault ends with 'MESSAGE off', 'clear', or by
itself with 'for 3 frames'; every fault but 'clear' with 'for 2s'. Durations: 500ms, 2s, 1min."""

ALL_MESSAGES: Final = "all"

_WORD_MAX: Final = 40
"""Characters of a wrong word that an error repeats."""


class Disturbance(Enum):
    """The kind of damage to a feedback frame."""

    SILENCE = "silence"
    CHECKSUM = "checksum"
    STUCK = "stuck"
    SKIP = "skip"
    DROP = "drop"
    FREEZE = "freeze"


class Sticks(msgspec.Struct, frozen=True):
    """The demand of the remote control (RC): signed speed, and angle with left positive."""

    speed_mps: float
    angle_deg: float


class Contact(NamedTuple):
    """A bumper's contact, which may bounce before it rests."""

    hit: bool
    bounces: bool = False


class Foreign(msgspec.Struct, frozen=True):
    """Frames that are not of this chassis, or not sent by it.

    Attributes:
        can_id: with flags, as in Frame.
    """

    can_id: int
    data: bytes = bytes(8)
    period_ns: int = FOREIGN_PERIOD_NS


class ChassisFault(msgspec.Struct, frozen=True):
    """A fault, or the end of one.

    Attributes:
        kind: its word; of one kind and target a later fault replaces the earlier.
        targets: messages of the DBC or ALL_MESSAGES, sides, identifiers, or fields of ``Conditions``.
        value: for SKIP the step of the counter, for DROP every how manieth frame is lost.
    """

    kind: str
    targets: tuple[str | int, ...] = ("",)
    value: int | float | Sticks | Contact | Foreign | Variant = 1
    ended: bool = False


class FaultLine(msgspec.Struct, frozen=True):
    """A fault and how long it lasts.

    Attributes:
        duration_ns: 0 if it has no end.
        frames: it ends after this many frames of its message; 0 if they do not count.
    """

    fault: ChassisFault
    duration_ns: int = 0
    frames: int = 0


class ScheduledFault(msgspec.Struct, frozen=True):
    """A fault at a time after the start."""

    after_ns: int
    line: FaultLine


class FaultTextError(msgspec.Struct, frozen=True):
    """The reason why a text is no fault. A value: the text may come from the network."""

    reason: str


class _WrongWordError(Exception):
    """Inside the parser only."""


_UNITS_NS: Final = {"ms": 1_000_000, "s": 1_000_000_000, "min": 60_000_000_000}

CLEAR: Final = "clear"
_MESSAGE_FAULTS: Final = {disturbance.value for disturbance in Disturbance}
_MESSAGES: Final = {name.lower(): name for name in [*BY_DBC_MESSAGE, ALL_MESSAGES]}


def parse(text: str) -> FaultLine | FaultTextError:
    """The fault that a line asks for, or why it is none. Never raises."""
    try:
        return _line(_Words(text.split()))
    except _WrongWordError as error:
        return FaultTextError(str(error))


def parse_scheduled(text: str) -> ScheduledFault | FaultTextError:
    """A fault after a duration, as in ``3s bumper front on``; without one it is meant at once."""
    first, *rest = text.split(maxsplit=1) or [""]
    after_ns = 0
    if first[:1].isdigit():
        try:
            after_ns = _duration_ns(first)
        except _WrongWordError as error:
            return FaultTextError(str(error))
        text = "".join(rest)
    line = parse(text)
    return line if isinstance(line, FaultTextError) else ScheduledFault(after_ns, line)


def _line(words: _Words) -> FaultLine:
    name = _one_of(words.take("a fault"), _PARSERS, "fault")
    fault, frames = _PARSERS[name](words)
    duration_ns = 0
    if words.take_if("for"):
        value = words.take("a duration such as 2s")
        if fault.kind in _MESSAGE_FAULTS and not frames and words.take_if("frames"):
            frames = _whole(value)
        else:
            duration_ns = _duration_ns(value)
    words.end()
    if (duration_ns or frames) and (fault.ended or fault.kind == CLEAR):
        raise _WrongWordError("what ends a fault has no duration")
    return FaultLine(fault, duration_ns, frames)


class _Words:
    """The words of a line, from left to right."""

    def __init__(self, words: list[str]) -> None:
        self._words = words

    def take(self, wanted: str) -> str:
        if not self._words:
            raise _WrongWordError(f"the line ends where {wanted} is wanted")
        return self._words.pop(0)

    def take_if(self, word: str) -> bool:
        if self._words and self._words[0].lower() == word:
            del self._words[0]
            return True
        return False

    @property
    def next(self) -> str:
        return self._words[0].lower() if self._words else ""

    def end(self) -> None:
        if self._words:
            raise _WrongWordError(f"{_shown(self._words[0])} is more than the line needs")


def _shown(word: str) -> str:
    return repr(word if len(word) <= _WORD_MAX else word[:_WORD_MAX] + "...")


def _one_of(word: str, right: Iterable[str], what: str) -> str:
    choices = list(right)
    if word.lower() in choices:
        return word.lower()
    near = get_close_matches(word[:_WORD_MAX].lower(), choices, n=1, cutoff=0.5)
    # Messages are found in any letter case, and told in the DBC's.
    known = ", ".join(_MESSAGES.get(choice, choice) for choice in choices)
    hint = f"did you mean {_MESSAGES.get(near[0], near[0])!r}?" if near else f"there are: {known}"
    raise _WrongWordError(f"there is no {what} {_shown(word)}; {hint}")


def _whole(word: str) -> int:
    if re.fullmatch(r"[1-9][0-9]{0,5}", word) is None:
        raise _WrongWordError(f"{_shown(word)} is no whole number from 1 to 999999")
    return int(word)


def _number(word: str) -> float:
    if re.fullmatch(r"[+-]?[0-9]{1,4}(\.[0-9]{1,6})?", word) is None:
        raise _WrongWordError(f"{_shown(word)} is no number such as -0.5")
    return float(word)


def _duration_ns(word: str) -> int:
    match = re.fullmatch(r"([0-9]{1,6}(?:\.[0-9]{1,6})?)(ms|s|min)", word, re.ASCII)
    if match is None:
        raise _WrongWordError(f"{_shown(word)} is no duration such as 500ms, 2s or 1min")
    duration_ns = round(float(match[1]) * _UNITS_NS[match[2]])
    if not duration_ns:
        raise _WrongWordError(f"{_shown(word)} is no time at all")
    return duration_ns


_Parsed = tuple[ChassisFault, int]
"""A fault and the number of frames that it lasts, 0 if they do not count."""


def _message_fault(disturbance: Disturbance) -> Callable[[_Words], _Parsed]:
    def parse_words(words: _Words) -> _Parsed:
        targets, number, frames = (_MESSAGES[_one_of(words.take("a message"), _MESSAGES, "message")],), 1, 0
        if words.take_if("off"):
            return ChassisFault(disturbance.value, targets, ended=True), 0
        if disturbance is Disturbance.SKIP:
            number = _whole(words.take("a number")) if words.take_if("by") else 2
        elif disturbance is Disturbance.DROP:
            how = _one_of(words.take("'every' or 'next'"), ["every", "next"], "word")
            count = _whole(words.take("a number"))
            number, frames = (count, 0) if how == "every" else (1, count)
        return ChassisFault(disturbance.value, targets, number), frames

    return parse_words


def _foreign(words: _Words) -> _Parsed:
    can_id, data, period_ns = _can_id(words.take("an identifier")), bytes(8), FOREIGN_PERIOD_NS
    targets = (can_id,)
    if words.take_if("off"):
        return ChassisFault("foreign", targets, ended=True), 0
    if words.take_if("error"):
        can_id |= ERROR
    elif words.next not in {"", "every", "for"}:
        data = _data(words.take("data"))
    if words.take_if("every"):
        period_ns = max(_duration_ns(words.take("a duration such as 2s")), _UNITS_NS["ms"])
    return ChassisFault("foreign", targets, Foreign(can_id, data, period_ns)), 0


def _can_id(word: str) -> int:
    digits = word.removeprefix("0x").removeprefix("0X")
    if re.fullmatch(r"[0-9A-Fa-f]{3}", digits) and int(digits, 16) <= STANDARD_MASK:
        return int(digits, 16)
    if re.fullmatch(r"[0-9A-Fa-f]{8}", digits) and int(digits, 16) <= IDENTIFIER_MASK:
        return int(digits, 16) | EXTENDED
    raise _WrongWordError(f"{_shown(word)} is no identifier of 3 (up to 7FF) or 8 (up to 1FFFFFFF) hex digits")


def _data(word: str) -> bytes:
    if re.fullmatch(r"([0-9A-Fa-f]{2}){1,8}", word) is None:
        raise _WrongWordError(f"{_shown(word)} is not 1 to 8 bytes in hex digits, 'error' or 'every'")
    return bytes.fromhex(word)


def _choice(words: _Words, *right: str) -> str:
    return _one_of(words.take(" or ".join(map(repr, right))), right, "word")


def _bumper(words: _Words) -> _Parsed:
    side = _choice(words, "front", "rear", "both")
    sides = ("front", "rear") if side == "both" else (side,)
    contact = Contact(_choice(words, "on", "off") == "on", words.take_if("bounce"))
    return ChassisFault("bumper", sides, contact, ended=not any(contact)), 0


def _toggle(kind: str, on: str, off: str) -> Callable[[_Words], _Parsed]:
    return lambda words: (ChassisFault(kind, ended=_choice(words, on, off) == off), 0)


def _sticks(words: _Words) -> _Parsed:
    speed_mps = _number(words.take("a speed in m/s"))
    return ChassisFault("sticks", value=Sticks(speed_mps, _number(words.take("an angle in deg")))), 0


def _condition(field: str) -> Callable[[_Words], _Parsed]:
    low, high = CONDITION_BOUNDS[field]

    def parse_words(words: _Words) -> _Parsed:
        word = words.take(f"a number from {low:g} to {high:g}")
        value = _number(word)
        if not low <= value <= high:
            raise _WrongWordError(f"{_shown(word)} is not from {low:g} to {high:g}")
        return ChassisFault(_CONDITION, (field,), value), 0

    return parse_words


_CONDITION: Final = "condition"

_PARSERS: Final[dict[str, Callable[[_Words], _Parsed]]] = {
    **{disturbance.value: _message_fault(disturbance) for disturbance in Disturbance},
    "foreign": _foreign,
    "bumper": _bumper,
    "transmitter": _toggle("transmitter", "remote", "command"),
    "sticks": _sticks,
    "scale": _toggle("scale", "wrong", "right"),
    "variant": lambda words: (ChassisFault("variant", value=Variant(_choice(words, "coarse", "fine"))), 0),
    "slope": _condition("slope_deg"),
    "payload": _condition("payload_kg"),
    "pedal": _condition("pedal_gain"),
    "motor": _condition("motor_strength"),
    "brake": _condition("parking_grip"),
    "reboot": lambda _words: (ChassisFault("reboot"), 0),
    CLEAR: lambda _words: (ChassisFault(CLEAR), 0),
}

_T = TypeVar("_T")

_NEVER_NS: Final = 2**63


class _Active(msgspec.Struct):
    """A fault in force.

    Attributes:
        frames_left: None if its frames do not count.
        passed: frames of its message so far, for a fault of every n-th.
        next_ns: for foreign frames, when the next is due.
    """

    fault: ChassisFault
    since_ns: int
    until_ns: int
    frames_left: int | None
    passed: int = 0
    next_ns: int = _NEVER_NS


_Slot = tuple[str, str | int]
"""The target of a fault; a later fault of the same slot replaces the earlier."""


class Disturbances:
    """The faults in force, and those that wait for their time."""

    def __init__(self, messages: tuple[str, ...]) -> None:
        self._messages = messages
        self._active: dict[_Slot, _Active] = {}
        self._waiting: list[tuple[int, int, FaultLine]] = []
        self._injected = 0
        self._now_ns = 0

    def inject(self, line: FaultLine, at_ns: int) -> None:
        """Begins a fault, once ``advance`` reaches its time."""
        heapq.heappush(self._waiting, (at_ns, self._injected, line))
        self._injected += 1

    def advance(self, now_ns: int) -> None:
        """Begins and ends what is due."""
        self._now_ns = now_ns
        while self._waiting and self._waiting[0][0] <= now_ns:
            at_ns, _, line = heapq.heappop(self._waiting)
            self._begin(line, at_ns)
        for slot in [slot for slot, active in self._active.items() if active.until_ns <= now_ns]:
            del self._active[slot]

    @property
    def next_foreign_ns(self) -> int:
        """The due time of the next foreign frame; far away if there is none."""
        return min((active.next_ns for active in self._active.values()), default=_NEVER_NS)

    def foreign_frames(self, now_ns: int, wall_ns: int) -> list[Frame]:
        """The foreign frames that are due, and the next ones planned."""
        frames = []
        for active in self._active.values():
            foreign = active.fault.value
            if active.next_ns <= now_ns and isinstance(foreign, Foreign):
                active.next_ns = max(active.next_ns + foreign.period_ns, now_ns + 1)
                frames.append(Frame(foreign.can_id, foreign.data, wall_ns))
        return frames

    def strike(self, disturbance: Disturbance, message: str) -> int:
        """Count a frame of the message, and return the number of the fault that disturbs it; 0 if none does."""
        slot = (disturbance.value, message)
        number, active = self._value(int, disturbance.value, message), self._active.get(slot)
        if active is None or number is None:
            return 0
        active.passed += 1
        if disturbance is Disturbance.DROP and active.passed % number:
            return 0
        if active.frames_left is not None:
            active.frames_left -= 1
            if not active.frames_left:
                del self._active[slot]
        return number

    @property
    def quiet(self) -> bool:
        """Nothing is disturbed."""
        return not self._active

    @property
    def front_bumper(self) -> bool:
        """The front bumper is hit."""
        return self._is_hit("front")

    @property
    def rear_bumper(self) -> bool:
        """The rear bumper is hit."""
        return self._is_hit("rear")

    @property
    def remote(self) -> bool:
        """The remote control's SA switch is on remote."""
        return ("transmitter", "") in self._active

    @property
    def sticks(self) -> Sticks:
        """The demand of the remote control (RC)."""
        return self._value(Sticks, "sticks") or Sticks(0.0, 0.0)

    @property
    def wrong_scale(self) -> bool:
        """Drive command and feedback have the other variant's scale."""
        return ("scale", "") in self._active

    @property
    def firmware(self) -> Variant | None:
        """The variant that took the place of the first one."""
        return self._value(Variant, "variant")

    @property
    def rebooting(self) -> bool:
        """The control unit reboots."""
        return ("reboot", "") in self._active

    def conditions(self, start: Conditions) -> Conditions:
        """The conditions in force, given those of the start."""
        changed = {
            str(field): one.fault.value for (kind, field), one in self._active.items() if kind == _CONDITION
        }
        return msgspec.structs.replace(start, **changed) if changed else start

    def _value(self, kind: type[_T], word: str, target: str = "") -> _T | None:
        """The value of a fault in force."""
        active = self._active.get((word, target))
        return active.fault.value if active is not None and isinstance(active.fault.value, kind) else None

    def _begin(self, line: FaultLine, now_ns: int) -> None:
        fault = line.fault
        if fault.kind == CLEAR:
            self._active.clear()
            return
        for target in self._messages if fault.targets == (ALL_MESSAGES,) else fault.targets:
            if fault.ended:
                self._active.pop((fault.kind, target), None)
                continue
            duration_ns = line.duration_ns or (REBOOT_NS if fault.kind == "reboot" else _NEVER_NS)
            active = _Active(fault, now_ns, now_ns + duration_ns, line.frames or None)
            if isinstance(fault.value, Foreign):
                active.next_ns = now_ns
            self._active[fault.kind, target] = active

    def _is_hit(self, side: str) -> bool:
        contact = self._value(Contact, "bumper", side)
        if contact is None:
            return False
        since_ns = self._now_ns - self._active["bumper", side].since_ns
        changes = [end_ns for end_ns in accumulate(BOUNCE_NS) if end_ns > since_ns] if contact.bounces else []
        # After an even number of changes it rests, so one that is still to come out even is in the new state.
        return contact.hit is (len(changes) % 2 == 0)

"""Faults on demand: their grammar, one fault a line, and those in force. Pure; time is an argument.

``parse`` turns a line into a typed value or an error. ``GRAMMAR`` is the list of faults in the help.
"""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from enum import Enum
from itertools import accumulate
from typing import Final, NamedTuple, TypeVar

import msgspec

from gateway.chassis.frame import ERROR, EXTENDED, Frame
from gateway.sim.body import BOUNCE_NS, CONDITION_BOUNDS, FOREIGN_PERIOD_NS, REBOOT_NS, Conditions
from schemas.command_line import CommandError, ExitCode
from schemas.messages import Variant
from schemas.subjects import BY_DBC_MESSAGE

_FORM = re.compile(r"(?P<host>\[[0-9A-Fa-f:.%]+\]|[^\s:\[\]]+):(?P<port>[0-9]{1,5})")


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port, an IPv6 host without its brackets."""
    match = _FORM.fullmatch(text)
    if match is None or int(match["port"]) > 0xFFFF:
        raise CommandError(f"{text!r} is no HOST:PORT such as 127.0.0.1:29536", ExitCode.USAGE)
    return match["host"].strip("[]"), int(match["port"])


def show_address(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


GRAMMAR: Final = """\
  silence MESSAGE              it is not sent; its counter stands still
  checksum MESSAGE             its checksum is wrong
  stuck MESSAGE                its alive counter stands still
  skip MESSAGE [by N]          its alive counter rises by N, 2 by default
  drop MESSAGE every N         each N-th is lost on the way: the counter goes on
  drop MESSAGE next N          the next N are lost on the way
  freeze MESSAGE               its values stay as they are; its counter goes on and its checksum is right
  foreign ID [HEX|error] [every DURATION]
                               frames of another identifier: 3 digits standard, 8 extended
  bumper front|rear|both on|off [bounce]
                               hit, or free again; with 'bounce' the contact chatters first
  transmitter remote|command   the remote control takes over, or gives back
  sticks SPEED_MPS ANGLE_DEG   the remote control's demand in remote mode
  scale wrong|right            drive command and feedback in the other variant's scale, wheel speeds not
  variant coarse|fine          another firmware
  slope DEG                    -30 to 30, nose up positive, in every heading
  payload KG                   0 to 100
  pedal GAIN                   0 to 1: how much of the brake the brake pedal applies
  motor STRENGTH               0 to 1: how much of its force the motor has; 1 is whole
  brake GRIP                   0 to 1: how much of its grip the parking brake has; it reads applied all the same
  reboot                       the control unit reboots, 2 s by default: no feedback, no drive, all
                               commands forgotten, counters from 0
  clear                        everything as it was at the start

MESSAGE is a feedback frame's name in the DBC, or 'all'. A MESSAGE fault ends with 'MESSAGE off' or 'clear', or
after 'for 3 frames'; every fault but 'clear' can end after 'for 2s'. Durations: 500ms, 2s, 1min."""

ALL_MESSAGES: Final = "all"

_WORD_MAX: Final = 40  # characters of a wrong text that an error repeats


class Disturbance(Enum):
    """Kinds of damage to a feedback frame."""

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
    """A bumper's contact, which may bounce before it settles."""

    hit: bool
    bounces: bool = False


class Foreign(msgspec.Struct, frozen=True):
    """Frames of another device."""

    can_id: int
    data: bytes = bytes(8)
    period_ns: int = FOREIGN_PERIOD_NS


class ChassisFault(msgspec.Struct, frozen=True):
    """A fault, or the end of one.

    Attributes:
        kind: first word of its line; a later fault of the same kind and target replaces the earlier.
        targets: messages of the DBC or ALL_MESSAGES, sides, identifiers, or fields of ``Conditions``.
        value: for SKIP the step of the counter; for DROP n, if every nth frame is lost.
    """

    kind: str
    targets: tuple[str | int, ...] = ("",)
    value: int | float | Sticks | Contact | Foreign | Variant = 1
    ended: bool = False


class FaultLine(msgspec.Struct, frozen=True):
    """A fault and how long it lasts."""

    fault: ChassisFault
    duration_ns: int = 0  # 0 if it has no end
    frames: int = 0  # it ends after this many frames of its message; 0 for no limit
    after_ns: int = 0  # delay after the start


class FaultTextError(msgspec.Struct, frozen=True):
    """The reason why a text is not a fault: a value, because the text may come from the network."""

    reason: str


CLEAR: Final = "clear"
_CONDITION: Final = "condition"
_UNITS_NS: Final = {"ms": 1_000_000, "s": 1_000_000_000, "min": 60_000_000_000}
_MESSAGES: Final = {name.lower(): name for name in [*BY_DBC_MESSAGE, ALL_MESSAGES]}
_CONDITIONS: Final = {
    "slope": "slope_deg",
    "payload": "payload_kg",
    "pedal": "pedal_gain",
    "motor": "motor_strength",
    "brake": "parking_grip",
}

_WHOLE = "[1-9][0-9]{0,5}"
_NUMBER = r"[+-]?[0-9]{1,4}(?:\.[0-9]{1,6})?"
_TIME = r"[0-9]{1,6}(?:\.[0-9]{1,6})?(?:ms|s|min)"
_ON_MESSAGE = r" (?P<message>\S+)"
_FORMS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("silence", "checksum", "stuck"), f"{_ON_MESSAGE}(?P<off> off)?"),
    "skip": f"{_ON_MESSAGE}(?: by (?P<number>{_WHOLE})|(?P<off> off))?",
    "drop": f"{_ON_MESSAGE}(?: every (?P<number>{_WHOLE})| next (?P<frames>{_WHOLE})|(?P<off> off))",
    "freeze": f"{_ON_MESSAGE}(?P<off> off)?",
    "foreign": " (?:0x)?(?P<id>[0-7][0-9a-f]{2}|[01][0-9a-f]{7})(?:(?P<off> off)|"
    f"(?: (?P<data>error|(?:[0-9a-f]{{2}}){{1,8}}))?(?: every (?P<every>{_TIME}))?)",
    "bumper": " (?P<side>front|rear|both) (?P<state>on|off)(?P<bounce> bounce)?",
    "transmitter": " (?:remote|(?P<off>command))",
    "sticks": f" (?P<speed>{_NUMBER}) (?P<angle>{_NUMBER})",
    "scale": " (?:wrong|(?P<off>right))",
    "variant": " (?P<variant>coarse|fine)",
    **dict.fromkeys(_CONDITIONS, f" (?P<number>{_NUMBER})"),
    "reboot": "",
    CLEAR: "",
}
"""Pattern of each fault, after its first word."""

_FOR: Final = f"(?: for (?:(?P<for_frames>{_WHOLE}) frames|(?P<duration>{_TIME})))?"
_USAGES: Final = {
    usage.split()[0]: usage for usage in re.findall(r"^ {2}(\S.*?)(?: {2,}.*)?$", GRAMMAR, re.MULTILINE)
}


def parse(text: str) -> FaultLine | FaultTextError:
    """Parse a line into a fault, or the reason why it is not one. Never raises."""
    words = text.split()
    kind = words[0].lower() if words else ""
    if kind not in _FORMS:
        return FaultTextError(f"there is no fault {_shown(kind)}; {_hint(kind, _FORMS)}")
    match = re.fullmatch(f"{_FORMS[kind]}{_FOR}", "".join(f" {word}" for word in words[1:]), re.IGNORECASE)
    if match is not None and (name := match.groupdict().get("message")) and name.lower() not in _MESSAGES:
        return FaultTextError(f"there is no message {_shown(name)}; {_hint(name, list(_MESSAGES.values()))}")
    line = None if match is None else _line(kind, {name: part for name, part in match.groupdict().items() if part})
    return line or FaultTextError(f"{_shown(text.strip())} is not of the form '{_USAGES[kind]}'{_bounds(kind)}")


def parse_scheduled(text: str) -> FaultLine | FaultTextError:
    """Parse a fault with an optional delay, as in ``3s bumper front on``."""
    first, _, rest = text.strip().partition(" ")
    if re.fullmatch(_TIME, first) is None:
        return parse(text)
    line = parse(rest)
    return msgspec.structs.replace(line, after_ns=_duration_ns(first)) if isinstance(line, FaultLine) else line


def _shown(text: str) -> str:
    return repr(text if len(text) <= _WORD_MAX else text[:_WORD_MAX] + "...")


def _hint(word: str, right: Iterable[str]) -> str:
    choices = {one.lower(): one for one in right}
    near = get_close_matches(word[:_WORD_MAX].lower(), choices, n=1, cutoff=0.5)
    return f"did you mean {choices[near[0]]!r}?" if near else f"there are: {', '.join(choices.values())}"


def _bounds(kind: str) -> str:
    bounds = CONDITION_BOUNDS.get(_CONDITIONS.get(kind, ""))
    return f", from {bounds[0]:g} to {bounds[1]:g}" if bounds else ""


def _duration_ns(word: str) -> int:
    number, unit = re.findall(r"[0-9.]+|[a-z]+", word.lower())
    return round(float(number) * _UNITS_NS[unit])


def _line(kind: str, parts: Mapping[str, str]) -> FaultLine | None:
    """Build the fault of a line's parts; None if they do not fit together."""
    fault, duration_ns = _fault(kind, parts), _duration_ns(parts.get("duration", "0s"))
    frames = int(parts.get("frames") or parts.get("for_frames") or 0)
    is_over = fault is not None and (fault.ended or kind == CLEAR)
    if (
        fault is None
        or ("duration" in parts and not duration_ns)
        or ("for_frames" in parts and ("message" not in parts or "frames" in parts))
        or (is_over and (duration_ns or frames))
    ):
        return None
    return FaultLine(fault, duration_ns, frames)


def _fault(kind: str, parts: Mapping[str, str]) -> ChassisFault | None:
    ended = "off" in parts
    if "message" in parts:
        number = int(parts.get("number", 2 if kind == "skip" and not ended else 1))
        return ChassisFault(kind, (_MESSAGES[parts["message"].lower()],), number, ended=ended)
    if kind in _CONDITIONS:
        field, value = _CONDITIONS[kind], float(parts["number"])
        low, high = CONDITION_BOUNDS[field]
        return ChassisFault(_CONDITION, (field,), value) if low <= value <= high else None
    match kind:
        case "foreign":
            return _foreign(parts, ended=ended)
        case "bumper":
            sides = ("front", "rear") if parts["side"].lower() == "both" else (parts["side"].lower(),)
            contact = Contact(parts["state"].lower() == "on", "bounce" in parts)
            return ChassisFault(kind, sides, contact, ended=not any(contact))
        case "sticks":
            return ChassisFault(kind, value=Sticks(float(parts["speed"]), float(parts["angle"])))
        case "variant":
            return ChassisFault(kind, value=Variant(parts["variant"].lower()))
    return ChassisFault(kind, ended=ended)


def _foreign(parts: Mapping[str, str], *, ended: bool) -> ChassisFault:
    target = int(parts["id"], 16) | (EXTENDED if len(parts["id"]) > 3 else 0)
    if ended:
        return ChassisFault("foreign", (target,), ended=True)
    data, is_error = parts.get("data", bytes(8).hex()), parts.get("data", "").lower() == "error"
    period_ns = max(_duration_ns(parts["every"]), _UNITS_NS["ms"]) if "every" in parts else FOREIGN_PERIOD_NS
    frames = Foreign(target | (ERROR if is_error else 0), bytes(8) if is_error else bytes.fromhex(data), period_ns)
    return ChassisFault("foreign", (target,), frames)


_T = TypeVar("_T")

_NEVER_NS: Final = 2**63


class _Active(msgspec.Struct):
    """A fault in force."""

    fault: ChassisFault
    since_ns: int
    until_ns: int
    frames_left: int | None  # None without a limit
    passed: int = 0  # frames of its message so far, for a fault of every nth
    next_ns: int = _NEVER_NS  # due time of the next foreign frame


_Slot = tuple[str, str | int]  # kind and target of a fault; a later fault in the same slot replaces the earlier


class Disturbances:
    """The faults in force, and the scheduled ones."""

    def __init__(self, messages: tuple[str, ...]) -> None:
        self._messages = messages
        self._active: dict[_Slot, _Active] = {}
        self._waiting: list[tuple[int, int, FaultLine]] = []
        self._injected = 0
        self._now_ns = 0

    def inject(self, line: FaultLine, at_ns: int) -> None:
        """Schedule a fault for ``advance``."""
        heapq.heappush(self._waiting, (at_ns, self._injected, line))
        self._injected += 1

    def advance(self, now_ns: int) -> None:
        """Begin and end the faults that are due."""
        self._now_ns = now_ns
        while self._waiting and self._waiting[0][0] <= now_ns:
            at_ns, _, line = heapq.heappop(self._waiting)
            self._begin(line, at_ns)
        for slot in [slot for slot, active in self._active.items() if active.until_ns <= now_ns]:
            del self._active[slot]

    @property
    def next_foreign_ns(self) -> int:
        """Due time of the next foreign frame; far in the future if there is none."""
        return min((active.next_ns for active in self._active.values()), default=_NEVER_NS)

    def foreign_frames(self, now_ns: int, wall_ns: int) -> list[Frame]:
        """Return the foreign frames due now, and schedule the next ones."""
        frames = []
        for active in self._active.values():
            foreign = active.fault.value
            if active.next_ns <= now_ns and isinstance(foreign, Foreign):
                active.next_ns = max(active.next_ns + foreign.period_ns, now_ns + 1)
                frames.append(Frame(foreign.can_id, foreign.data, wall_ns))
        return frames

    def strike(self, disturbance: Disturbance, message: str) -> int:
        """Count a frame of the message, and return the value of the fault that disturbs it; 0 if none does."""
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
        return not self._active

    @property
    def remote(self) -> bool:
        """The remote control's SA switch is on remote."""
        return ("transmitter", "") in self._active

    @property
    def sticks(self) -> Sticks:
        return self._value(Sticks, "sticks") or Sticks(0.0, 0.0)

    @property
    def wrong_scale(self) -> bool:
        return ("scale", "") in self._active

    @property
    def firmware(self) -> Variant | None:
        """The variant that replaces the first one."""
        return self._value(Variant, "variant")

    @property
    def rebooting(self) -> bool:
        return ("reboot", "") in self._active

    def conditions(self, start: Conditions) -> Conditions:
        """Return the conditions in force, given those at the start."""
        changed = {
            str(field): one.fault.value for (kind, field), one in self._active.items() if kind == _CONDITION
        }
        return msgspec.structs.replace(start, **changed) if changed else start

    def _value(self, kind: type[_T], word: str, target: str = "") -> _T | None:
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

    def is_hit(self, side: str) -> bool:
        contact = self._value(Contact, "bumper", side)
        if contact is None:
            return False
        since_ns = self._now_ns - self._active["bumper", side].since_ns
        changes = [end_ns for end_ns in accumulate(BOUNCE_NS) if end_ns > since_ns] if contact.bounces else []
        # The last change leads to the new state, so an even number of remaining changes means the new state.
        return contact.hit is (len(changes) % 2 == 0)

"""The faults in force: begun, counted down, ended. Pure; time is an argument."""

from __future__ import annotations

import heapq
from itertools import accumulate
from typing import Final

import msgspec

from gateway.chassis.frame import ERROR, EXTENDED, IDENTIFIER_MASK, Frame
from gateway.sim.faults import (
    ALL_MESSAGES,
    Bumper,
    Clear,
    Condition,
    Disturbance,
    Fault,
    FaultLine,
    Firmware,
    Foreign,
    MessageFault,
    Reboot,
    Sticks,
    Toggle,
    is_end,
)
from gateway.sim.parameters import BOUNCE_NS, REBOOT_NS, Conditions
from schemas.messages import Variant

_NEVER_NS: Final = 2**63


class _Active(msgspec.Struct):
    """A fault in force.

    Attributes:
        frames_left: None if its frames do not count.
        passed: frames of its message so far, for a fault of every n-th.
        next_ns: for foreign frames, when the next is due.
    """

    fault: Fault
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
        for (_, can_id), active in self._active.items():
            if active.next_ns <= now_ns and isinstance(active.fault, Foreign) and isinstance(can_id, int):
                active.next_ns = max(active.next_ns + active.fault.period_ns, now_ns + 1)
                frames.append(Frame(can_id | active.fault.can_id & ERROR, active.fault.data, wall_ns))
        return frames

    def strike(self, disturbance: Disturbance, message: str) -> int:
        """Count a frame of the message, and return the number of the fault that disturbs it; 0 if none does."""
        slot = (disturbance.value, message)
        active = self._active.get(slot)
        if active is None or not isinstance(active.fault, MessageFault):
            return 0
        active.passed += 1
        if disturbance is Disturbance.DROP and active.passed % active.fault.number:
            return 0
        if active.frames_left is not None:
            active.frames_left -= 1
            if not active.frames_left:
                del self._active[slot]
        return active.fault.number

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
        return ("remote", "") in self._active

    @property
    def sticks(self) -> Sticks:
        """The demand of the remote control (RC)."""
        active = self._active.get(("sticks", ""))
        return active.fault if active is not None and isinstance(active.fault, Sticks) else Sticks(0.0, 0.0)

    @property
    def wrong_scale(self) -> bool:
        """Drive command and feedback have the other variant's scale."""
        return ("wrong_scale", "") in self._active

    @property
    def firmware(self) -> Variant | None:
        """The variant that took the place of the first one."""
        active = self._active.get(("firmware", ""))
        return active.fault.variant if active is not None and isinstance(active.fault, Firmware) else None

    @property
    def rebooting(self) -> bool:
        """The control unit reboots."""
        return ("reboot", "") in self._active

    def conditions(self, start: Conditions) -> Conditions:
        """The conditions in force, given those of the start."""
        faults = [active.fault for active in self._active.values()]
        changed = {fault.field: fault.value for fault in faults if isinstance(fault, Condition)}
        return msgspec.structs.replace(start, **changed) if changed else start

    def _begin(self, line: FaultLine, now_ns: int) -> None:
        if isinstance(line.fault, Clear):
            self._active.clear()
            return
        for slot in self._slots(line.fault):
            if is_end(line.fault):
                self._active.pop(slot, None)
                continue
            duration_ns = line.duration_ns or (REBOOT_NS if isinstance(line.fault, Reboot) else _NEVER_NS)
            active = _Active(line.fault, now_ns, now_ns + duration_ns, line.frames or None)
            if isinstance(line.fault, Foreign):
                active.next_ns = now_ns
            self._active[slot] = active

    def _slots(self, fault: Fault) -> list[_Slot]:
        match fault:
            case MessageFault(disturbance, message):
                names = self._messages if message == ALL_MESSAGES else (message,)
                return [(disturbance.value, name) for name in names]
            case Foreign(can_id):
                return [("foreign", can_id & (EXTENDED | IDENTIFIER_MASK))]
            case Bumper(sides):
                return [("bumper", side) for side in sides]
            case Toggle(name):
                return [(name, "")]
            case Sticks() | Firmware() | Reboot():
                return [(type(fault).__name__.lower(), "")]
            case Condition(field):
                return [("condition", field)]
            case Clear():
                return []

    def _is_hit(self, side: str) -> bool:
        active = self._active.get(("bumper", side))
        if active is None or not isinstance(active.fault, Bumper):
            return False
        since_ns = self._now_ns - active.since_ns
        changes = [end_ns for end_ns in accumulate(BOUNCE_NS) if end_ns > since_ns] if active.fault.bounces else []
        # After an even number of changes it rests, so one that is still to come out even is in the new state.
        return active.fault.hit is (len(changes) % 2 == 0)

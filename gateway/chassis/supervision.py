"""Supervision: of streams of frames, of the CAN controller, and of the firmware variant. Pure.

Linux reports the controller's state in error frames (linux/can/error.h), in the terms of ISO 11898-1.

The alive counter is judged as in AUTOSAR E2E profile 1, modulo 16: a step of 1 is right, 0 is a repetition, 2 to 3
means lost frames, more is a wrong sequence. Sixteen lost frames would look like none, so silence is declared
before that, and after a silence any counter is right. Frames lost in a silence are still counted: see
``schemas.can_word``.
"""

from __future__ import annotations

from collections import deque
from typing import Final, Protocol

from gateway.chassis.frame import FaultKind, Frame
from schemas import settings
from schemas.can_word import COUNTER_SPAN, UnseenRounds
from schemas.messages import ControllerState, Variant
from schemas.settings import VARIANT_EVIDENCE_FRAMES

_CONTROLLER: Final = 0x004
"""Details are in data byte 1."""

_BUS_OFF: Final = 0x040
_RESTARTED: Final = 0x100

_WARNING: Final = 0x0C
_PASSIVE: Final = 0x30
_ACTIVE: Final = 0x40
"""In data byte 1, for receiving or sending."""


def controller_state(frame: Frame) -> ControllerState | None:
    """Return the state that an error frame reports; None if it reports none."""
    kinds = frame.identifier
    if kinds & _BUS_OFF:
        return ControllerState.BUS_OFF
    detail = frame.data[1] if kinds & _CONTROLLER and len(frame.data) > 1 else 0
    if detail & _PASSIVE:
        return ControllerState.PASSIVE
    if detail & _WARNING:
        return ControllerState.WARNING
    if detail & _ACTIVE or kinds & _RESTARTED:
        return ControllerState.ACTIVE
    return None


NEVER_NS: Final = 2**63
NO_FAULTS: Final[tuple[FaultKind, ...]] = ()


class AliveCounter:
    """The alive counter of one frame.

    Attributes:
        faults: +1 for each fault, -1 for each good frame, from 0 to the limit.
        lost: frames skipped by the counter since the start.
        repeats: consecutive frames with the same counter.
    """

    __slots__ = ("_expected", "_forgotten", "faults", "lost", "repeats")

    def __init__(self) -> None:
        self._expected: int | None = None
        self._forgotten: int | None = None
        self.faults = 0
        self.lost = 0
        self.repeats = 0

    @property
    def has_failed(self) -> bool:
        """The fault count has reached its limit."""
        return self.faults >= settings.ALIVE_FAULTS

    def forget(self) -> None:
        """Accept any next counter. Frames that it skips still count as lost."""
        if self._expected is not None:
            self._forgotten, self._expected = self._expected, None
        self.repeats = 0

    def receive(self, counter: int) -> FaultKind | None:
        """Judge the counter of the next valid frame."""
        expected = self._expected
        self._expected = (counter + 1) % COUNTER_SPAN
        if expected == counter or expected is None:
            if expected is None and self._forgotten is not None:
                self.lost += (counter - self._forgotten) % COUNTER_SPAN
            self.repeats = 0
            if self.faults:
                self.faults -= 1
            return None
        return self._judge((counter - expected) % COUNTER_SPAN)

    def _judge(self, beyond: int) -> FaultKind:
        """The fault of a counter this far beyond the expected one; a repeated one is 15 beyond."""
        if self.faults < settings.ALIVE_FAULTS:
            self.faults += 1
        if beyond == COUNTER_SPAN - 1:
            self.repeats += 1
            stuck = self.repeats >= settings.ALIVE_STUCK_REPEATS
            return FaultKind.ALIVE_STUCK if stuck else FaultKind.ALIVE_REPEATED
        self.repeats = 0
        self.lost += beyond
        return FaultKind.ALIVE_LOST if beyond < settings.ALIVE_MAX_LOST_STEP else FaultKind.ALIVE_SEQUENCE


class Period:
    """The mean period of one frame, judged over a window of frames."""

    __slots__ = ("_first_ns", "_frames", "_longest_ns", "_shortest_ns", "has_failed")

    def __init__(self, nominal_ns: int) -> None:
        window_ns = nominal_ns * settings.PERIOD_WINDOW_FRAMES
        self._longest_ns = window_ns * settings.PERIOD_TOLERANCE
        self._shortest_ns = window_ns / settings.PERIOD_TOLERANCE
        self._frames = -1
        self._first_ns = 0
        self.has_failed = False

    def forget(self) -> None:
        """Begin a new window with the next frame, and clear the failure."""
        self._frames = -1
        self.has_failed = False

    def receive(self, now_ns: int) -> FaultKind | None:
        """Judge the window that ends with this frame, if one does."""
        self._frames += 1
        if self._frames == 0:
            self._first_ns = now_ns
            return None
        if self._frames < settings.PERIOD_WINDOW_FRAMES:
            return None
        elapsed_ns = now_ns - self._first_ns
        self._first_ns = now_ns
        self._frames = 0
        self.has_failed = not self._shortest_ns <= elapsed_ns <= self._longest_ns
        return FaultKind.PERIOD if self.has_failed else None


class FaultWindow:
    """Faults of one kind and one identifier, remembered for a while.

    Attributes:
        faults: since the start.
    """

    __slots__ = ("_times_ns", "_window_ns", "faults")

    def __init__(self, limit: int, window_ns: int) -> None:
        self.faults = 0
        self._window_ns = window_ns
        self._times_ns: deque[int] = deque(maxlen=limit)

    def fault(self, now_ns: int) -> None:
        self.faults += 1
        self._times_ns.append(now_ns)

    def has_failed(self, now_ns: int) -> bool:
        """The limit of faults was reached within the window that ends now."""
        times = self._times_ns
        return len(times) == times.maxlen and now_ns - times[0] <= self._window_ns


def silence_ns(period_ns: int) -> int:
    """Return the time without a frame after which it counts as silent."""
    return max(settings.SILENCE_PERIODS * period_ns, settings.SILENCE_MIN_NS)


class FrameSupervisor:
    """All supervision of one feedback frame.

    Attributes:
        is_silent: the frame is missing or overdue; true until the first one comes.
        overdue_ns: when it becomes overdue unless a valid frame comes first.
        valid: frames since the start with a right checksum and plausible values.
    """

    __slots__ = (
        "_counter",
        "_rounds",
        "_silence_ns",
        "_valid_ns",
        "alive",
        "checksums",
        "implausible",
        "is_silent",
        "overdue_ns",
        "period",
        "valid",
    )

    def __init__(self, period_ns: int) -> None:
        self._rounds = UnseenRounds(period_ns)
        self._counter = 0
        self._valid_ns = 0
        self._silence_ns = silence_ns(period_ns)
        self.alive = AliveCounter()
        self.period = Period(period_ns)
        self.checksums = FaultWindow(settings.CHECKSUM_FAULTS, settings.CHECKSUM_WINDOW_NS)
        self.implausible = FaultWindow(settings.IMPLAUSIBLE_FAULTS, settings.IMPLAUSIBLE_WINDOW_NS)
        self.is_silent = True
        self.overdue_ns = NEVER_NS
        self.valid = 0

    @property
    def lost(self) -> int:
        """Frames lost since the start, by the alive counter; its unseen rounds are added later."""
        return self.alive.lost + self._rounds.lost

    def failures(self, now_ns: int) -> list[str]:
        """Return the names of the checks that fail now."""
        failed = {
            "checksum": self.checksums.has_failed(now_ns),
            "implausible": self.implausible.has_failed(now_ns),
            "alive_counter": self.alive.has_failed,
            "period": self.period.has_failed,
            "silence": self.is_silent,
        }
        return [name for name, has_failed in failed.items() if has_failed]

    def receive(self, alive_counter: int, now_ns: int) -> tuple[FaultKind, ...]:
        """Take a valid frame. Returns the faults of its alive counter and its period."""
        elapsed_ns = now_ns - self._valid_ns
        if elapsed_ns >= self._rounds.window_ns or self._rounds.is_waiting:
            self._follow(alive_counter, elapsed_ns, now_ns)
        self._counter, self._valid_ns = alive_counter, now_ns
        self.valid += 1
        alive_fault = self.alive.receive(alive_counter)
        if not self.alive.repeats:
            # A frame that repeats its counter carries no news: it becomes overdue like a missing one.
            self.is_silent = False
            self.overdue_ns = now_ns + self._silence_ns
        period_fault = self.period.receive(now_ns)
        if alive_fault is None and period_fault is None:
            return NO_FAULTS
        return tuple(fault for fault in (alive_fault, period_fault) if fault is not None)

    def tick(self, now_ns: int) -> FaultKind | None:
        """Returns SILENCE once, when the frame has become overdue."""
        if now_ns <= self.overdue_ns:
            return None
        self.is_silent = True
        self.overdue_ns = NEVER_NS
        if not self.alive.repeats:
            self.alive.forget()
        self.period.forget()
        return FaultKind.SILENCE

    def _follow(self, alive_counter: int, elapsed_ns: int, now_ns: int) -> None:
        if self.valid:
            steps = (alive_counter - self._counter) % COUNTER_SPAN
            if elapsed_ns >= self._rounds.window_ns:
                steps = steps or COUNTER_SPAN
            self._rounds.follow(now_ns, elapsed_ns, steps)


class VariantEvidence(Protocol):
    """Reads the firmware variant in a frame of the chassis."""

    def of(self, data: bytes) -> Variant:
        """The variant that these data indicate; UNKNOWN if none."""

    def turns(self, data: bytes) -> bool | None:
        """Return True if these data show motion in every variant; None if they are not valid."""


class VariantDetector:
    """Collects evidence until it suffices, then watches for evidence to the contrary.

    Attributes:
        variant: the configured or confirmed one, or UNKNOWN.
        confirmed: the evidence agrees with ``variant``.
        contradicted: the evidence contradicts it; no speed can be trusted.
    """

    def __init__(self, configured: Variant, evidence: VariantEvidence) -> None:
        self._configured = configured
        self.evidence = evidence
        self.reset()

    @property
    def in_force(self) -> Variant:
        """UNKNOWN without evidence, or with evidence against it."""
        return Variant.UNKNOWN if self.contradicted else self.variant

    def reset(self) -> None:
        """Forget the evidence, because another chassis may be on the bus now."""
        self.variant = self._configured
        self.confirmed = False
        self.contradicted = False
        self._candidate = Variant.UNKNOWN
        self._streak = 0

    def receive(self, data: bytes) -> FaultKind | None:
        """Take a valid frame as evidence. Returns a fault if it indicates another variant."""
        evidence = self.evidence.of(data)
        self._streak = self._streak + 1 if evidence == self._candidate else 1
        self._candidate = evidence
        if evidence is Variant.UNKNOWN:
            return None
        contrary = self.variant not in {Variant.UNKNOWN, evidence}
        if self._streak >= VARIANT_EVIDENCE_FRAMES:
            if self._configured is Variant.UNKNOWN:
                # Without a configured variant the evidence decides, also after a change of the chassis.
                self.variant = evidence
            self.confirmed = evidence == self.variant
            self.contradicted = not self.confirmed
        return FaultKind.VARIANT_CONTRADICTED if contrary else None

"""The safety arbiter: requests and observations in, what the chassis is told out. No I/O, time as an argument.

Read ``tick`` first: what is seen, what is asked, what speaks against it, what the chassis is told.
"""

from __future__ import annotations

from copy import copy
from math import inf
from random import Random
from typing import Final

import msgspec

from gateway.command import verbs
from gateway.command.actuation import AT_REST, Actuation
from gateway.command.auxiliary import Auxiliary
from gateway.command.causes import AS_ASKED, STOPS, Stop, Watch
from gateway.command.freshness import ChallengeLog
from gateway.command.handover import Handover, may_be_stopped
from gateway.command.lease import LeaseDesk
from gateway.command.limits import Limits
from gateway.command.link_age import LinkAge
from gateway.command.motion import Motion, Surroundings, Target
from gateway.command.notices import Notices
from gateway.command.observed import Observed
from gateway.command.outcome import Event, Outcome
from gateway.command.request import Answer, Judged, RawRequest, Ruling
from gateway.command.seen import IN_GEAR, seen_actuation, seen_angle_deg
from gateway.command.states import TRANSITIONS, Trigger
from gateway.command.stop import StopFeedback, StopSequence
from schemas.decisions import COMMANDING, ArbiterState, Bound, EventKind, Severity, StopPhase
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import ENGAGE_TIMEOUT_NS, REPEATED_NS, TICK_NS, TOLD_LONG_AGO_NS, Settings

_NS_PER_S: Final = 1_000_000_000
_TICK_BITS: Final = 40
_TICK_S: Final = TICK_NS / _NS_PER_S
LATE_STEP_S: Final = 10 * _TICK_S
"""After a pause the speed goes on falling by no greater step than this makes."""

_SPEED_BIT_MPS: Final = {Variant.COARSE: 0.04, Variant.FINE: 0.001}
"""The smallest speed that the drive command can carry (manual V2.0, 5 (3))."""


class Arbiter:
    """Everything that decides whether and how the robot moves.

    Attributes:
        state: where it is in the table of states.
        desk: the lease.
        watch: the chassis as it is seen.
        challenges: when each challenge was published.
        link: the age of the holder's commands, the deadman, and the speed that they allow.
        tick_number: rises with each tick, from a number that differs with each run.
        limits: those in force.
        motion: what the chassis is being told while engaged.
        target: what the last acceptable drive command asks for.
        parked: the parking brake stays applied, whatever speed is asked for, until ``unpark``.
        latched: what must be reset, with its detail.
        latched_ns: when the newest of it was latched.
        stop_reason, stop_detail: why the last stop was begun, and its figures.
        variant: the one in which the chassis is told speeds; UNKNOWN as soon as there was any doubt, until it is
            engaged again.
        actuation: what the chassis was last told; None while it is told nothing.
        tellings: how often it has begun to tell the chassis something.
        told_ns: when a whole burst was last taken by the bus.
        owes_stop: a stop could not be carried out, or ended without an applied parking brake.
        handover: who else commands the chassis, and what it was left on.
    """

    def __init__(self, settings: Settings, run: int) -> None:
        """Standing by.

        Args:
            settings: limits and times.
            run: a random number of this run: it tells its leases and ticks from those of another. It is public.
        """
        self.settings = settings.command
        self.accepts_unguarded = settings.gateway.accept_unguarded
        random = Random(run)  # noqa: S311 - tells runs apart; it keeps no secret
        self.tick_number = random.getrandbits(_TICK_BITS)
        self.desk = LeaseDesk(round(self.settings.lease_s * _NS_PER_S), random)
        self.watch = Watch()
        self.challenges = ChallengeLog()
        self.link = LinkAge(self.settings)
        self.auxiliary = Auxiliary()
        self.state = ArbiterState.STANDBY
        self.configured_limits = self.limits = Limits.of(self.settings)
        self.motion = Motion()
        self.target = Target()
        self.parked = True
        self.latched: dict[Reason, str] = {}
        self.stop_reason = Reason.NONE
        self.stop_detail = ""
        self.variant = Variant.UNKNOWN
        self.actuation: Actuation | None = None
        self.last_sequence = -1
        self.last_drive: tuple[float, int] | None = None
        self.fresh_ns = 0
        self.is_closing = False
        self.latched_ns = 0
        self._sequence: StopSequence | None = None
        self._is_brake_missed = self.owes_stop = False
        self._engage_until_ns = 0
        self.told_ns = 0
        self.handover = Handover()
        self.tellings = 0
        self._stray_ns: int | None = None
        self._late_ns = 0
        self._before: tuple[Motion, StopSequence | None, Actuation | None] = (self.motion, None, None)
        self._waiting: dict[str, int] = {}
        self._guard_stops: int | None = None
        self._notices = Notices()
        self._answers: list[Answer] = []
        self._events: list[Event] = []

    @property
    def stop_phase(self) -> StopPhase:
        """How far the stop has come."""
        return StopPhase.IDLE if self._sequence is None else self._sequence.phase

    def tick(self, observed: Observed, requests: list[RawRequest], now_ns: int, late_ns: int) -> Outcome:
        """Ten milliseconds have passed.

        Args:
            observed: the chassis now.
            requests: what came in since the last tick, stops first.
            now_ns: monotonic.
            late_ns: how much after its time this tick begins.
        """
        self.tick_number += 1
        self._late_ns = late_ns
        self.watch.observe(observed, now_ns)
        self.handover.is_cut_off &= not observed.bus_up
        if observed.variant is not self.variant:
            self.variant = Variant.UNKNOWN
        self._expire(now_ns)
        judged = [Judged(request, self._rule(request, now_ns)) for request in requests]
        self._give_way(now_ns)
        self._look_for_causes(now_ns, late_ns)
        # Each step is taken on a copy: a burst that the bus does not take was no step.
        self._before = (self.motion, self._sequence, self.actuation)
        self.motion, self._sequence = copy(self.motion), copy(self._sequence)
        self.actuation = self._act(now_ns)
        self._look_at_odometer(now_ns)
        # Lamps, horn and odometer go with the five; standing by the gateway is silent.
        auxiliary = [] if self.actuation is None else self.auxiliary.frames(now_ns)
        answers, self._answers = self._answers, []
        events, self._events = self._events, []
        return Outcome(self.actuation, auxiliary, judged, answers, events)

    # What is asked.

    def _rule(self, request: RawRequest, now_ns: int) -> Ruling:
        ruling = verbs.rule(self, request, now_ns)
        if ruling.is_pending:
            self._waiting[request.verb] = request.handle
        elif request.is_query:
            self._answers.append(Answer(request.handle, request.verb, ruling))
        return ruling

    def begin_engaging(self, limits: Limits, now_ns: int) -> None:
        """All that engage wants is there: give the five enables with zero speed."""
        self._go(Trigger.ENGAGE)
        self.owes_stop = False
        self.limits = limits
        angle_deg = seen_angle_deg(self.watch.observed, self.configured_limits)
        gear = self.watch.observed.gear
        self.motion = Motion(angle_deg, gear if gear in IN_GEAR else GearPosition.NEUTRAL)
        self.target = Target()
        self.parked = True
        self._begin_telling(Actuation(angle_deg=angle_deg))
        self.auxiliary.end(now_ns)
        self.watch.send_failures = 0
        self._engage_until_ns = now_ns + ENGAGE_TIMEOUT_NS

    def begin_stop(self, reason: Reason, now_ns: int, detail: str = "", operator: str = "") -> None:
        """A cause to stop: bring the robot to rest if it is told anything, and latch what the table latches."""
        stop = STOPS[reason]
        self.latch(reason, detail, now_ns, operator)
        deceleration_mps2 = self._deceleration_mps2(stop)
        if self._sequence is not None:
            self._sequence.hasten(deceleration_mps2)
            if stop.parks:
                self._sequence.park(now_ns)
            return
        last = self._last_told()
        if self.state is ArbiterState.STANDBY:
            observed = self.watch.observed
            is_barred = not observed.bus_up or observed.mode is Mode.REMOTE
            self.owes_stop = is_barred and reason is Reason.REMOTE_STOP
            if not may_be_stopped(observed):
                return  # Standing by stays silent.
            self.limits = self.configured_limits
            self._begin_telling(last)
        self._sequence = StopSequence(last, deceleration_mps2, now_ns)
        if stop.parks or self.watch.observed.mode is Mode.STOP or self._note_stray(now_ns):
            self._sequence.park(now_ns)
        self._is_brake_missed = self.owes_stop = False
        self.auxiliary.end(now_ns)
        self.stop_reason, self.stop_detail = reason, detail
        self._go(Trigger.STOP)
        self._fail_waiting(reason, detail)
        is_calm = self.watch.stands or reason in AS_ASKED
        severity = Severity.INFO if is_calm and not stop.at_once else Severity.WARNING
        self.tell(severity, EventKind.STOP, reason, f"stopping: {_in_words(reason, detail)}", operator)

    def latch(self, reason: Reason, detail: str, now_ns: int, operator: str = "") -> None:
        """Keep the robot from being engaged until a reset, if the table says so."""
        if not STOPS[reason].latched:
            return
        if reason is Reason.REMOTE_STOP or reason in self.watch.struck:
            # Each one counts: a reset that was on its way is not meant for the newest.
            self.latched_ns = now_ns
        if reason not in self.latched:
            self.latched[reason] = detail
            self.latched_ns = now_ns
            text = f"latched until a reset: {_in_words(reason, detail)}"
            self.tell(Severity.ERROR, EventKind.LATCH, reason, text, operator)

    def _deceleration_mps2(self, stop: Stop) -> float:
        if not stop.ramps:
            return inf
        limits = self.configured_limits
        at_once = stop.at_once or self.latched
        return limits.emergency_deceleration_mps2 if at_once else limits.deceleration_mps2

    def shut_down(self, now_ns: int) -> None:
        """The gateway is to end: bring the robot to rest first, and engage it no more."""
        self.is_closing = True
        self.tell(Severity.INFO, EventKind.GATEWAY, Reason.SHUTDOWN, "the gateway ends, as it was told to")
        if self.state in COMMANDING:
            self.begin_stop(Reason.SHUTDOWN, now_ns)

    def unsent(self, *, is_speed_told: bool = False) -> None:
        """The bus did not take the tick's motion frames, or not all of them, and the step is undone.

        Otherwise what the chassis is told next would be several steps from what it was told last; or a stop that
        no one heard would go on to neutral. A ramp whose speed was told goes on all the same.
        """
        told = self.actuation
        self.motion, self._sequence, self.actuation = self._before
        if is_speed_told and told is not None and self._sequence is not None:
            self._sequence.not_above(told.speed_mps)

    def refuse_output(self, detail: str, now_ns: int) -> Actuation:
        """The gate refused what was to be sent: a fault of our own, and the robot is stopped.

        Returns what is told in its place: zero speed and the parking brake, and all else as it was told last.
        """
        self.unsent()
        last = self._last_told()
        self.begin_stop(Reason.GATE, now_ns, detail)
        # Where the bus does not take this either, the stop that has begun is still to be told.
        self._before = (self.motion, self._sequence, self._before[2])
        self.actuation = msgspec.structs.replace(last, enabled=True, speed_mps=0.0, parking=True)
        return self.actuation

    def tell(self, severity: Severity, kind: EventKind, reason: Reason, text: str, operator: str = "") -> None:
        """Tell people."""
        self._events.append(Event(severity, kind, reason, text, operator))

    # What speaks against it.

    def _expire(self, now_ns: int) -> None:
        lost = self.desk.expire(now_ns)
        if lost is None:
            return
        text = f"the lease of {lost.operator} expired"
        self.tell(Severity.WARNING, EventKind.LEASE, Reason.LEASE_EXPIRED, text, lost.operator)
        if self.state in COMMANDING:
            self.begin_stop(Reason.LEASE_EXPIRED, now_ns, operator=lost.operator)

    def _give_way(self, now_ns: int) -> None:
        """Who else commands the chassis, or where no command can reach it, the output ceases at once."""
        observed = self.watch.observed
        before, self._guard_stops = self._guard_stops, observed.guard_stops
        if self.state is ArbiterState.STANDBY:
            has_acted = before is not None and observed.guard_stops > before
            if observed.guard_sends or has_acted:
                self.latch(Reason.GUARD, observed.guard_says, now_ns)
            return
        reason = self.handover.reason_to_yield(observed)
        if reason is Reason.MODE_NOT_AUTO and (observed.moves or self.state is ArbiterState.STOPPING):
            # Nobody commands it, and it may coast: the parking brake is told all the same.
            self.begin_stop(reason, now_ns)
            return
        if reason is Reason.NONE:
            return
        detail = observed.guard_says if reason is Reason.GUARD else ""
        if reason is Reason.GUARD:
            self.latch(reason, detail, now_ns)
        self._go(Trigger.YIELD)
        told = self.actuation if self.actuation is not None else Actuation(parking=self.parked)
        self.handover.leave(told, reason, observed, now_ns)
        # From here on what is seen counts, not what we told.
        self.actuation = None
        self.stop_reason, self.stop_detail = reason, ""
        self._sequence = None
        self._fail_waiting(reason, "")
        kind = EventKind.GUARD if reason is Reason.GUARD else EventKind.TAKEOVER
        self.tell(Severity.WARNING, kind, reason, f"nothing is sent any more: {_in_words(reason, detail)}")

    def _look_for_causes(self, now_ns: int, late_ns: int) -> None:
        for notice in self._notices.look(self.watch.observed, now_ns, late_ns):
            self.tell(notice.severity, notice.kind, notice.reason, notice.text)
        for bumper in self.watch.hits:
            self.latch(bumper, "", now_ns)
        if self.state is ArbiterState.STANDBY:
            self._look_for_strays(now_ns)
            return
        for bumper in self.watch.hits:
            self.begin_stop(bumper, now_ns)
        self._look_for_faults(now_ns, late_ns)
        if self.state in COMMANDING:
            self._look_for_lapses(now_ns)

    def _look_for_faults(self, now_ns: int, late_ns: int) -> None:
        # During a stop too: a graver cause hastens it, and may latch.
        told = self.actuation if self.actuation is not None else AT_REST
        for reason in self.watch.faults(told, self.limits.speed_mps, late_ns, now_ns):
            self.begin_stop(reason, now_ns, self.watch.fault_detail(reason, late_ns))
        if self.variant is Variant.UNKNOWN:
            self.begin_stop(Reason.VARIANT_UNKNOWN, now_ns)

    def _look_for_lapses(self, now_ns: int) -> None:
        """What somebody ought to have done in time, and has not."""
        observed = self.watch.observed
        if not observed.guarded and not self.accepts_unguarded:
            self.begin_stop(Reason.UNGUARDED, now_ns)
        if not (observed.guarded and observed.realtime):
            # It stays lower until the robot is engaged again: limits are never raised while it is driven.
            self.limits = self.limits.lowered(self.settings.speed_limit_without_realtime_mps)
        if self.state is ArbiterState.ENGAGING and now_ns >= self._engage_until_ns:
            self.begin_stop(Reason.NOT_CONFIRMED, now_ns, "the mode does not read auto")
        silent_ns = now_ns - self.fresh_ns
        if self.state is ArbiterState.ENGAGED and silent_ns > self.link.deadman_ns:
            self.begin_stop(Reason.DEADMAN, now_ns, self.link.silence(silent_ns))

    def _look_for_strays(self, now_ns: int) -> None:
        """Standing by: does the chassis obey a command that nobody gives any more?"""
        is_taken = self.watch.is_commanded_by_other(now_ns)
        if self.handover.is_obeyed_again(self.watch.observed, now_ns, is_taken=is_taken):
            # It was left while it was being told something, and may obey that again: nothing resumes by itself.
            self.begin_stop(Reason.FOUND_MOVING, now_ns, "or about to move, by what it was told before")
        elif self.owes_stop and not is_taken and self._is_loose():
            self.begin_stop(Reason.FOUND_MOVING, now_ns, "a stop could not be carried out before")
        elif self.watch.found_moving(now_ns):
            self.begin_stop(Reason.FOUND_MOVING, now_ns)

    def _note_stray(self, now_ns: int) -> bool:
        """Remember a stop that begins while standing by.

        Returns whether one began a moment ago already, as where the mode flickers.
        """
        if self.state is not ArbiterState.STANDBY:
            return False
        before_ns, self._stray_ns = self._stray_ns, now_ns
        return before_ns is not None and now_ns - before_ns < REPEATED_NS

    def _is_loose(self) -> bool:
        """The parking brake is seen to be released, and can be told otherwise."""
        observed = self.watch.observed
        return observed.brake is ParkingStatus.RELEASED and may_be_stopped(observed)

    # What the chassis is told.

    def _act(self, now_ns: int) -> Actuation | None:
        told = self.actuation is not None  # That it reads auto confirms nothing before the enables were sent.
        if self.state is ArbiterState.ENGAGING and told and self.watch.observed.mode is Mode.AUTO:
            self._confirm(now_ns)
        if self.state is ArbiterState.STANDBY:
            return None
        if self._sequence is not None:
            if max(now_ns - self.told_ns, self._late_ns) > TOLD_LONG_AGO_NS:
                # Held up by a pause or by the bus: the robot may have been brought to rest meanwhile.
                self._sequence.not_above(self.watch.observed.seen_mps)
            actuation = self._sequence.tick(now_ns, self._stop_feedback())
            if self._sequence.lacks_brake(now_ns) and not self._is_brake_missed:
                self._is_brake_missed = True
                text = "the parking brake does not read applied; the motor holds the robot in gear meanwhile"
                self.tell(Severity.ERROR, EventKind.FAULT, Reason.NOT_CONFIRMED, text)
            if actuation is None:
                self._rest(now_ns)
            return actuation
        pressed, observed = self.watch.pressed, self.watch.observed
        surroundings = Surroundings(
            stands=self.watch.stands,
            gear=observed.gear,
            brake=observed.brake,
            parked=self.parked,
            speed_mps=observed.fastest_mps or 0.0,
            angle_deg=observed.angle_deg or 0.0,
            forward=Reason.FRONT_BUMPER not in pressed,
            backward=Reason.REAR_BUMPER not in pressed,
        )
        target = self.target if self.state is ArbiterState.ENGAGED else Target(0.0, self.motion.angle_deg)
        bounded = self.link.bounded(target, self.limits.speed_mps, now_ns)
        if abs(bounded.speed_mps) < _SPEED_BIT_MPS.get(self.variant, 0.0):
            # On the wire that is zero: the robot is told to stand, and is held.
            bounded = Target(0.0, bounded.angle_deg)
        elapsed_s = min(max((now_ns - self.told_ns) / _NS_PER_S, _TICK_S), LATE_STEP_S)
        actuation = self.motion.tick(bounded, self.limits, surroundings, _TICK_S, elapsed_s)
        if abs(bounded.speed_mps) < abs(target.speed_mps) and bounded.speed_mps:
            self.motion.bounds.append(Bound.TRAVEL_DELAY)
        return actuation

    def _stop_feedback(self) -> StopFeedback:
        observed = self.watch.observed
        is_braked = observed.brake is ParkingStatus.APPLIED
        # In mode stop the chassis need not heed the request, and a brake that is not seen proves nothing.
        is_open = observed.brake is ParkingStatus.UNDEFINED or observed.mode is not Mode.AUTO
        return StopFeedback(
            stands=self.watch.stands,
            moves=observed.moves,
            speed_mps=observed.fastest_mps,
            wheel_speed_mps=observed.wheel_speed_mps,
            is_braked=None if is_open and not is_braked else is_braked,
        )

    def _confirm(self, now_ns: int) -> None:
        self._go(Trigger.CONFIRMED)
        self.fresh_ns = now_ns
        self.target = Target(0.0, self.motion.angle_deg)
        self._answer_waiting("engage", Ruling())
        holder = self.desk.lease.operator if self.desk.lease is not None else ""
        self.tell(Severity.INFO, EventKind.ENGAGED, Reason.NONE, "engaged: the chassis reads auto", holder)

    def _rest(self, now_ns: int) -> None:
        self._sequence = None
        self.owes_stop = self.watch.observed.brake is not ParkingStatus.APPLIED
        self._go(Trigger.REST)
        stands = "and stands" if self.watch.stands else "but is not seen to stand"
        if self.watch.is_commanded_by_other(now_ns):
            stands = "but another computer commands it, and can move it"
        severity = Severity.INFO if self.watch.stands else Severity.ERROR
        self.tell(severity, EventKind.STOPPED, self.stop_reason, f"stopped: the robot is told nothing, {stands}")

    def _look_at_odometer(self, now_ns: int) -> None:
        cleared = self.auxiliary.clearing_result(self.watch.observed.total_mileage_km, now_ns)
        if cleared is not None:
            ruling = Ruling() if cleared else Ruling(Reason.NOT_CONFIRMED, "the mileage does not read zero")
            self._answer_waiting("clear_odometer", ruling)

    def _begin_telling(self, last: Actuation) -> None:
        """From here on the chassis is told something; this is what it must have been told before."""
        observed = self.watch.observed
        self.variant = observed.variant
        self.watch.plausibility.forget(observed.wheel_speed_mps or 0.0, last.angle_deg)
        self.handover.begin(observed)
        self.tellings += 1

    def _last_told(self) -> Actuation:
        """Where a stop begins: what the chassis was last told, or must have been told."""
        if self.actuation is not None:
            return self.actuation
        return seen_actuation(self.watch.observed, self.configured_limits, self.handover.left)

    def _go(self, trigger: Trigger) -> None:
        self.state = TRANSITIONS[self.state, trigger]

    def _answer_waiting(self, verb: str, ruling: Ruling) -> None:
        handle = self._waiting.pop(verb, None)
        if handle is not None:
            self._answers.append(Answer(handle, verb, ruling))

    def _fail_waiting(self, reason: Reason, detail: str) -> None:
        for verb in list(self._waiting):
            self._answer_waiting(verb, Ruling(reason, detail))


def _in_words(reason: Reason, detail: str) -> str:
    return "; ".join(filter(None, (TEXTS[reason].means, detail)))

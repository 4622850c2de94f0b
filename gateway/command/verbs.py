"""Rulings on requests: one method a verb, in one table. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import msgspec

from gateway.chassis.port import Chassis
from gateway.command.engagement import Engagement
from gateway.command.lease import HeldLease, Leases, OperatorLink
from gateway.command.motion import Target, steering_angle_deg
from gateway.command.rulings import Credentials, RawRequest, Ruling
from schemas import codec, requests
from schemas.codec import PayloadFault
from schemas.decisions import COMMANDING, ArbiterState, EventKind, Severity
from schemas.messages import ControllerState, Mode
from schemas.reasons import Reason
from schemas.settings import REQUEST_MAX_BYTES, RESET_MIN_NS, SEQUENCE_STEP_MAX, Settings
from schemas.subjects import BY_VERB, STOP_VERB, Asking

_BY_STATE: Final = {
    ArbiterState.ENGAGING: Reason.ENGAGING,
    ArbiterState.ENGAGED: Reason.ALREADY_ENGAGED,
    ArbiterState.STOPPING: Reason.STOPPING,
}

_UNPROVEN: Final = " (unproven)"
"""Suffix to the sender of a stop that is not proven."""


class Verbs:
    """Rules on each request, and changes the states that its verb concerns."""

    def __init__(
        self,
        chassis: Chassis,
        settings: Settings,
        leases: Leases,
        link: OperatorLink,
        engagement: Engagement,
    ) -> None:
        self._design = chassis
        self._max_age_s = settings.command.max_age_s
        self._is_signed = settings.authority.mode == "signed"
        self._leases = leases
        self._link = link
        self._engagement = engagement
        self._monitor = engagement.monitor
        self._setpoint = engagement.setpoint
        self._latches = engagement.latches
        self._auxiliary = engagement.auxiliary
        self._outbox = engagement.outbox
        self._rules: dict[type[requests.Request], Callable[[Any, str, int], Ruling]] = {
            requests.Acquire: self._acquire,
            requests.Take: self._take,
            requests.Renew: self._renew,
            requests.Release: self._release,
            requests.Engage: self._engage,
            requests.Disengage: self._disengage,
            requests.Reset: self._reset,
            requests.Park: self._set_parked,
            requests.Unpark: self._set_parked,
            requests.Light: self._light,
            requests.Horn: self._horn,
            requests.ClearOdometer: self._clear_odometer,
            requests.ResetOdometry: self._reset_odometry,
            requests.Drive: self._drive,
        }

    def rule(self, raw: RawRequest, now_ns: int) -> Ruling:
        """Rule on a request. Never raises."""
        if raw.verb == STOP_VERB:
            # Served before the payload is read, and from any sender.
            return self._stop(raw, now_ns)
        request = self._read(raw)
        if isinstance(request, Ruling):
            return request
        if isinstance(request, requests.Leased):
            refusal = self._leases.refusal(request.lease, raw.operator)
            if refusal is not None:
                return Ruling(refusal, lease=request.lease)
            if BY_VERB[raw.verb].engaged_only and self._engagement.state is not ArbiterState.ENGAGED:
                return Ruling(Reason.NOT_ENGAGED, lease=request.lease)
        return self._rules[type(request)](request, raw.operator, now_ns)

    def _read(self, raw: RawRequest) -> requests.Request | Ruling:
        """Return the typed request within its sender's grant, or the refusal."""
        command = BY_VERB.get(raw.verb)
        if command is None or raw.is_query is not (command.asking is Asking.QUERY):
            return Ruling(Reason.UNKNOWN_VERB, f"{raw.verb[:32]!a} as a {'query' if raw.is_query else 'put'}")
        if raw.size > REQUEST_MAX_BYTES:
            return Ruling(Reason.TOO_LARGE, f"{raw.size} bytes, at most {REQUEST_MAX_BYTES}")
        request = PayloadFault(raw.fault) if raw.fault else codec.decode_request(command, raw.payload)
        if isinstance(request, PayloadFault):
            return Ruling(Reason.MALFORMED, request.detail[:200])
        if not raw.operator:
            return Ruling(Reason.MALFORMED, "the operator's name in the key is not valid")
        return _as_granted(request, raw.credentials or _NOTHING_PROVEN) if self._is_signed else request

    def _stop(self, raw: RawRequest, now_ns: int) -> Ruling:
        """Latch a stop in any case. If it cannot be carried out, the reply says so and what the robot does."""
        is_proven = raw.credentials is not None and raw.credentials.reason is Reason.NONE
        name = raw.operator or "an unnamed operator"
        who = f"by {name}"
        # A proven sender that repeats its stop without a proof is not named twice.
        is_unproven = self._is_signed and not is_proven and name not in self._latches.stopped_by
        self._engagement.begin_stop(
            Reason.REMOTE_STOP, now_ns, who + _UNPROVEN if is_unproven else who, raw.operator
        )
        if self._is_signed and is_proven:
            self._engagement.prove(Reason.REMOTE_STOP, who + _UNPROVEN, who, raw.operator)
        chassis = self._monitor.chassis
        does = self._monitor.rest(now_ns)
        if chassis.guard_sends and chassis.mode is not Mode.REMOTE:
            return Ruling(detail=f"the guard is stopping it; {does}")
        obstacles = {
            Reason.BUS_DOWN: not chassis.bus_up,
            Reason.BUS_OFF: chassis.controller is ControllerState.BUS_OFF,
            Reason.SEND_FAILED: self._monitor.send_failures > 0,
            Reason.HAND_TRANSMITTER: chassis.mode is Mode.REMOTE,
            Reason.OTHER_COMMANDER: self._monitor.is_commanded_by_other(now_ns),
            Reason.FEEDBACK_MISSING: chassis.fastest_mps is None,
            Reason.NOT_CONFIRMED: chassis.is_slow and not self._monitor.is_rest_answered,
        }
        obstacle = next((reason for reason, holds in obstacles.items() if holds), Reason.NONE)
        if obstacle is Reason.NONE:
            return Ruling(detail=does)
        is_told = (
            self._engagement.state is ArbiterState.STOPPING and chassis.bus_up and chassis.mode is not Mode.REMOTE
        )
        done = "commanded, but not confirmed" if is_told else "not carried out"
        return Ruling(obstacle, f"latched; {done}: {does}")

    def _acquire(self, request: requests.Acquire, operator: str, now_ns: int) -> Ruling:
        held = self._leases.held
        lease = self._leases.acquire(operator, request.role, now_ns)
        if isinstance(lease, Reason):
            left_s = (held.expires_ns - now_ns) / 1e9 if held is not None else 0.0
            return Ruling(lease, f"by {held.operator if held else ''}, expires in {left_s:.1f} s")
        return self._begin_lease(lease, "acquired", now_ns)

    def _take(self, request: requests.Take, operator: str, now_ns: int) -> Ruling:
        held = self._leases.held
        if held is not None and not request.override and not self._monitor.stands:
            return Ruling(Reason.MOVING, "or is not seen to stand; override takes the lease anyway")
        lease = self._leases.take(operator, request.role, now_ns)
        if isinstance(lease, Reason):
            return Ruling(lease, f"{held.operator} holds it as {held.role.value}" if held is not None else "")
        if held is not None:
            text = f"{operator} took the lease from {held.operator}"
            self._outbox.add_event(Severity.WARNING, EventKind.LEASE, Reason.LEASE_TAKEN, text, held.operator)
            if self._engagement.state in COMMANDING:
                self._engagement.begin_stop(Reason.LEASE_TAKEN, now_ns, f"by {operator}", operator)
        return self._begin_lease(lease, "taken" if held is not None else "acquired", now_ns)

    def _begin_lease(self, lease: HeldLease, how: str, now_ns: int) -> Ruling:
        self._link.begin_lease()
        text = f"{lease.operator} has {how} the lease as {lease.role.value}"
        self._outbox.add_event(Severity.INFO, EventKind.LEASE, Reason.NONE, text, lease.operator)
        return Ruling(lease=lease.id, expires_ns=lease.expires_ns - now_ns)

    def _renew(self, request: requests.Renew, _operator: str, now_ns: int) -> Ruling:
        self._leases.renew(now_ns)
        expires_ns = self._leases.held.expires_ns - now_ns if self._leases.held is not None else 0
        return Ruling(lease=request.lease, expires_ns=expires_ns)

    def _release(self, request: requests.Release, operator: str, now_ns: int) -> Ruling:
        self._leases.end(Reason.LEASE_RELEASED)
        text = f"{operator} gave the lease back"
        self._outbox.add_event(Severity.INFO, EventKind.LEASE, Reason.LEASE_RELEASED, text, operator)
        if self._engagement.state in COMMANDING:
            self._engagement.begin_stop(Reason.LEASE_RELEASED, now_ns, operator=operator)
        return Ruling(lease=request.lease)

    def _engage(self, request: requests.Engage, _operator: str, now_ns: int) -> Ruling:
        reason = _BY_STATE.get(self._engagement.state)
        blockers = [reason] if reason is not None else self._engagement.blockers(now_ns)
        if not blockers and self._link.wants_motion(now_ns):
            blockers = [Reason.COMMAND_NOT_ZERO]
        if blockers:
            chassis = self._monitor.chassis
            what = {Reason.FEEDBACK_MISSING: chassis.missing, Reason.FEEDBACK_FAULTY: chassis.faulty}
            named = ", ".join(what.get(blockers[0], ())) or self._engagement.bars.get(blockers[0], "")
            others = ", ".join(blocker.value for blocker in blockers[1:])
            detail = "; ".join(filter(None, (named, f"and {others}" if others else "")))
            return Ruling(blockers[0], detail, lease=request.lease)
        age_ns = self._link.challenges.age_ns(request.challenge, now_ns)
        if isinstance(age_ns, Reason):
            return Ruling(age_ns, lease=request.lease)
        if age_ns > self._max_age_s * 1e9:
            return Ruling(Reason.LINK_TOO_SLOW, self._age_text(age_ns), lease=request.lease, age_ns=age_ns)
        if request.speed_limit_mps is not None and request.speed_limit_mps <= 0:
            return Ruling(Reason.MALFORMED, "speed_limit_mps must be above zero", lease=request.lease)
        self._leases.renew(now_ns)
        self._link.age.begin(request.deadman_s)
        self._engagement.begin_engaging(self._setpoint.configured_limits.lowered(request.speed_limit_mps), now_ns)
        return Ruling(is_pending=True, lease=request.lease, age_ns=age_ns)

    def _age_text(self, age_ns: int) -> str:
        return f"{age_ns / 1e6:.0f} ms, at most {self._max_age_s * 1e3:.0f} ms"

    def _disengage(self, request: requests.Disengage, operator: str, now_ns: int) -> Ruling:
        if self._engagement.state is ArbiterState.STANDBY:
            return Ruling(Reason.NOT_ENGAGED, lease=request.lease)
        self._engagement.begin_stop(Reason.DISENGAGED, now_ns, operator=operator)
        return Ruling(lease=request.lease)

    def _reset(self, request: requests.Reset, operator: str, now_ns: int) -> Ruling:
        refusal = self._reset_refusal(now_ns)
        if refusal is not None:
            return Ruling(refusal, lease=request.lease)
        latched_for_ns = now_ns - self._latches.newest_ns
        if self._latches.details and latched_for_ns < RESET_MIN_NS:
            # The sender of this reset cannot have seen the newest cause yet.
            detail = f"latched {latched_for_ns / 1e6:.0f} ms ago; a reset counts after {RESET_MIN_NS / 1e6:.0f} ms"
            cure = f"wait {(RESET_MIN_NS - latched_for_ns) / 1e9:.1f} s"
            return Ruling(self._latches.newest, detail, lease=request.lease, cure=cure)
        unseen = self._unseen_reason(request.challenge, now_ns)
        if unseen is not Reason.NONE:
            detail, cure = (
                "the reset was sent before this could be seen",
                "look at what is latched now, then reset again",
            )
            return Ruling(unseen, detail, lease=request.lease, cure=cure)
        others = [name for name in self._latches.stopped_by if name != operator]
        if others and request.of != others[0]:
            return Ruling(Reason.STOPPED_BY_OTHER, others[0], lease=request.lease)
        self._monitor.acknowledge(self._latches.details)
        cleared = ", ".join(reason.value for reason in self._latches.details)
        self._latches.details.clear()
        self._engagement.finish_stop(now_ns)
        self._leases.renew(now_ns)
        self._outbox.add_event(
            Severity.INFO, EventKind.RESET, Reason.NONE, f"reset: {cleared or 'nothing was latched'}", operator
        )
        return Ruling(detail=cleared, lease=request.lease)

    def _unseen_reason(self, challenge: bytes | None, now_ns: int) -> Reason:
        """Return why a reset that echoes this challenge may not apply to all latched causes."""
        if challenge is None:
            return Reason.NONE
        age_ns = self._link.challenges.age_ns(challenge, now_ns)
        if isinstance(age_ns, Reason):
            return age_ns
        if age_ns > self._max_age_s * 1e9:
            return Reason.TOO_OLD
        is_seen = not self._latches.details or age_ns <= now_ns - self._latches.newest_ns
        return Reason.NONE if is_seen else self._latches.newest

    def _reset_refusal(self, now_ns: int) -> Reason | None:
        """Return why nothing can be reset: the robot must be seen to stand, with no speed requested."""
        if self._engagement.state is not ArbiterState.STANDBY and not self._engagement.may_finish(now_ns):
            return _BY_STATE[self._engagement.state]
        if self._monitor.chassis.guard_sends:
            return Reason.GUARD
        faults = self._monitor.chassis_faults()
        if faults:
            return faults[0]
        if not self._monitor.stands:
            return Reason.MOVING
        return Reason.COMMAND_NOT_ZERO if self._link.wants_motion(now_ns) else None

    def _set_parked(self, request: requests.Park | requests.Unpark, _operator: str, _now_ns: int) -> Ruling:
        if self._setpoint.target.speed_mps:
            return Ruling(Reason.COMMAND_NOT_ZERO, lease=request.lease)
        self._setpoint.parked = isinstance(request, requests.Park)
        return Ruling(lease=request.lease)

    def _light(self, request: requests.Light, _operator: str, now_ns: int) -> Ruling:
        self._auxiliary.set_light(headlamp=request.headlamp, left=request.left, right=request.right, now_ns=now_ns)
        return Ruling(lease=request.lease)

    def _horn(self, request: requests.Horn, _operator: str, now_ns: int) -> Ruling:
        self._auxiliary.set_horn(on=request.on, now_ns=now_ns)
        return Ruling(lease=request.lease)

    def _clear_odometer(self, request: requests.ClearOdometer, _operator: str, now_ns: int) -> Ruling:
        if self._auxiliary.is_clearing:
            return Ruling(Reason.BUSY, lease=request.lease)
        if not self._monitor.stands:
            return Ruling(Reason.MOVING, lease=request.lease)
        self._auxiliary.clear_odometer(now_ns)
        return Ruling(is_pending=True, lease=request.lease)

    def _reset_odometry(self, request: requests.ResetOdometry, operator: str, _now_ns: int) -> Ruling:
        """Accept it in motion too: no rule of the arbiter depends on the pose."""
        text = "odometry reset: the pose is zero here"
        self._outbox.add_event(Severity.INFO, EventKind.RESET, Reason.NONE, text, operator)
        return Ruling(lease=request.lease)

    def _drive(self, request: requests.Drive, _operator: str, now_ns: int) -> Ruling:
        asked_deg = steering_angle_deg(request, self._design.wheelbase_m)
        asked = Target(request.speed_mps, asked_deg) if isinstance(asked_deg, float) else None
        age_ns = self._link.challenges.age_ns(request.challenge, now_ns)
        known_age_ns = age_ns if isinstance(age_ns, int) else None

        def ruled(reason: Reason, detail: str = "") -> Ruling:
            self._link.age.refuse(reason, known_age_ns)
            return Ruling(
                reason, detail, lease=request.lease, sequence=request.seq, age_ns=known_age_ns, asked=asked
            )

        if request.seq <= self._link.last_sequence:
            return ruled(Reason.SEQUENCE, f"{request.seq} after {self._link.last_sequence}")
        if request.seq > self._link.last_sequence + SEQUENCE_STEP_MAX:
            detail = f"{request.seq} after {self._link.last_sequence}, at most {SEQUENCE_STEP_MAX} more"
            return ruled(Reason.SEQUENCE, detail)
        if isinstance(age_ns, Reason):
            return ruled(age_ns)
        if age_ns > self._max_age_s * 1e9:
            return ruled(Reason.TOO_OLD, self._age_text(age_ns))
        if asked is None:
            return ruled(Reason.MALFORMED, str(asked_deg))
        # The command is fresh and from the holder: it renews the lease in any state.
        self._link.note_drive(request.seq, request.speed_mps, now_ns)
        self._leases.renew(now_ns)
        if self._engagement.state is ArbiterState.ENGAGED:
            self._link.fresh_ns = now_ns
            self._setpoint.target = asked
        elif self._engagement.state is not ArbiterState.ENGAGING or request.speed_mps:
            return ruled(_BY_STATE.get(self._engagement.state, Reason.NOT_ENGAGED))
        self._link.age.accept(request.seq, age_ns, now_ns)
        return ruled(Reason.NONE)


_NOTHING_PROVEN: Final = Credentials(Reason.PROOF_MISSING)


def _as_granted(request: requests.Request, credentials: Credentials) -> requests.Request | Ruling:
    """Return the request with role and limit of its sender's grant, or the refusal."""
    if credentials.reason is not Reason.NONE:
        return Ruling(credentials.reason, credentials.detail)
    match request:
        case requests.Take(override=True) if not credentials.override:
            return Ruling(Reason.NOT_GRANTED, "override is not granted")
        case requests.Acquire() | requests.Take():
            return msgspec.structs.replace(request, role=credentials.role)
        case requests.Engage():
            limits_mps = [one for one in (request.speed_limit_mps, credentials.speed_limit_mps) if one is not None]
            return msgspec.structs.replace(request, speed_limit_mps=min(limits_mps, default=None))
    return request

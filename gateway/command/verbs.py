"""What is ruled on each verb: one function a verb, in one table."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from gateway.command.lease import Lease
from gateway.command.limits import steering_angle_deg
from gateway.command.link_age import LinkAge
from gateway.command.motion import Target
from gateway.command.request import RawRequest, Ruling
from schemas import codec, requests
from schemas.codec import PayloadFault
from schemas.decisions import COMMANDING, ArbiterState, EventKind, Severity
from schemas.messages import ControllerState, Mode
from schemas.reasons import Reason
from schemas.settings import REQUEST_MAX_BYTES, RESET_MIN_NS, SEQUENCE_STEP_MAX
from schemas.subjects import BY_VERB, STOP_VERB, Asking

if TYPE_CHECKING:
    from gateway.command.arbiter import Arbiter

_BY_STATE: Final = {
    ArbiterState.ENGAGING: Reason.ENGAGING,
    ArbiterState.ENGAGED: Reason.ALREADY_ENGAGED,
    ArbiterState.STOPPING: Reason.STOPPING,
}


def rule(arbiter: Arbiter, raw: RawRequest, now_ns: int) -> Ruling:
    """What becomes of a request. Whatever its bytes are, this does not raise."""
    if raw.verb == STOP_VERB:
        # Served before anything is read: from anyone, whatever its payload holds.
        return _stop(arbiter, raw.operator, now_ns)
    command = BY_VERB.get(raw.verb)
    if command is None or raw.is_query is not (command.asking is Asking.QUERY):
        return Ruling(Reason.UNKNOWN_VERB, f"{raw.verb[:32]!a} as a {'query' if raw.is_query else 'put'}")
    if raw.size > REQUEST_MAX_BYTES:
        return Ruling(Reason.TOO_LARGE, f"{raw.size} bytes, at most {REQUEST_MAX_BYTES}")
    request = PayloadFault(raw.fault) if raw.fault else codec.decode_request(command, raw.payload)
    if isinstance(request, PayloadFault):
        return Ruling(Reason.MALFORMED, request.detail[:200])
    if not raw.operator:
        return Ruling(Reason.MALFORMED, "the operator's chunk of the key is not of its form")
    if isinstance(request, requests.Leased):
        refusal = arbiter.desk.refusal(request.lease, raw.operator)
        if refusal is not None:
            return Ruling(refusal, lease=request.lease)
    return _VERBS[type(request)](arbiter, request, raw.operator, now_ns)


def engage_blockers(arbiter: Arbiter, now_ns: int) -> list[Reason]:
    """Why the robot cannot be engaged now, whoever asks; the gravest first."""
    watch = arbiter.watch
    observed = watch.observed
    unguarded = not observed.guarded and not arbiter.accepts_unguarded
    conditions = {
        Reason.SHUTDOWN: arbiter.is_closing,
        Reason.BUS_DOWN: not observed.bus_up,
        Reason.UNGUARDED: unguarded,
        Reason.GUARD: observed.guard_sends,
        Reason.HAND_TRANSMITTER: observed.mode is Mode.REMOTE,
        Reason.OTHER_COMMANDER: watch.is_commanded_by_other(now_ns),
    }
    blockers = [*arbiter.latched]
    blockers += [reason for reason, holds in conditions.items() if holds and reason not in blockers]
    faults = watch.chassis_faults()
    blockers += faults
    if not faults and not watch.stands:
        blockers.append(Reason.MOVING)
    return blockers


def _stop(arbiter: Arbiter, operator: str, now_ns: int) -> Ruling:
    """Latched in any case. Where it cannot be carried out, the reply says so, and what the robot does."""
    arbiter.begin_stop(Reason.REMOTE_STOP, now_ns, f"by {operator or 'an unnamed operator'}", operator)
    observed = arbiter.watch.observed
    speed_mps = observed.fastest_mps
    moves = "the robot is not seen to stand" if speed_mps is None else f"the robot moves at {speed_mps:.2f} m/s"
    does = "the robot stands" if observed.is_slow else moves
    if observed.guard_sends and observed.mode is not Mode.REMOTE:
        return Ruling(detail=f"the guard is stopping it; {does}")
    obstacles = {
        Reason.BUS_DOWN: not observed.bus_up,
        Reason.BUS_OFF: observed.controller is ControllerState.BUS_OFF,
        Reason.SEND_FAILED: arbiter.watch.send_failures > 0,
        Reason.HAND_TRANSMITTER: observed.mode is Mode.REMOTE,
        Reason.OTHER_COMMANDER: arbiter.watch.is_commanded_by_other(now_ns),
        Reason.FEEDBACK_MISSING: speed_mps is None,
    }
    obstacle = next((reason for reason, holds in obstacles.items() if holds), Reason.NONE)
    if obstacle is Reason.NONE:
        return Ruling(detail=does)
    is_told = arbiter.state is ArbiterState.STOPPING and observed.bus_up and observed.mode is not Mode.REMOTE
    done = "told, but not known to be obeyed" if is_told else "not carried out"
    return Ruling(obstacle, f"latched; {done}: {does}")


def _acquire(arbiter: Arbiter, request: requests.Acquire, operator: str, now_ns: int) -> Ruling:
    held = arbiter.desk.lease
    lease = arbiter.desk.acquire(operator, request.role, now_ns)
    if isinstance(lease, Reason):
        left_s = (held.expires_ns - now_ns) / 1e9 if held is not None else 0.0
        return Ruling(lease, f"by {held.operator if held else ''}, expires in {left_s:.1f} s")
    return _begin_lease(arbiter, lease, "acquired", now_ns)


def _take(arbiter: Arbiter, request: requests.Take, operator: str, now_ns: int) -> Ruling:
    held = arbiter.desk.lease
    if held is not None and not request.override and not arbiter.watch.stands:
        return Ruling(Reason.MOVING, "or is not seen to stand; override takes it all the same")
    lease = arbiter.desk.take(operator, request.role, now_ns)
    if isinstance(lease, Reason):
        return Ruling(lease, f"{held.operator} holds it as {held.role.value}" if held is not None else "")
    if held is not None:
        text = f"{operator} took the lease from {held.operator}"
        arbiter.tell(Severity.WARNING, EventKind.LEASE, Reason.LEASE_TAKEN, text, held.operator)
        if arbiter.state in COMMANDING:
            arbiter.begin_stop(Reason.LEASE_TAKEN, now_ns, f"by {operator}", operator)
    return _begin_lease(arbiter, lease, "taken" if held is not None else "acquired", now_ns)


def _begin_lease(arbiter: Arbiter, lease: Lease, how: str, now_ns: int) -> Ruling:
    arbiter.last_sequence = -1
    arbiter.last_drive = None
    arbiter.link = LinkAge(arbiter.settings)
    text = f"{lease.operator} has {how} the lease as {lease.role.value}"
    arbiter.tell(Severity.INFO, EventKind.LEASE, Reason.NONE, text, lease.operator)
    return Ruling(lease=lease.id, expires_ns=lease.expires_ns - now_ns)


def _renew(arbiter: Arbiter, request: requests.Renew, operator: str, now_ns: int) -> Ruling:
    del operator
    arbiter.desk.renew(now_ns)
    expires_ns = arbiter.desk.lease.expires_ns - now_ns if arbiter.desk.lease is not None else 0
    return Ruling(lease=request.lease, expires_ns=expires_ns)


def _release(arbiter: Arbiter, request: requests.Release, operator: str, now_ns: int) -> Ruling:
    arbiter.desk.end(Reason.LEASE_RELEASED)
    text = f"{operator} gave the lease back"
    arbiter.tell(Severity.INFO, EventKind.LEASE, Reason.LEASE_RELEASED, text, operator)
    if arbiter.state in COMMANDING:
        arbiter.begin_stop(Reason.LEASE_RELEASED, now_ns, operator=operator)
    return Ruling(lease=request.lease)


def _engage(arbiter: Arbiter, request: requests.Engage, operator: str, now_ns: int) -> Ruling:
    del operator
    reason = _BY_STATE.get(arbiter.state)
    blockers = [reason] if reason is not None else engage_blockers(arbiter, now_ns)
    if not blockers and _wants_motion(arbiter, now_ns):
        blockers = [Reason.COMMAND_NOT_ZERO]
    if blockers:
        observed = arbiter.watch.observed
        what = {Reason.FEEDBACK_MISSING: observed.missing, Reason.FEEDBACK_FAULTY: observed.faulty}
        named = ", ".join(what.get(blockers[0], ()))
        others = ", ".join(blocker.value for blocker in blockers[1:])
        detail = "; ".join(filter(None, (named, f"and {others}" if others else "")))
        return Ruling(blockers[0], detail, lease=request.lease)
    age_ns = arbiter.challenges.age_ns(request.challenge, now_ns)
    if isinstance(age_ns, Reason):
        return Ruling(age_ns, lease=request.lease)
    if age_ns > arbiter.settings.max_age_s * 1e9:
        return Ruling(Reason.LINK_TOO_SLOW, _age_text(arbiter, age_ns), lease=request.lease, age_ns=age_ns)
    if request.speed_limit_mps is not None and request.speed_limit_mps <= 0:
        return Ruling(Reason.MALFORMED, "speed_limit_mps must be above zero", lease=request.lease)
    arbiter.desk.renew(now_ns)
    arbiter.link.begin(request.deadman_s)
    arbiter.begin_engaging(arbiter.configured_limits.lowered(request.speed_limit_mps), now_ns)
    return Ruling(is_pending=True, lease=request.lease, age_ns=age_ns)


def _age_text(arbiter: Arbiter, age_ns: int) -> str:
    return f"{age_ns / 1e6:.0f} ms, at most {arbiter.settings.max_age_s * 1e3:.0f} ms"


def _disengage(arbiter: Arbiter, request: requests.Disengage, operator: str, now_ns: int) -> Ruling:
    if arbiter.state is ArbiterState.STANDBY:
        return Ruling(Reason.NOT_ENGAGED, lease=request.lease)
    arbiter.begin_stop(Reason.DISENGAGED, now_ns, operator=operator)
    return Ruling(lease=request.lease)


def _reset(arbiter: Arbiter, request: requests.Reset, operator: str, now_ns: int) -> Ruling:
    refusal = _reset_refusal(arbiter, now_ns)
    if refusal is not None:
        return Ruling(refusal, lease=request.lease)
    latched_for_ns = now_ns - arbiter.latched_ns
    if arbiter.latched and latched_for_ns < RESET_MIN_NS:
        # Whoever sent this reset cannot have seen the newest cause yet.
        detail = f"latched {latched_for_ns / 1e6:.0f} ms ago; a reset counts after {RESET_MIN_NS / 1e6:.0f} ms"
        return Ruling([*arbiter.latched][-1], detail, lease=request.lease)
    unseen = _unseen_reason(arbiter, request.challenge, now_ns)
    if unseen is not Reason.NONE:
        return Ruling(unseen, "it was made before this was to be seen", lease=request.lease)
    arbiter.watch.acknowledge(arbiter.latched)
    cleared = ", ".join(reason.value for reason in arbiter.latched)
    arbiter.latched.clear()
    arbiter.desk.renew(now_ns)
    arbiter.tell(
        Severity.INFO, EventKind.RESET, Reason.NONE, f"reset: {cleared or 'nothing was latched'}", operator
    )
    return Ruling(detail=cleared, lease=request.lease)


def _unseen_reason(arbiter: Arbiter, challenge: bytes | None, now_ns: int) -> Reason:
    """Why a reset that echoes this challenge may not be meant for all that is latched."""
    if challenge is None:
        return Reason.NONE
    age_ns = arbiter.challenges.age_ns(challenge, now_ns)
    if isinstance(age_ns, Reason):
        return age_ns
    if age_ns > arbiter.settings.max_age_s * 1e9:
        return Reason.TOO_OLD
    is_seen = not arbiter.latched or age_ns <= now_ns - arbiter.latched_ns
    return Reason.NONE if is_seen else [*arbiter.latched][-1]


def _reset_refusal(arbiter: Arbiter, now_ns: int) -> Reason | None:
    """Why nothing can be reset: the robot must be seen to stand, and nobody may ask it to move."""
    if arbiter.state is not ArbiterState.STANDBY:
        return _BY_STATE[arbiter.state]
    if arbiter.watch.observed.guard_sends:
        return Reason.GUARD
    faults = arbiter.watch.chassis_faults()
    if faults:
        return faults[0]
    if not arbiter.watch.stands:
        return Reason.MOVING
    return Reason.COMMAND_NOT_ZERO if _wants_motion(arbiter, now_ns) else None


def _park(arbiter: Arbiter, request: requests.Park, operator: str, now_ns: int) -> Ruling:
    del operator, now_ns
    if arbiter.state is not ArbiterState.ENGAGED:
        return Ruling(Reason.NOT_ENGAGED, lease=request.lease)
    if arbiter.target.speed_mps:
        return Ruling(Reason.COMMAND_NOT_ZERO, lease=request.lease)
    arbiter.parked = True
    return Ruling(lease=request.lease)


def _unpark(arbiter: Arbiter, request: requests.Unpark, operator: str, now_ns: int) -> Ruling:
    del operator, now_ns
    if arbiter.state is not ArbiterState.ENGAGED:
        return Ruling(Reason.NOT_ENGAGED, lease=request.lease)
    if arbiter.target.speed_mps:
        return Ruling(Reason.COMMAND_NOT_ZERO, lease=request.lease)
    arbiter.parked = False
    return Ruling(lease=request.lease)


def _light(arbiter: Arbiter, request: requests.Light, operator: str, now_ns: int) -> Ruling:
    del operator
    if arbiter.state is not ArbiterState.ENGAGED:
        return Ruling(Reason.NOT_ENGAGED, lease=request.lease)
    arbiter.auxiliary.set_light(request, now_ns)
    return Ruling(lease=request.lease)


def _horn(arbiter: Arbiter, request: requests.Horn, operator: str, now_ns: int) -> Ruling:
    del operator
    if arbiter.state is not ArbiterState.ENGAGED:
        return Ruling(Reason.NOT_ENGAGED, lease=request.lease)
    arbiter.auxiliary.set_horn(on=request.on, now_ns=now_ns)
    return Ruling(lease=request.lease)


def _clear_odometer(arbiter: Arbiter, request: requests.ClearOdometer, operator: str, now_ns: int) -> Ruling:
    del operator
    if arbiter.state is not ArbiterState.ENGAGED:
        return Ruling(Reason.NOT_ENGAGED, lease=request.lease)
    if arbiter.auxiliary.is_clearing:
        return Ruling(Reason.BUSY, lease=request.lease)
    if not arbiter.watch.stands:
        return Ruling(Reason.MOVING, lease=request.lease)
    arbiter.auxiliary.clear_odometer(now_ns)
    return Ruling(is_pending=True, lease=request.lease)


def _drive(arbiter: Arbiter, request: requests.Drive, operator: str, now_ns: int) -> Ruling:
    del operator
    asked_deg = steering_angle_deg(request)
    asked = Target(request.speed_mps, asked_deg) if isinstance(asked_deg, float) else None
    age_ns = arbiter.challenges.age_ns(request.challenge, now_ns)
    known_age_ns = age_ns if isinstance(age_ns, int) else None

    def ruled(reason: Reason, detail: str = "") -> Ruling:
        arbiter.link.refuse(reason, known_age_ns)
        return Ruling(reason, detail, lease=request.lease, sequence=request.seq, age_ns=known_age_ns, asked=asked)

    if request.seq <= arbiter.last_sequence:
        return ruled(Reason.SEQUENCE, f"{request.seq} after {arbiter.last_sequence}")
    if request.seq > arbiter.last_sequence + SEQUENCE_STEP_MAX:
        detail = f"{request.seq} after {arbiter.last_sequence}, at most {SEQUENCE_STEP_MAX} more"
        return ruled(Reason.SEQUENCE, detail)
    if isinstance(age_ns, Reason):
        return ruled(age_ns)
    if age_ns > arbiter.settings.max_age_s * 1e9:
        return ruled(Reason.TOO_OLD, _age_text(arbiter, age_ns))
    if asked is None:
        return ruled(Reason.MALFORMED, str(asked_deg))
    # From here on the command is known to be fresh and its holder's: the holder is there, whatever the state is.
    arbiter.last_sequence = request.seq
    arbiter.last_drive = (request.speed_mps, now_ns)
    arbiter.desk.renew(now_ns)
    if arbiter.state is ArbiterState.ENGAGED:
        arbiter.fresh_ns = now_ns
        arbiter.target = asked
    elif arbiter.state is not ArbiterState.ENGAGING or request.speed_mps:
        return ruled(_DRIVE_REFUSALS[arbiter.state])
    arbiter.link.accept(request.seq, age_ns, now_ns)
    return ruled(Reason.NONE)


_DRIVE_REFUSALS: Final = {
    ArbiterState.STANDBY: Reason.NOT_ENGAGED,
    ArbiterState.ENGAGING: Reason.ENGAGING,
    ArbiterState.STOPPING: Reason.STOPPING,
}


def _wants_motion(arbiter: Arbiter, now_ns: int) -> bool:
    """A drive command that came lately is not zero."""
    if arbiter.last_drive is None:
        return False
    speed_mps, at_ns = arbiter.last_drive
    return speed_mps != 0 and now_ns - at_ns <= arbiter.link.deadman_ns


_VERBS: Final[dict[type[requests.Request], Callable[[Arbiter, Any, str, int], Ruling]]] = {
    requests.Acquire: _acquire,
    requests.Take: _take,
    requests.Renew: _renew,
    requests.Release: _release,
    requests.Engage: _engage,
    requests.Disengage: _disengage,
    requests.Reset: _reset,
    requests.Park: _park,
    requests.Unpark: _unpark,
    requests.Light: _light,
    requests.Horn: _horn,
    requests.ClearOdometer: _clear_odometer,
    requests.Drive: _drive,
}

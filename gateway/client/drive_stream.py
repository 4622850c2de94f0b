"""The stream of drive commands of one lease: set points that age, the sequence, the echoed challenge. Pure.

``see`` accepts the robot's states; ``command`` returns the drive command to send now, or None.
"""

from __future__ import annotations

from math import dist, isfinite
from numbers import Real
from typing import Final

import msgspec

from gateway.client.evidence import Evidence
from gateway.command.limits import steering_angle_deg
from schemas.decisions import COMMANDING, ArbiterState, SafetyState, is_same_run
from schemas.reasons import TEXTS, Reason
from schemas.requests import Drive

PERIOD_S: Final = 0.02
"""The stream's period while the robot is engaged: 50 Hz."""

HOLD_S: Final = 0.5
"""A set point holds for this long unless it is renewed."""

HOLD_MAX_S: Final = 2.0
"""No set point holds for longer: a program that hangs shall not drive on."""

STALE_NS: Final = 1_000_000_000
"""A command that echoes a challenge received longer ago than this would be refused, so it is not sent."""

SILENT_NS: Final = 1_000_000_000
"""A robot is out of reach after this time without its safety/state."""


FOREIGN_NS: Final = 500_000_000
"""Another sender's commands reappear within this time: between them, our own are executed."""

SENT_KEPT: Final = 128
"""So many commands are remembered: those of the last two seconds and a half."""


BEGAN_ANEW: Final = "the robot's gateway has begun anew, and knows nothing of the lease"
"""It died, or was restarted: its ticks are those of another run."""

GRANT_ENDS: Final = frozenset({Reason.GRANT_EXPIRED, Reason.GRANT_REVOKED})

ROUNDING: Final = 1e-6
"""m/s and deg: no target that was asked for differs by less."""


class SetPoint(msgspec.Struct, frozen=True):
    """The motion to ask for: a signed speed, and one of angle, curvature and yaw rate."""

    speed_mps: float = 0.0
    angle_deg: float | None = None
    curvature_1pm: float | None = None
    yaw_rate_radps: float | None = None

    def command(self, lease: int, seq: int, challenge: bytes, tick: int) -> Drive:
        """The drive command that asks for it."""
        return Drive(
            lease=lease,
            seq=seq,
            challenge=challenge,
            tick=tick,
            speed_mps=self.speed_mps,
            angle_deg=self.angle_deg,
            curvature_1pm=self.curvature_1pm,
            yaw_rate_radps=self.yaw_rate_radps,
        )


class DriveEnd(msgspec.Struct, frozen=True):
    """The reason why the robot no longer accepts drive commands.

    Attributes:
        lease_lost: the lease is gone too; else the robot can be engaged again.
    """

    reason: Reason
    detail: str = ""
    lease_lost: bool = False


class DriveStream:
    """The drive commands of one holder of a lease.

    A single state ends nothing: it may be forged. The robot repeats its own states, and a forged one comes
    between others that contradict it.

    Attributes:
        lease: its number.
        is_shared: commands of somebody else were accepted under the lease. It has to be given back: so the robot
            stops.
        ending: why nothing is sent any more; None while all is well, or nobody engaged.
        engaged: the robot was seen engaged since ``expect_engaged``, and still is.
    """

    def __init__(self, lease: int, operator: str) -> None:
        self.lease = lease
        self.ending: DriveEnd | None = None
        self.engaged = False
        self._operator = operator
        self._is_wanted = False
        self._is_asked = False
        self._was_holder = False
        self._held_tick = 0
        self._state: SafetyState | None = None
        self._seen_ns = 0
        self._sequence = 0
        self._set_point: SetPoint | None = None
        self._until_ns = 0
        self._note = ""
        self.is_shared = False
        self._sent: dict[int, tuple[float, float]] = {}
        self._loss, self._foreign, self._stop = Evidence(), Evidence(FOREIGN_NS), Evidence()

    @property
    def is_wanted(self) -> bool:
        """The robot is engaged for us, or is being engaged: drive commands renew the lease."""
        if not self._is_wanted or self._state is None:
            return False
        # From the moment that engage is asked for: over a slow link the robot would wait for the first command for
        # longer than its deadman, if that waited until the robot is seen to be engaged.
        return self._is_asked or self._state.state in COMMANDING

    @property
    def is_lost(self) -> bool:
        """The lease is not ours any more."""
        return self.ending is not None and self.ending.lease_lost

    @property
    def asks_for_zero(self) -> bool:
        """The program asks for zero speed, or for nothing."""
        return self._set_point is None or not self._set_point.speed_mps

    def expect_engaged(self) -> None:
        """Prepare for an engage request. The earlier set point is dropped."""
        self._is_wanted = self._is_asked = True
        self.engaged = False
        self._set_point = None
        self._sent.clear()
        self._stop.clear()
        if not self.is_lost:
            self.ending = None

    def give_up(self) -> None:
        """The program itself disengages or releases: send nothing more, and call it no failure."""
        self._is_wanted = self._is_asked = self.engaged = False
        self._set_point = None

    def aim(self, set_point: SetPoint, hold_s: float, now_ns: int) -> None:
        """Set the motion to ask for from now on.

        Raises:
            TypeError: a value is no number.
            ValueError: the set point cannot be, or it would hold for too long.
        """
        # The robot would refuse each command, and a stop by the deadman would look like a fault of the network.
        given = msgspec.structs.asdict(set_point).items()
        set_point = SetPoint(
            **{name: _finite(name, value) for name, value in given if value is not None or name == "speed_mps"}
        )
        if not 0 < hold_s <= HOLD_MAX_S:
            raise ValueError(f"hold_s must be above 0 and at most {HOLD_MAX_S:g} s")
        angle_deg = steering_angle_deg(set_point.command(0, 0, b"", 0))
        if isinstance(angle_deg, str):
            raise ValueError(angle_deg)  # noqa: TRY004 - it is the value that is wrong
        self._set_point = set_point
        self._until_ns = now_ns + round(hold_s * 1e9)
        self._note = ""

    def see(self, state: SafetyState, now_ns: int) -> None:
        """The robot's newest safety/state."""
        self._state, self._seen_ns = state, now_ns
        if state.lease_holder == self._operator:
            self._was_holder = True
            self._held_tick = state.tick
            self._loss.clear()
            if self._is_foreign(state) and self._foreign.add(now_ns) and not self.is_lost:
                self.is_shared = True
                self.lose(Reason.LEASE_TAKEN, "commands that this program did not send are obeyed under its lease")
        elif self._was_holder and self._loss.add(now_ns):
            if state.lease_holder:
                self.lose(Reason.LEASE_TAKEN, f"by {state.lease_holder}")
            else:
                self.lose(_loss_of(state) if not self._is_of_other_run(state) else Reason.NO_LEASE)
        if not self._is_wanted:
            return
        if state.state is ArbiterState.ENGAGED:
            self.engaged = True
            self._is_asked = False
            self._stop.clear()
        elif self.engaged and self._stop.add(now_ns):
            reason = state.stop_reason if state.stop_reason is not Reason.NONE else Reason.NOT_ENGAGED
            detail = "; ".join(filter(None, (TEXTS[reason].means, state.stop_detail)))
            self._end(DriveEnd(reason, detail))

    def lose(self, reason: Reason, detail: str = "") -> None:
        """The lease is lost."""
        if reason is Reason.NO_LEASE and self._state is not None and self._is_of_other_run(self._state):
            detail = BEGAN_ANEW
        if not self.is_lost:
            self._end(DriveEnd(reason, detail, lease_lost=True))

    def command(self, now_ns: int) -> Drive | None:
        """The drive command to send now, or None if none is to be sent."""
        state = self._state
        if state is None or not self.is_wanted or now_ns - self._seen_ns > STALE_NS:
            return None
        self._sequence += 1
        drive = self._in_force(state, now_ns).command(self.lease, self._sequence, state.challenge, state.tick)
        angle_deg = steering_angle_deg(drive)
        if self.engaged and isinstance(angle_deg, float):
            self._sent[drive.seq] = drive.speed_mps, angle_deg
            self._sent.pop(drive.seq - SENT_KEPT, None)
        return drive

    def take_note(self) -> str:
        """Return a note for the program, once; empty if there is none."""
        note, self._note = self._note, ""
        return note

    def _is_of_other_run(self, state: SafetyState) -> bool:
        """Said by another run of the gateway than the one that gave the lease."""
        return self._was_holder and not is_same_run(state.tick, self._held_tick)

    def _is_foreign(self, state: SafetyState) -> bool:
        """The last accepted command of our lease was not ours: we never sent it, or asked for something else."""
        accepted = state.accepted_seq
        if accepted is None or accepted > self._sequence:
            return accepted is not None
        sent = self._sent.get(accepted)
        target = state.target_speed_mps, state.target_angle_deg
        return sent is not None and state.engaged and dist(sent, target) > ROUNDING

    def _in_force(self, state: SafetyState, now_ns: int) -> SetPoint:
        wanted = self._set_point
        if wanted is None or state.state is not ArbiterState.ENGAGED:
            # Nothing is asked for yet: hold the wheels where they are.
            return SetPoint(0.0, angle_deg=state.output_angle_deg)
        if now_ns < self._until_ns or not wanted.speed_mps:
            return wanted
        angle_deg = steering_angle_deg(wanted.command(0, 0, b"", 0))
        self._set_point = SetPoint(0.0, angle_deg=angle_deg if isinstance(angle_deg, float) else 0.0)
        self._note = "the set point was not renewed in time: zero speed"
        return self._set_point

    def _end(self, ending: DriveEnd) -> None:
        self.ending = ending
        self._is_wanted = self._is_asked = self.engaged = False
        self._set_point = None


def _finite(name: str, value: object) -> float:
    """Return a value as a float: a number of any library, but no truth value and no text."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name} must be a number, and is {value!r}")
    number = float(value)
    if not isfinite(number):
        raise ValueError(f"{name} must be a finite number, and is {number}")
    return number


def _loss_of(state: SafetyState) -> Reason:
    """Return why nobody holds the lease any more, as far as the robot's last stop says it."""
    return state.stop_reason if state.stop_reason in GRANT_ENDS else Reason.LEASE_EXPIRED

"""An operator on a machine with other work, which may rightly stop the robot at any time."""

from collections.abc import Callable

from gateway.client.refusal import LeaseLost, RobotError, Unreachable
from gateway.client.robot import Lease, Robot
from schemas.decisions import SafetyState
from schemas.reasons import Reason
from schemas.settings import DEADMAN_MAX_S

# Reasons of a stop on a busy machine, after which the holder engages again.
STARVED = {
    Reason.DEADMAN,
    Reason.GUARD,
    Reason.FEEDBACK_MISSING,
    Reason.FEEDBACK_LATE,
    Reason.LOOP_LATE,
    Reason.UNGUARDED,
    Reason.NOT_CONFIRMED,
}
RESTING = {Reason.NOT_ENGAGED, Reason.GUARD}  # blocking reasons that the holder's engage removes
LEASE_SEEN_S = 3.0  # from the reply with a lease until the robot's states must have it


def hold(robot: Robot, lease: Lease, speed_mps: float) -> None:
    """Drive, and engage again where the machine was too busy."""
    try:
        if not lease.is_engaged:
            # Its states may be those of before the lease for a moment; after that, without it the lease is lost.
            robot.wait_for(_is_leased, LEASE_SEEN_S)
            robot.wait_for(lambda state: set(state.blocked_by) <= RESTING or not _is_leased(state), 30)
            lease.reset()
            lease.engage(deadman_s=DEADMAN_MAX_S)
            lease.unpark()
        lease.drive(speed_mps)
    except RobotError as error:
        if isinstance(error, LeaseLost) or error.reason not in {*STARVED, Reason.NOT_ENGAGED}:
            raise
    except Unreachable:
        return  # For a moment; else whoever waits gives up.


def _is_leased(state: SafetyState) -> bool:
    return Reason.NO_LEASE not in state.blocked_by


def is_done(act: Callable[[], object]) -> bool:
    """Try it; on a busy machine a robot may refuse, or be unreachable, for a moment."""
    try:
        act()
    except (RobotError, Unreachable):
        return False
    return True

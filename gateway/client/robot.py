"""A robot, as a program commands it.

    with Robot.connect("cruiser-1") as robot, robot.lease() as lease:
        lease.engage(speed_limit_mps=0.5)
        lease.unpark()
        for _ in range(50):
            lease.drive(0.3, angle_deg=5.0)      # holds for 0.5 s unless it is renewed
            time.sleep(0.1)
        lease.disengage()                        # returns when the robot is on standby

A thread of the library receives the robot's states and sends the drive commands. Each failure is an exception with
its reason: ``Refused``, ``Stopped``, ``LeaseLost``, ``Unreachable``.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from types import TracebackType
from typing import Final, Self

from gateway.client import remote_stop
from gateway.client.link import HOLD_S, DriveStream, RelayStream, RobotLink, SetPoint, Sighting
from gateway.client.proof import LinkProof, operator_proof
from gateway.client.refusal import LeaseLost, Refused, RobotError, Stopped, Unreachable
from gateway.client.remote_stop import REST_S, StopReport
from gateway.zenoh.operator import CommandPort, SafetyListener
from schemas import keys
from schemas.command_line import CommandError
from schemas.decisions import COMMANDING, ArbiterState, LeaseReply, Reply, SafetyEvent, SafetyState
from schemas.keys import login_operator
from schemas.reasons import Reason
from schemas.requests import (
    Acquire,
    ClearOdometer,
    Disengage,
    Engage,
    Horn,
    Light,
    Park,
    Release,
    Request,
    Reset,
    ResetOdometry,
    Role,
    Take,
    Unpark,
)
from schemas.settings import RESET_MIN_NS, Settings
from schemas.zenoh_session import place

log = logging.getLogger(__name__)

CONNECT_TIMEOUT_S: Final = 5.0

ANSWER_TIMEOUT_S: Final = 3.0  # the slowest verb, clear_odometer, has its answer after 2 s
ENGAGED_SEEN_S: Final = 1.0  # the time from the reply to engage until safety/state must agree
ZERO_SEEN_S: Final = 1.0  # the time from a drive command of zero speed until safety/state must agree
RESET_SEEN_S: Final = 1.0  # the same from the reply to reset
RESET_AGAIN_S: Final = RESET_MIN_NS / 1e9 + 0.3  # time in which an early reset is repeated
AGAIN_S: Final = 0.05  # pause before that


class Robot:
    """A connected robot. Make it with ``connect``, and close it, or use it as a context manager.

    Attributes:
        name: the robot's name.
        operator: the name under which it is commanded.
    """

    def __init__(self, link: RobotLink, operator: str, root: str) -> None:
        self.name = link.robot
        self.operator = operator
        self._link = link
        self._root = root

    def __repr__(self) -> str:
        try:
            state = self._link.sighting().state.state.value
        except Unreachable:
            state = "unreachable"
        return f"<Robot {self.name}: {state}, operator={self.operator}>"

    @classmethod
    def connect(
        cls,
        name: str,
        operator: str = "",
        settings: Settings | None = None,
        timeout_s: float = CONNECT_TIMEOUT_S,
        stopped: Callable[[], bool] = lambda: False,
    ) -> Self:
        """Connect to a robot, and wait until its state arrives and it accepts requests.

        Args:
            name: the robot's name.
            operator: the operator's name; by default the login name.
            settings: its place on Zenoh (``zenoh``, ``robot.root``).
            timeout_s: the longest wait.
            stopped: gives up when it returns True.

        Raises:
            Unreachable: no state arrives, or the robot accepts no commands.
            Refused: in signed mode the robot does not accept the operator's grant, or its own grant is expired,
                missing or from another authority.
            CommandError: a name or an endpoint is malformed, or a file is missing or wrong.
        """
        settings = settings or Settings()
        proof = operator_proof(settings)
        operator = operator or (proof.name if proof is not None else "") or login_operator()
        commands = CommandPort.open(settings, name, operator, lasts=True)
        try:
            listener = SafetyListener.open(settings, name)
        except CommandError:
            commands.close()
            raise
        link = RobotLink(
            commands, listener, name, None if proof is None else LinkProof(proof, name, settings.robot.root)
        )
        deadline_s = time.monotonic() + timeout_s
        is_met, unmet = proof is None, None
        while not (is_met and link.is_heard and commands.reaches()):
            if stopped() or time.monotonic() >= deadline_s:
                problem = _problem(link)
                is_reached = commands.connected() and commands.reaches()
                link.close()
                if unmet is not None and is_reached:
                    what = f"{name} is reached at {place(settings.zenoh)}, but not verified"
                    raise Refused(what, unmet.reason, unmet.text, unmet.cure, robot=name)
                raise Unreachable(f"{problem} within {timeout_s:g} s at {place(settings.zenoh)}")
            if not is_met and commands.reaches():
                unmet = link.meet()
                is_met = unmet is None
            time.sleep(0.01)
        return cls(link, operator, settings.robot.root)

    def state(self) -> Sighting:
        """Return the newest safety/state and its age.

        Raises:
            Unreachable: none arrived for a second.
        """
        return self._link.sighting()

    def events(self) -> list[SafetyEvent]:
        """Return the events since the last call; the first call includes some earlier ones."""
        return self._link.take_events()

    def wait_for(self, condition: Callable[[SafetyState], bool], timeout_s: float) -> bool:
        """Wait until the robot's newest state meets the condition. Returns False after the timeout."""
        return self._link.wait_for(condition, timeout_s)

    def stop(self, timeout_s: float = CONNECT_TIMEOUT_S, *, wait: bool = True) -> None:
        """Stop the robot remotely: at once, latched, without a lease. This is not an emergency stop.

        Args:
            timeout_s: the longest wait for standstill.
            wait: return when the stop sequence has ended and a reset is possible; else at standstill.

        Raises:
            Unreachable: no reply came; the stop was sent repeatedly.
            Refused: the stop is latched but cannot be carried out, standstill is not confirmed, or the reply
                cannot be verified. The text says what the robot does.
        """
        self._link.look()  # What was seen before the stop proves nothing.
        report = remote_stop.stop(
            self._link.commands, self._root, self.name, timeout_s, self._link.look, doubt=self._link.doubt
        )
        for unmet in report.unverified.values():
            what = f"{self.name} not confirmed stopped: its reply cannot be verified"
            raise Refused(what, Reason.NOT_CONFIRMED, unmet.text, unmet.cure, robot=self.name)
        if report.unconfirmed:
            why = "; ".join(report.unconfirmed.values())
            raise Refused(f"{self.name} not confirmed stopped", Reason.NOT_CONFIRMED, why, robot=self.name)
        if report.refused:
            why = "; ".join(report.refused.values())
            raise Refused(f"{self.name} not stopped", Reason.NONE, why, robot=self.name)
        if not report.stopped:
            raise Unreachable(f"{self.name} did not answer the stop within {timeout_s:g} s")
        if wait:
            self.wait_for_rest()

    def reset(self, lease: int, of: str = "", *, wait: bool = True) -> str:
        """Clear the latches with the number of a lease of the same operator: see ``Lease.reset``."""
        return _reset(self._link, lease, of, wait=wait)

    def wait_for_rest(self) -> None:
        """Wait until the robot is on standby.

        Raises:
            RobotError: it is not within 8 s.
        """
        _wait_for_rest(self._link)

    def lease(self, role: Role = Role.OPERATOR) -> Lease:
        """Return the lease, if it is free: acquired when a ``with`` begins, released when it ends."""
        return Lease(self._link, self.operator, Acquire(role=role))

    def relay_lease(self, role: Role = Role.OPERATOR) -> RelayLease:
        """The lease, for a program that passes on the commands of another."""
        return RelayLease(self._link, self.operator, Acquire(role=role))

    def take(self, role: Role = Role.OPERATOR, *, override: bool = False) -> Lease:
        """Return the lease, taken from a holder of no higher role. ``override`` takes it from a moving robot."""
        return Lease(self._link, self.operator, Take(role=role, override=override))

    def ask(self, request: Request, timeout_s: float = ANSWER_TIMEOUT_S) -> Reply:
        """Send a request, and wait until the robot has carried it out or refuses it.

        Raises:
            Refused: with the reason.
            Unreachable: no reply came; the request may have arrived.
        """
        return self._link.ask(request, timeout_s)

    def close(self) -> None:
        """Disconnect. This ends the stream of drive commands, so the robot stops."""
        self._link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Lease:
    """The right to command a robot, in force during a ``with``.

    While the robot is engaged, the library sends a drive command every 20 ms: the set point of ``drive`` during
    its hold time, else zero speed. Otherwise it renews the lease.
    """

    _stream_type: type[DriveStream] = DriveStream

    def __init__(self, link: RobotLink, operator: str, request: Acquire | Take) -> None:
        self._link = link
        self._operator = operator
        self._request = request
        self._stream: DriveStream | None = None

    def __repr__(self) -> str:
        if self._stream is None:
            return f"<Lease of {self._link.robot}: not acquired>"
        engaged = "engaged" if self.is_engaged else "not engaged"
        return f"<Lease {self._stream.lease} of {self._link.robot}: {engaged}>"

    def __enter__(self) -> Self:
        if self._link.has_stream:
            raise ValueError("this Robot has a lease already")
        reply = self._ask(self._request)
        if not isinstance(reply, LeaseReply):
            raise AssertionError("the command table gives these verbs a LeaseReply")  # noqa: TRY004 - our fault
        self._stream = self._stream_type(reply.lease, self._operator)
        self._link.begin_stream(self._stream, reply.expires_s)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._link.end_stream()
        stream, self._stream = self._stream, None
        if stream is None or stream.is_lost:
            return
        try:
            self._ask(Release(lease=stream.lease))
        except CommandError as failure:
            # It expires on the robot, and an error of the body must not be hidden.
            log.warning("the lease was not released; it will expire: %s", failure)

    @property
    def number(self) -> int:
        """The lease's number."""
        return self._in_force().lease

    @property
    def is_engaged(self) -> bool:
        """True while the robot executes our drive commands."""
        return self._stream is not None and self._stream.engaged

    def check(self) -> None:
        """Raise if the drive has ended.

        Raises:
            Stopped: the robot was engaged and no longer is.
            LeaseLost: the lease was taken, or has expired.
            Unreachable: no state arrives any more.
        """
        ending = self._in_force().ending
        if ending is not None:
            robot = self._link.robot
            raise Stopped(f"{robot} stopped", ending.reason, ending.detail, robot=robot)
        self._link.sighting()

    def engage(
        self, speed_limit_mps: float | None = None, deadman_s: float | None = None, *, wait: bool = True
    ) -> None:
        """Take command of the standing chassis. Returns when it reports mode auto.

        Args:
            speed_limit_mps: a lower limit than the configured one.
            deadman_s: a longer command timeout than the configured one, up to 1 s, for a link that stalls. It
                lowers the speed limit: see ``travel_speed_limit_mps`` in the state.
            wait: wait for the end of a stop sequence; else the robot refuses during one.

        Raises:
            Refused, LeaseLost, Stopped, Unreachable: the robot is not engaged.
        """
        stream = self._in_force()
        if stream.engaged:
            raise Refused(f"{self._link.robot} cannot be engaged", Reason.ALREADY_ENGAGED, robot=self._link.robot)
        if wait:
            _let_stop_end(self._link)
        with self._link.heard:
            stream.expect_engaged()
        try:
            challenge = self._link.sighting().state.challenge
            self._ask(Engage(stream.lease, challenge, speed_limit_mps, deadman_s))
        except CommandError:
            with self._link.heard:
                stream.give_up()
            raise
        self._link.wait_for(lambda _: stream.engaged or stream.ending is not None, ENGAGED_SEEN_S)
        self.check()
        if not stream.engaged:
            raise Unreachable(f"{self._link.robot} replied 'engaged', but its safety/state does not confirm it")

    def drive(
        self,
        speed_mps: float,
        *,
        angle_deg: float | None = None,
        curvature_1pm: float | None = None,
        yaw_rate_radps: float | None = None,
        hold_s: float = HOLD_S,
    ) -> None:
        """Set the stream's set point for ``hold_s``; straight ahead without angle, curvature or yaw rate.

        Raises:
            TypeError: a value is not a number.
            ValueError: more than one of angle, curvature and yaw rate is given, or a value is out of range.
            Refused: the robot was never engaged.
            Stopped, LeaseLost, Unreachable: it accepts no more drive commands.
        """
        if angle_deg is None and curvature_1pm is None and yaw_rate_radps is None:
            angle_deg = 0.0
        set_point = SetPoint(speed_mps, angle_deg, curvature_1pm, yaw_rate_radps)
        with self._link.heard:
            self.check()
            stream = self._in_force()
            if not stream.engaged:
                raise Refused(f"{self._link.robot} cannot be driven", Reason.NOT_ENGAGED, robot=self._link.robot)
            stream.aim(set_point, hold_s, time.monotonic_ns())

    def disengage(self, *, wait: bool = True) -> None:
        """Stop in a controlled way and give up command of the chassis, without a latch.

        Args:
            wait: return when the robot is on standby; else when the stop has begun.

        Raises:
            RobotError: it is not seen to come to rest.
        """
        stream = self._in_force()
        with self._link.heard:
            stream.give_up()
        self._ask(Disengage(lease=stream.lease))
        if wait:
            _wait_for_rest(self._link)

    def reset(self, of: str = "", *, wait: bool = True) -> str:
        """Clear the latches. Returns their names.

        Args:
            of: the operator whose remote stop is cleared, if it is another one: see ``stopped_by`` in the state.
            wait: wait for the end of a stop sequence, and until fresh latches are old enough; else the robot
                refuses. Later latches are not cleared.

        Raises:
            Refused: the cause persists, or another operator has stopped the robot (``stopped_by_other``).
        """
        return _reset(self._link, self.number, of, wait=wait)

    def park(self) -> None:
        """Apply the parking brake of the engaged robot; it may still be slowing down."""
        if self._in_force().asks_for_zero:
            # The stream and a question go separate ways: the zero of a moment ago has to be there first.
            self._link.wait_for(lambda state: not state.target_speed_mps, ZERO_SEEN_S)
        self._ask(Park(lease=self.number))

    def unpark(self) -> None:
        """Allow drive commands to release the parking brake."""
        self._ask(Unpark(lease=self.number))

    def light(self, *, headlamp: bool = False, left: bool = False, right: bool = False) -> None:
        """Set headlamp and indicators of the engaged robot."""
        self._ask(Light(lease=self.number, headlamp=headlamp, left=left, right=right))

    def horn(self, *, on: bool) -> None:
        """Sound the horn, or end it."""
        self._ask(Horn(lease=self.number, on=on))

    def clear_odometer(self) -> None:
        """Set the total mileage to zero. Returns when it reads zero."""
        self._ask(ClearOdometer(lease=self.number))

    def reset_odometry(self) -> None:
        """Set the pose of ``chassis/odometry`` to zero, at rest or not."""
        self._ask(ResetOdometry(lease=self.number))

    def _ask(self, request: Request) -> Reply:
        return self._link.ask(request, ANSWER_TIMEOUT_S)

    def _in_force(self) -> DriveStream:
        if self._stream is None:
            raise ValueError("a lease is in force only within its with statement")
        ending = self._stream.ending
        if ending is not None and ending.lease_lost:
            robot = self._link.robot
            raise LeaseLost(f"the lease of {robot} is lost", ending.reason, ending.detail, robot=robot)
        return self._stream


class RelayLease(Lease):
    """A lease under which nothing is sent by the clock: only what ``relay`` is given, once."""

    _stream_type = RelayStream

    def relay(self, set_point: SetPoint) -> bool:
        """Send a drive command now. Returns False if the robot is not engaged, or no longer ours."""
        stream = self._stream
        return isinstance(stream, RelayStream) and self._link.relay(stream, set_point)


def _reset(link: RobotLink, lease: int, of: str, *, wait: bool) -> str:
    seen = link.sighting().state
    challenge = seen.challenge
    if wait and seen.state is not ArbiterState.STANDBY:
        _let_stop_end(link)
        now = link.sighting().state
        # The reset counts as requested now, but the operator has not seen later latches.
        challenge = now.challenge
        if new := [reason for reason in now.latched if reason not in seen.latched]:
            raise Refused(
                f"{link.robot} not reset: a new latch was set meanwhile",
                new[-1],
                now.stop_detail,
                robot=link.robot,
            )
    end_s = time.monotonic() + RESET_AGAIN_S
    while True:
        try:
            cleared = link.ask(Reset(lease, challenge, of), ANSWER_TIMEOUT_S).detail
        except Refused as refusal:
            if not wait or refusal.reason not in seen.latched or time.monotonic() > end_s:
                raise
            time.sleep(AGAIN_S)
        else:
            break
    if wait:
        link.wait_for(lambda state: not state.latched, RESET_SEEN_S)
    return cleared


def _let_stop_end(link: RobotLink) -> None:
    """Wait for the end of a stop sequence, at most as long as one may take.

    The newest state may be older than the stop, so a commanded one is believed only after a moment.
    """
    believed_s = time.monotonic() + ENGAGED_SEEN_S

    def is_over(state: SafetyState) -> bool:
        return state.state is ArbiterState.STANDBY or (state.state in COMMANDING and time.monotonic() > believed_s)

    link.wait_for(is_over, REST_S)


def _wait_for_rest(link: RobotLink) -> None:
    if not link.wait_for(lambda state: state.state is ArbiterState.STANDBY, REST_S):
        what = f"{link.robot} was not seen to come to rest within {REST_S:g} s"
        raise RobotError(what, Reason.NOT_CONFIRMED, robot=link.robot)


def stop_all(
    operator: str = "",
    settings: Settings | None = None,
    timeout_s: float = CONNECT_TIMEOUT_S,
    *,
    wait: bool = True,
) -> StopReport:
    """Stop every robot under the root remotely, and report which are seen to stop.

    Args:
        operator: name of the operator.
        settings: place of the robots on Zenoh.
        timeout_s: the longest wait for standstill.
        wait: return when the stop sequences have ended and resets are possible.

    Raises:
        CommandError: a name or an endpoint is malformed.
    """
    return remote_stop.stop_from_here(settings or Settings(), keys.ALL, operator, timeout_s, wait=wait)


def _problem(link: RobotLink) -> str:
    if not link.commands.connected():
        return "no Zenoh node answered"
    if link.unreadable:
        return f"no readable state from {link.robot} ({link.unreadable})"
    if not link.is_heard and link.hears_chassis:
        return f"the gateway of robot {link.robot!r} only listens (gateway.listen_only) and accepts no commands"
    if not link.is_heard:
        return f"no state received from robot {link.robot!r}"
    return f"robot {link.robot!r} sends its state, but accepts no commands"

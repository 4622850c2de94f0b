"""The demo's drive: two operators, a bumper, a link that stalls; printed as a timeline."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from random import Random
from typing import Final

import msgspec

from gateway.can.relay import Relay
from gateway.client.refusal import Refused, RobotError, Stopped, Unreachable
from gateway.client.robot import Lease, Robot
from gateway.sim.links import LINKS, LinkProfile
from schemas.decisions import ArbiterState, SafetyEvent, SafetyState
from schemas.exit_codes import CommandError, ExitCode
from schemas.reasons import Reason
from schemas.settings import Settings

FIRST: Final = "first-operator"
SECOND: Final = "second-operator"
OBSERVER: Final = "demo"

SETTLED_TICKS: Final = 50

EIGHT_SPEED_MPS: Final = 1.0
EIGHT_ANGLE_DEG: Final = 20.0
RENEWED_S: Final = 0.05
STOPPED_TIMEOUT_S: Final = 10.0
STALL_S: Final = 3.0
GUARD_TIMEOUT_S: Final = 10.0
LEASE_TIMEOUT_S: Final = 5.0

HELD_UP: Final = frozenset(
    {
        Reason.GUARD,
        Reason.UNGUARDED,
        Reason.LOOP_LATE,
        Reason.FEEDBACK_LATE,
        Reason.FEEDBACK_MISSING,
        Reason.DEADMAN,
        Reason.TOO_OLD,
        Reason.CHALLENGE_UNKNOWN,
        Reason.LINK_TOO_SLOW,
        Reason.LEASE_EXPIRED,
        Reason.NOT_CONFIRMED,
        Reason.MOVING,
        Reason.NOT_ENGAGED,
        Reason.STOPPING,
    }
)
"""Reasons for which a robot is stopped, or not engaged, whose processes do not get the processor in time."""

RETRY_S: Final = 0.5
RECOVERY_S: Final = 60.0
"""For so long a robot that a busy machine stopped is engaged again and again."""

FIXED_S: Final = 17.0
"""The time of the stops, the reset and the stalled link, however long the demo is."""


class Interrupted(CommandError):  # noqa: N818 - it is named for what happened
    """Somebody ended the demo before its time."""

    def __init__(self) -> None:
        super().__init__("interrupted", ExitCode.PARTIAL)


class TimelineEntry(msgspec.Struct, frozen=True):
    """An event of the demo, and its time since the beginning.

    Attributes:
        who: the robot, or who did it.
    """

    at_s: float
    who: str
    what: str


class DemoDrive:
    """Drives the robot once through everything that the arbiter is for.

    Args:
        settings: of the robot and of Zenoh.
        endpoint: the gateway's, as HOST:PORT.
        type_line: types a line into the virtual chassis.
        link: the first operator's.
        stopped: the demo is to end.
    """

    def __init__(
        self,
        settings: Settings,
        endpoint: str,
        type_line: Callable[[str], None],
        link: LinkProfile,
        stopped: Callable[[], bool],
    ) -> None:
        self._link = link
        self._stopped = stopped
        self._settings = settings
        self._endpoint = endpoint
        self._type = type_line
        self._begin_ns = time.time_ns()
        self._told: deque[TimelineEntry] = deque()

    def observe(self) -> Robot:
        """Connect somebody who only watches.

        Raises:
            Unreachable: nothing is received from the robot.
        """
        return self._connect(OBSERVER, self._endpoint)

    def take(self, observer: Robot) -> list[TimelineEntry]:
        """Return the actions since the last call, and every event that the robot published, in order."""
        entries = [self._entry(event) for event in observer.events() if event.time_ns >= self._begin_ns]
        while self._told:
            entries.append(self._told.popleft())
        return sorted(entries, key=lambda entry: entry.at_s)

    def run(self, observer: Robot, seconds: float) -> None:
        """Drive.

        Raises:
            Interrupted: the demo is to end; the robot was stopped.
            CommandError: the robot does something that this script does not expect.
        """
        host, _, port = self._endpoint.rpartition(":")
        # Where that is in vain, engage says why.
        observer.wait_for(lambda state: self._stopped() or _waits_for_its_operator(state), GUARD_TIMEOUT_S)
        random = Random()  # noqa: S311 - the weather of a link keeps no secret
        try:
            with Relay(host, int(port), lambda: self._link.delay_s(random)) as relay:
                with self._connect(FIRST, relay.endpoint) as robot:
                    self._first(robot, relay, max(2.0, seconds - FIXED_S))
                with self._connect(SECOND, self._endpoint) as robot:
                    self._second(robot)
        except Interrupted:
            # The lease was given back, which stops the robot.
            self._rest(observer)
            raise
        self._rest(observer)
        # The last events, the lease's return among them, arrive before a state of half a second later.
        observer.wait_for(lambda state: not state.lease_holder, LEASE_TIMEOUT_S)
        tick = observer.state().state.tick
        observer.wait_for(lambda state: state.tick > tick + SETTLED_TICKS, STOPPED_TIMEOUT_S)

    def _first(self, robot: Robot, relay: Relay, seconds: float) -> None:
        """A figure of eight, a bumper hit, a deliberate reset, away from it, and then the link stalls."""
        is_stalled = False
        try:
            with robot.lease() as lease:
                self._engage(robot, lease)
                self._tell(FIRST, "drives a figure of eight")
                for angle_deg in (EIGHT_ANGLE_DEG, -EIGHT_ANGLE_DEG):
                    self._drive(robot, lease, (EIGHT_SPEED_MPS, angle_deg), seconds / 2)
                self._tell("chassis", "the front bumper is hit, and stays pressed")
                self._type("bumper front on")
                self._drive_until_stopped(lease, EIGHT_SPEED_MPS)
                self._rest(robot)
                self._pause(1.0)
                self._engage(robot, lease)
                self._tell(FIRST, "drives away from the hit side")
                self._drive(robot, lease, (-0.5, 0.0), 1.5)
                self._type("bumper front off")
                self._drive(robot, lease, (-0.5, 0.0), 0.5)
                self._tell("link", f"of {FIRST} stalls while the robot moves")
                is_stalled = True
                relay.stall()
                self._pause(STALL_S)
                self._tell("link", f"of {FIRST} carries again, all that waited at once")
                relay.resume()
                self._drive_until_stopped(lease, -0.5)
        except (RobotError, Unreachable) as error:
            self._tell(FIRST, f"is told: {error}")
            if not is_stalled and self._link is LINKS[0]:
                # A bad link may end the drive anywhere. A good one does not.
                raise

    def _second(self, robot: Robot) -> None:
        """Another operator takes over, drives a little and gives the robot back."""
        robot.wait_for(lambda state: not state.lease_holder, LEASE_TIMEOUT_S)
        with robot.lease() as lease:
            self._engage(robot, lease)
            self._tell(SECOND, "drives on")
            self._drive(robot, lease, (0.5, 0.0), 1.5)
            lease.disengage()
            self._rest(robot)

    def _engage(self, robot: Robot, lease: Lease) -> None:
        """Engage; where a busy machine stops the robot meanwhile, say so, reset what is latched, and try again."""
        end_s = time.monotonic() + RECOVERY_S
        while True:
            self._rest(robot)
            try:
                if robot.state().state.latched:
                    lease.reset()
                lease.engage(deadman_s=self._link.deadman_s)
                lease.unpark()
            except (Refused, Stopped) as error:
                if error.reason not in HELD_UP or time.monotonic() > end_s:
                    raise
                self._tell(robot.operator, f"is told: {error}; tries again")
                self._pause(RETRY_S)
            else:
                return

    def _drive(self, robot: Robot, lease: Lease, set_point: tuple[float, float], seconds: float) -> None:
        """Drive at this speed in m/s and angle in degrees; begin again where a busy machine stops the robot."""
        speed_mps, angle_deg = set_point
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            try:
                lease.drive(speed_mps, angle_deg=angle_deg)
            except Stopped as error:
                if error.reason not in HELD_UP:
                    raise
                left_s = end_s - time.monotonic()
                self._tell(robot.operator, f"is told: {error}; engages again")
                self._engage(robot, lease)
                end_s = time.monotonic() + left_s
            self._pause(RENEWED_S)

    def _drive_until_stopped(self, lease: Lease, speed_mps: float) -> None:
        """Keep driving until the robot rejects commands because of its front bumper. Raises other reasons."""
        end_s = time.monotonic() + STOPPED_TIMEOUT_S
        try:
            while time.monotonic() < end_s:
                lease.drive(speed_mps, angle_deg=0.0)
                self._pause(RENEWED_S)
        except RobotError as error:
            if error.reason is not Reason.FRONT_BUMPER:
                raise
            self._tell(FIRST, f"is told: {error}")
            return
        raise CommandError("the robot did not stop")

    def _pause(self, seconds: float) -> None:
        """Wait. Raises Interrupted as soon as the demo is to end."""
        end_s = time.monotonic() + seconds
        while not self._stopped() and (left_s := end_s - time.monotonic()) > 0:
            time.sleep(min(left_s, RENEWED_S))
        if self._stopped():
            raise Interrupted

    def _rest(self, robot: Robot) -> None:
        if not robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, STOPPED_TIMEOUT_S):
            raise CommandError("the robot did not come to rest")

    def _connect(self, operator: str, endpoint: str) -> Robot:
        # A client, so that everything goes through this endpoint and nothing around it.
        zenoh = msgspec.structs.replace(
            self._settings.zenoh, mode="client", connect=[f"tcp/{endpoint}"], given=("mode", "connect")
        )
        settings = msgspec.structs.replace(self._settings, zenoh=zenoh)
        return Robot.connect(self._settings.robot.name, operator, settings)

    def _tell(self, who: str, what: str) -> None:
        self._told.append(TimelineEntry((time.time_ns() - self._begin_ns) / 1e9, who, what))

    def _entry(self, event: SafetyEvent) -> TimelineEntry:
        return TimelineEntry((event.time_ns - self._begin_ns) / 1e9, "robot", event.text)


def _waits_for_its_operator(state: SafetyState) -> bool:
    """A guard watches, the robot was seen to stand, and nothing else bars engaging it; or something is latched."""
    return bool(state.latched) or (
        state.guarded and set(state.blocked_by) <= {Reason.NO_LEASE, Reason.NOT_ENGAGED}
    )

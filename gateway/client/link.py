"""The operator's link to a robot, and its stream of drive commands.

The library's thread receives what the robot publishes, sends drive commands, and renews the lease. The stream is
pure: set points with a hold time, the sequence, the echoed challenge.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from math import dist, isfinite
from numbers import Real
from typing import Final

import msgspec

from gateway.authority.session import UNSIGNED, Unmet
from gateway.choice.chassis import CHASSIS
from gateway.client.fleet import BY_REQUEST, CONTRADICTION, contradict, encode_request, read_reply, read_sample
from gateway.client.proof import Evidence, LinkProof
from gateway.client.refusal import Refused, Unreachable, refused
from gateway.client.remote_stop import Seen
from gateway.command.motion import steering_angle_deg
from gateway.telemetry.samples import Missed, Received
from gateway.zenoh.client import PendingQuery
from gateway.zenoh.operator import CommandPort, SafetyListener
from schemas.codec import PayloadFault
from schemas.command_line import CommandError
from schemas.decisions import COMMANDING, ArbiterState, LeaseReply, Reply, SafetyEvent, SafetyState, is_same_run
from schemas.messages import GatewayHealth, RobotState
from schemas.reasons import TEXTS, Reason
from schemas.requests import Acquire, Drive, Release, Renew, Request, Take

PERIOD_S: Final = 0.02  # the stream's period while the robot is engaged: 50 Hz
HOLD_S: Final = 0.5  # a set point holds for this long unless it is renewed
HOLD_MAX_S: Final = 2.0  # no set point holds for longer: a program that hangs shall not drive on
STALE_NS: Final = 1_000_000_000  # a command that echoes an older challenge would be refused, so it is not sent
SILENT_NS: Final = 1_000_000_000  # a robot is out of reach after this time without its safety/state


FOREIGN_NS: Final = 500_000_000  # commands of another sender reappear within this time, between ours
SENT_KEPT: Final = 128  # sent commands that are remembered, of 2.5 s


BEGAN_ANEW: Final = (
    "the robot's gateway was restarted and does not know the lease"  # its ticks are those of another run
)

GRANT_ENDS: Final = frozenset({Reason.GRANT_EXPIRED, Reason.GRANT_REVOKED})

ROUNDING: Final = 1e-6  # m/s and deg: no target that was asked for differs by less


class SetPoint(msgspec.Struct, frozen=True):
    """A requested motion: signed speed, and one of angle, curvature and yaw rate."""

    speed_mps: float = 0.0
    angle_deg: float | None = None
    curvature_1pm: float | None = None
    yaw_rate_radps: float | None = None

    def command(self, lease: int, seq: int, challenge: bytes, tick: int) -> Drive:
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
    """Why the robot no longer accepts drive commands."""

    reason: Reason
    detail: str = ""
    lease_lost: bool = False  # the lease is gone too; else the robot can be engaged again


class DriveStream:
    """The drive commands of one lease holder.

    A single state ends nothing, because it may be forged: the robot's own states would then contradict it.

    Attributes:
        is_shared: another sender commands under our lease, which must be released so that the robot stops.
        ending: why nothing is sent any more; None while all is well, or nothing was engaged.
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
        return self.ending is not None and self.ending.lease_lost

    @property
    def asks_for_zero(self) -> bool:
        """The requested speed is zero, or nothing is requested."""
        return self._set_point is None or not self._set_point.speed_mps

    def expect_engaged(self) -> None:
        """Prepare for an engage request, and drop the earlier set point."""
        self._is_wanted = self._is_asked = True
        self.engaged = False
        self._set_point = None
        self._sent.clear()
        self._stop.clear()
        if not self.is_lost:
            self.ending = None

    def give_up(self) -> None:
        """Send nothing more, because the program disengages or releases."""
        self._is_wanted = self._is_asked = self.engaged = False
        self._set_point = None

    def aim(self, set_point: SetPoint, hold_s: float, now_ns: int) -> None:
        """Set the requested motion."""
        # The robot would refuse each command, and a stop by the deadman would look like a fault of the network.
        given = msgspec.structs.asdict(set_point).items()
        set_point = SetPoint(
            **{name: _finite(name, value) for name, value in given if value is not None or name == "speed_mps"}
        )
        if not 0 < hold_s <= HOLD_MAX_S:
            raise ValueError(f"hold_s must be above 0 and at most {HOLD_MAX_S:g} s")
        angle_deg = steering_angle_deg(set_point.command(0, 0, b"", 0), CHASSIS.wheelbase_m)
        if isinstance(angle_deg, str):
            raise ValueError(angle_deg)  # noqa: TRY004 - it is the value that is wrong
        self._set_point = set_point
        self._until_ns = now_ns + round(hold_s * 1e9)
        self._note = ""

    def see(self, state: SafetyState, now_ns: int) -> None:
        self._state, self._seen_ns = state, now_ns
        if state.lease_holder == self._operator:
            self._was_holder = True
            self._held_tick = state.tick
            self._loss.clear()
            if self._is_foreign(state) and self._foreign.add(now_ns) and not self.is_lost:
                self.is_shared = True
                self.lose(Reason.LEASE_TAKEN, "the robot executes commands that this program did not send")
        elif self._was_holder and self._loss.add(now_ns):
            if state.lease_holder:
                self.lose(Reason.LEASE_TAKEN, f"by {state.lease_holder}")
            elif self._is_of_other_run(state):
                self.lose(Reason.NO_LEASE)
            else:
                self.lose(state.stop_reason if state.stop_reason in GRANT_ENDS else Reason.LEASE_EXPIRED)
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
        if reason is Reason.NO_LEASE and self._state is not None and self._is_of_other_run(self._state):
            detail = BEGAN_ANEW
        if not self.is_lost:
            self._end(DriveEnd(reason, detail, lease_lost=True))

    def command(self, now_ns: int) -> Drive | None:
        """Return the drive command to send now, if any."""
        state = self._state
        if state is None or not self.is_wanted or now_ns - self._seen_ns > STALE_NS:
            return None
        return self._next(self._in_force(state, now_ns), state)

    def _next(self, set_point: SetPoint, state: SafetyState) -> Drive:
        self._sequence += 1
        drive = set_point.command(self.lease, self._sequence, state.challenge, state.tick)
        angle_deg = steering_angle_deg(drive, CHASSIS.wheelbase_m)
        if self.engaged and isinstance(angle_deg, float):
            self._sent[drive.seq] = drive.speed_mps, angle_deg
            self._sent.pop(drive.seq - SENT_KEPT, None)
        return drive

    def take_note(self) -> str:
        """Return a note for the program, once; empty if there is none."""
        note, self._note = self._note, ""
        return note

    def _is_of_other_run(self, state: SafetyState) -> bool:
        """The state is from another run of the gateway than the one that granted the lease."""
        return self._was_holder and not is_same_run(state.tick, self._held_tick)

    def _is_foreign(self, state: SafetyState) -> bool:
        """The last accepted command of our lease was not ours: never sent, or with another target."""
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
        angle_deg = steering_angle_deg(wanted.command(0, 0, b"", 0), CHASSIS.wheelbase_m)
        self._set_point = SetPoint(0.0, angle_deg=angle_deg if isinstance(angle_deg, float) else 0.0)
        self._note = "the set point was not renewed in time: zero speed"
        return self._set_point

    def _end(self, ending: DriveEnd) -> None:
        self.ending = ending
        self._is_wanted = self._is_asked = self.engaged = False
        self._set_point = None


class RelayStream(DriveStream):
    """The drive commands that somebody else gives: each is sent once, when it comes, and nothing in between.

    So the robot's deadman watches the one who gives them, and not this program.
    """

    def command(self, now_ns: int) -> Drive | None:  # noqa: ARG002 - nothing is sent by the clock
        return None

    def relay(self, set_point: SetPoint, now_ns: int) -> Drive | None:
        """The drive command for a set point that came just now; None if the robot is not engaged for us."""
        state = self._state
        if state is None or not self.is_wanted or now_ns - self._seen_ns > STALE_NS:
            return None
        return self._next(set_point, state)


def _finite(name: str, value: object) -> float:
    """Return any library's number as a float; refuse booleans and text."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name} must be a number, and is {value!r}")
    number = float(value)
    if not isfinite(number):
        raise ValueError(f"{name} must be a finite number, and is {number}")
    return number


log = logging.getLogger(__name__)

RENEWALS: Final = 4  # a lease is renewed this many times before it would expire
EVENTS_KEPT: Final = 2000

SEEN_KEPT: Final = 1024  # samples that wait for ``look``
AGAIN_S: Final = 0.02  # pause before a lease request is repeated to a robot that answers too many requests

_S: Final = 1_000_000_000


class Unanswered(Unreachable):
    """A request without a reply."""


class Sighting(msgspec.Struct, frozen=True):
    """The newest state of a robot.

    Attributes:
        state: the arbiter's state.
        age_s: time since it was received.
        chassis: the chassis's state; None if it is older than a second.
        health: the gateway's last health; None before the first.
    """

    state: SafetyState
    age_s: float
    chassis: RobotState | None
    health: GatewayHealth | None = None


class RobotLink:
    """The samples of a robot, and the commands to it.

    Attributes:
        heard: lock of everything here, notified at each arrival.
        unreadable: why the newest unreadable sample could not be read; empty if all could.
    """

    def __init__(
        self, commands: CommandPort, listener: SafetyListener, robot: str, proof: LinkProof | None = None
    ) -> None:
        self.robot = robot
        self.commands = commands
        self.commands.prover = proof
        self._proof = proof
        self.heard = threading.Condition(threading.RLock())
        self.unreadable = ""
        self._listener = listener
        self._state: SafetyState | None = None
        self._state_ns = 0
        self._chassis: RobotState | None = None
        self._chassis_ns = 0
        self._health: GatewayHealth | None = None
        self._seen: list[Seen | Missed] = []
        self._events: deque[SafetyEvent] = deque(maxlen=EVENTS_KEPT)
        self._stream: DriveStream | None = None
        self._renewal: PendingQuery | None = None
        self._renewed: list[Reply] = []
        self._release: PendingQuery | None = None
        self._renew_every_ns = 0
        self._renew_ns = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"robot-{robot}", daemon=True)
        self._thread.start()

    @property
    def is_heard(self) -> bool:
        with self.heard:
            return self._state is not None and time.monotonic_ns() - self._state_ns <= SILENT_NS

    @property
    def hears_chassis(self) -> bool:
        """A chassis state arrived lately, with or without an arbiter."""
        with self.heard:
            return self._chassis is not None and time.monotonic_ns() - self._chassis_ns <= SILENT_NS

    @property
    def has_stream(self) -> bool:
        with self.heard:
            return self._stream is not None

    def sighting(self) -> Sighting:
        with self.heard:
            now_ns = time.monotonic_ns()
            if self._state is None or now_ns - self._state_ns > SILENT_NS:
                for_s = f", for {(now_ns - self._state_ns) / _S:.1f} s" if self._state is not None else ""
                raise Unreachable(f"no state from {self.robot}{for_s}")
            chassis = self._chassis if self.hears_chassis else None
            return Sighting(self._state, (now_ns - self._state_ns) / _S, chassis, self._health)

    def look(self) -> list[Seen | Missed]:
        """Return all states since the last call, so that a forged one hides none of the robot's own."""
        with self.heard:
            seen, self._seen = self._seen, []
            return seen

    def take_events(self) -> list[SafetyEvent]:
        with self.heard:
            events = list(self._events)
            self._events.clear()
            return events

    def wait_for(self, condition: Callable[[SafetyState], bool], timeout_s: float) -> bool:
        """Wait until the robot's newest state meets the condition; False after the timeout."""
        with self.heard:
            return self.heard.wait_for(lambda: self._state is not None and condition(self._state), timeout_s)

    def ask(self, request: Request, timeout_s: float) -> Reply:
        """Send a request, and wait for the reply. Lease requests are repeated while the robot is busy."""
        deadline_s = time.monotonic() + timeout_s
        if self._proof is not None and isinstance(request, Acquire | Take):
            while (left_s := deadline_s - time.monotonic()) > AGAIN_S and self.is_heard:
                try:
                    return self._ask_known(request, left_s)
                except Refused as refusal:
                    if refusal.reason is not Reason.BUSY:
                        raise
                except Unanswered:
                    log.debug("%s did not answer a lease request", self.robot)
                time.sleep(AGAIN_S)
        return self._ask_known(request, max(AGAIN_S, deadline_s - time.monotonic()))

    def _ask_known(self, request: Request, timeout_s: float) -> Reply:
        try:
            return self._ask(request, timeout_s)
        except Refused as refusal:
            if self._proof is None or refusal.reason is not Reason.GRANT_UNKNOWN:
                raise
            # It was restarted, or has met many others since.
            self.meet()
            return self._ask(request, timeout_s)

    def meet(self) -> Unmet | None:
        """Send the robot the operator's grant. Returns why it is not accepted or verified; None if it is."""
        if self._proof is None or self._proof.meet(self.commands) is None:
            return None
        return self._proof.unmet

    def doubt(self, robot: str) -> Unmet:
        return UNSIGNED if self._proof is None else self._proof.doubt(robot)

    def _ask(self, request: Request, timeout_s: float) -> Reply:
        command, proof = BY_REQUEST[type(request)], self._proof
        if proof is not None:
            request = proof.with_key(request)
        received = self.commands.ask(command.verb, encode_request(request), timeout_s)
        if not received:
            raise Unanswered(f"{self.robot} did not answer {command.verb}")
        replies = [read_reply(command, one) for one in received]
        reply = replies[0]
        if contradict(replies):
            raise Unreachable(f"{self.robot}: {command.verb}: {CONTRADICTION}")
        if isinstance(reply, PayloadFault):
            raise Unreachable(f"{self.robot}: {command.verb}: {reply.detail}")
        if not reply.ok:
            raise refused(self.robot, command.verb, reply, self.commands.operator)
        if proof is None or not isinstance(reply, LeaseReply) or proof.begin_lease(reply, received[0].attachment):
            return reply
        raise Unreachable(f"{self.robot}: {command.verb}: the reply has no key for the lease")

    def begin_stream(self, stream: DriveStream, expires_s: float) -> None:
        """Renew the lease and send drive commands from now on."""
        with self.heard:
            self._stream = stream
            self._renewal = None
            self._renewed = []
            self._release = None
            self._renew_every_ns = round(expires_s / RENEWALS * _S)
            self._renew_ns = time.monotonic_ns() + self._renew_every_ns

    def end_stream(self) -> None:
        with self.heard:
            self._stream = None

    def relay(self, stream: RelayStream, set_point: SetPoint) -> bool:
        """Send a drive command at once, with the newest challenge. Returns False if the robot is not engaged."""
        with self.heard:
            self._listen()
            drive = stream.relay(set_point, time.monotonic_ns())
            if drive is not None:
                self.commands.put("drive", encode_request(drive))
            return drive is not None

    def close(self) -> None:
        """Close the link, and end a stream."""
        self._closing.set()
        self._thread.join()
        self.commands.close()
        self._listener.close()

    # On the thread.

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._closing.wait(max(0.0, due_s - time.monotonic())):
            due_s = max(due_s + PERIOD_S, time.monotonic())
            with self.heard:
                self._listen()
                if self._stream is not None:
                    self._say(self._stream, time.monotonic_ns())

    def _listen(self) -> None:
        received = list(self._listener.drain())
        for one in received:
            if isinstance(one, Missed):
                self._seen = [one]
            elif self._proof is not None and not self._proof.believes(one):
                self.unreadable = f"{one.key} is not signed by the robot, or is a repeat"
            else:
                self._hear(one, time.monotonic_ns())
        if self._proof is not None:
            self._proof.meet_again(self.commands)
        if received:
            self.heard.notify_all()

    def _hear(self, received: Received, now_ns: int) -> None:
        sample = read_sample(received)
        if sample is None:
            return
        match message := sample.message:
            case SafetyState():
                self._state, self._state_ns = message, now_ns
                if self._proof is not None:
                    self._proof.challenge = message.challenge
                self._keep((now_ns, self.robot, message))
                if self._stream is not None:
                    self._stream.see(message, now_ns)
            case SafetyEvent():
                self._events.append(message)
            case RobotState():
                self._chassis, self._chassis_ns = message, now_ns
                self._keep((now_ns, self.robot, message))
            case GatewayHealth():
                self._health = message
            case PayloadFault(detail):
                self.unreadable = detail

    def _keep(self, seen: Seen) -> None:
        if len(self._seen) >= SEEN_KEPT:
            self._seen = [Missed()]
        self._seen.append(seen)

    def _say(self, stream: DriveStream, now_ns: int) -> None:
        drive = stream.command(now_ns)
        if drive is not None:
            self.commands.put("drive", encode_request(drive))
        if stream.is_wanted:
            self._renew_ns = now_ns + self._renew_every_ns
        elif stream.is_shared:
            self._revoke(stream, now_ns)
        else:
            self._renew(stream, now_ns)
        note = stream.take_note()
        if note:
            log.warning("%s: %s", self.robot, note)

    def _revoke(self, stream: DriveStream, now_ns: int) -> None:
        """Release a lease under which another sender commands, until the robot stops."""
        if self._release is not None and now_ns < self._renew_ns:
            return
        self._renew_ns = now_ns + self._renew_every_ns
        self._release = self._begin(Release(lease=stream.lease)) or self._release

    def _renew(self, stream: DriveStream, now_ns: int) -> None:
        """Renew the lease by a query whose replies are read in later rounds: the stream never waits."""
        is_due = now_ns >= self._renew_ns
        if self._renewal is not None:
            replies = (read_reply(BY_REQUEST[Renew], received) for received in self._renewal.poll())
            self._renewed += [reply for reply in replies if isinstance(reply, Reply)]
            if self._renewed and (is_due or self._renewal.is_over):
                if not any(reply.ok for reply in self._renewed):
                    stream.lose(self._renewed[0].reason)
                self._renewal, self._renewed = None, []
        if not is_due or stream.is_lost:
            return
        self._renew_ns = now_ns + self._renew_every_ns
        self._renewal = self._begin(Renew(lease=stream.lease)) or self._renewal

    def _begin(self, request: Release | Renew) -> PendingQuery | None:
        verb = BY_REQUEST[type(request)].verb
        try:
            return self.commands.begin(verb, encode_request(request), self._renew_every_ns / _S)
        except CommandError as error:
            log.debug("%s: %s: %s", self.robot, verb, error)
            return None

"""The library's own thread: hears a robot, keeps the stream of drive commands going, renews the lease."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final

import msgspec

from gateway.authority.unmet import UNSIGNED, Unmet
from gateway.client.drive_stream import PERIOD_S, SILENT_NS, DriveStream
from gateway.client.link_proof import LinkProof
from gateway.client.payloads import (
    BY_REQUEST,
    CONTRADICTION,
    NewerWords,
    contradict,
    encode_request,
    read_reply,
    read_sample,
)
from gateway.client.refusal import Refused, Unreachable, refused
from gateway.client.remote_stop import Seen
from gateway.telemetry.received import Missed, Received
from gateway.zenoh.client import PendingQuery
from gateway.zenoh.operator import CommandPort, SafetyListener
from schemas.codec import PayloadFault
from schemas.command_line import CommandError, plain
from schemas.decisions import LeaseReply, Reply, SafetyEvent, SafetyState
from schemas.messages import GatewayHealth, RobotState
from schemas.reasons import Reason
from schemas.requests import Acquire, Release, Renew, Request, Take

log = logging.getLogger(__name__)

RENEWALS: Final = 4
"""A lease is renewed this many times before it would expire."""

EVENTS_KEPT: Final = 2000

SEEN_KEPT: Final = 1024
"""So many samples wait for ``look``."""

AGAIN_S: Final = 0.02
"""Pause before a request for a lease is sent again to a robot that too many ask: its door has no time for all."""

_S: Final = 1_000_000_000


class Unanswered(Unreachable):
    """Nobody answered a request."""


class Sighting(msgspec.Struct, frozen=True):
    """The newest that was heard of the robot.

    Attributes:
        state: what its arbiter says.
        age_s: time since it was heard.
        chassis: what its chassis does; None if that was not heard lately.
        health: how its gateway was when it last said so; None if it has not.
    """

    state: SafetyState
    age_s: float
    chassis: RobotState | None
    health: GatewayHealth | None = None


class RobotLink:
    """A robot's link: what is heard of it, and what is sent to it.

    Attributes:
        robot: its name.
        commands: the session for commands.
        heard: the lock of everything here, notified when something was heard.
        unreadable: why the last sample that could not be read could not; empty if all could.
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
        self._newer = NewerWords()
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
        """Its safety/state was heard lately."""
        with self.heard:
            return self._state is not None and time.monotonic_ns() - self._state_ns <= SILENT_NS

    @property
    def hears_chassis(self) -> bool:
        """Its state was heard lately, whether it has an arbiter or not."""
        with self.heard:
            return self._chassis is not None and time.monotonic_ns() - self._chassis_ns <= SILENT_NS

    @property
    def has_stream(self) -> bool:
        """A lease is held."""
        with self.heard:
            return self._stream is not None

    def sighting(self) -> Sighting:
        """The newest that was heard.

        Raises:
            Unreachable: nothing was, for a second.
        """
        with self.heard:
            now_ns = time.monotonic_ns()
            if self._state is None or now_ns - self._state_ns > SILENT_NS:
                for_s = f", for {(now_ns - self._state_ns) / _S:.1f} s" if self._state is not None else ""
                raise Unreachable(f"{self.robot} is not heard any more{for_s}")
            chassis = self._chassis if self.hears_chassis else None
            return Sighting(self._state, (now_ns - self._state_ns) / _S, chassis, self._health)

    def look(self) -> list[Seen | Missed]:
        """Every state that was heard since the last call: a forged one hides none of the robot's own."""
        with self.heard:
            seen, self._seen = self._seen, []
            return seen

    def take_events(self) -> list[SafetyEvent]:
        """The events that were heard since the last call."""
        with self.heard:
            events = list(self._events)
            self._events.clear()
            return events

    def wait_for(self, condition: Callable[[SafetyState], bool], timeout_s: float) -> bool:
        """Wait until the robot's newest state is so. False if it never was in time."""
        with self.heard:
            return self.heard.wait_for(lambda: self._state is not None and condition(self._state), timeout_s)

    def ask(self, request: Request, timeout_s: float) -> Reply:
        """Ask, and wait for the reply. For a lease a robot that is asked too much is asked again.

        Raises:
            Refused: it is a refusal.
            Unreachable: there is none, it cannot be read, or there are several that contradict each other.
        """
        deadline_s = time.monotonic() + timeout_s
        if self._proof is not None and isinstance(request, Acquire | Take):
            while (left_s := deadline_s - time.monotonic()) > AGAIN_S and self.is_heard:
                try:
                    return self._ask_known(request, left_s)
                except Refused as refusal:
                    if refusal.reason is not Reason.BUSY:
                        raise
                except Unanswered:
                    log.debug("%s left a request for its lease unanswered", self.robot)
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
        """Show the robot the operator's grant. Returns why it is not met, or does not take it; None if it does."""
        if self._proof is None or self._proof.meet(self.commands) is None:
            return None
        return self._proof.unmet

    def doubt(self, robot: str) -> Unmet:
        """The reason for which an answer of this robot cannot be verified."""
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
        """A lease is held from now on: keep it."""
        with self.heard:
            self._stream = stream
            self._renewal = None
            self._renewed = []
            self._release = None
            self._renew_every_ns = round(expires_s / RENEWALS * _S)
            self._renew_ns = time.monotonic_ns() + self._renew_every_ns

    def end_stream(self) -> None:
        """No lease is held any more."""
        with self.heard:
            self._stream = None

    def close(self) -> None:
        """Leave. A stream that is going on ends."""
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
                self.unreadable = f"{one.key} is not signed by the robot, or was published before"
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
        if sample.unknown and self._newer.note(sample.unknown):
            log.warning("%s: %s", self.robot, plain(self._newer.text))
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
        """Give back a lease under which somebody else commands, again and again: the robot stops."""
        if self._release is not None and now_ns < self._renew_ns:
            return
        self._renew_ns = now_ns + self._renew_every_ns
        self._release = self._begin(Release(lease=stream.lease)) or self._release

    def _renew(self, stream: DriveStream, now_ns: int) -> None:
        """Renew the lease by a query, whose replies are looked at in later rounds: the stream never waits."""
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

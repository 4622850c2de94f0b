"""An operator behind a bad link, with the library's own drive stream, in simulated time.

It does what ``Lease`` does on its thread, for a program that drives whenever it may.
"""

from __future__ import annotations

from collections import deque
from random import Random
from statistics import median
from typing import Any

import msgspec

from gateway.client.fleet import encode_request
from gateway.client.link import PERIOD_S, DriveEnd, DriveStream, SetPoint
from schemas.decisions import ArbiterState, EventKind, LeaseReply, Reply, SafetyState
from schemas.reasons import Reason
from schemas.requests import Acquire, Engage, Renew, Request, Unpark
from tests.support.links import LinkProfile
from tests.support.rigs.gateway import GatewayRig

NAME = "far"
PERIOD_NS = round(PERIOD_S * 1e9)
RENEW_NS = 500_000_000
ANSWER_NS = 3_000_000_000
VERBS: dict[type[Request], str] = {Acquire: "acquire", Engage: "engage", Renew: "renew", Unpark: "unpark"}


class LossyLink:
    """Both directions of a link; messages under way keep their delay when ``profile`` changes."""

    def __init__(self, profile: LinkProfile, seed: int) -> None:
        self.is_cut = False
        self.profile = profile
        self.random = Random(seed)  # noqa: S311 - the same link each time
        self._stall_ends_ns = 0
        self._stalls_ns = self._next_stall_ns(0)
        self.up, self.down = Direction(self), Direction(self)

    def is_stalled(self, now_ns: int) -> bool:
        if now_ns >= self._stalls_ns:
            self._stall_ends_ns = self._stalls_ns + round(self.profile.stall_s * 1e9)
            self._stalls_ns = self._next_stall_ns(self._stall_ends_ns)
        return self.is_cut or now_ns < self._stall_ends_ns

    def _next_stall_ns(self, from_ns: int) -> int:
        every_s = self.profile.stall_every_s
        return from_ns + round(self.random.expovariate(1 / every_s) * 1e9) if every_s else 2**63


class Direction:
    """One direction of a link, in order."""

    def __init__(self, link: LossyLink) -> None:
        self._link = link
        self._waiting: deque[tuple[int, Any]] = deque()
        self._last_ns = 0

    def send(self, message: object, now_ns: int) -> None:
        delay_s = self._link.profile.delay_s(self._link.random)
        self._last_ns = max(self._last_ns, now_ns + round(delay_s * 1e9))
        self._waiting.append((self._last_ns, message))

    def receive(self, now_ns: int) -> list[Any]:
        arrived: list[Any] = []
        if not self._link.is_stalled(now_ns):
            while self._waiting and self._waiting[0][0] <= now_ns:
                arrived.append(self._waiting.popleft()[1])
        return arrived


class Trip(msgspec.Struct, frozen=True):
    """A drive over a link.

    Attributes:
        moving: share of the time at the speed that the travel delay allowed.
        after_cut_m: metres driven after the link was cut.
    """

    moving: float
    stops_per_min: float
    reached_mps: float
    after_cut_m: float
    stops: list[Reason]


class FarOperator:
    """Drives at a speed, and engages again after each stop."""

    def __init__(self, rig: GatewayRig, link: LossyLink, speed_mps: float, deadman_s: float | None = None) -> None:
        self.endings: list[DriveEnd] = []
        self._rig = rig
        self._link = link
        self._set_point = SetPoint(speed_mps, angle_deg=0.0)
        self._deadman_s = deadman_s
        self._stream: DriveStream | None = None
        self._state: SafetyState | None = None
        self._asked: tuple[type[Request], int] | None = None
        self._handles: dict[int, type[Request]] = {}
        self._is_unparked = False
        self._renew_ns = self._due_ns = 0
        self._published = 0

    def run(self, seconds: float) -> None:
        """Let time pass at the robot and here."""
        for _ in range(round(seconds * 100)):
            self._rig.tick()
            self._exchange(self._rig.now_ns)
            if self._rig.now_ns >= self._due_ns:
                self._due_ns = self._rig.now_ns + PERIOD_NS
                self._act(self._rig.now_ns)

    def _exchange(self, now_ns: int) -> None:
        """The robot's side: receive and send."""
        rig = self._rig
        for verb, kind, payload in self._link.up.receive(now_ns):
            if kind is None:
                rig.put(NAME, verb, payload)
            else:
                self._handles[rig.query(NAME, verb, payload)] = kind
        for handle in list(self._handles):
            if handle in rig.replies:
                self._link.down.send((self._handles.pop(handle), rig.replies.pop(handle)), now_ns)
        if len(rig.published) > self._published:
            self._published = len(rig.published)
            self._link.down.send(rig.says, now_ns)

    def _act(self, now_ns: int) -> None:
        """The operator's side: receive and send."""
        for message in self._link.down.receive(now_ns):
            if isinstance(message, SafetyState):
                self._state = message
                if self._stream is not None:
                    self._stream.see(message, now_ns)
            else:
                self._answered(message[0], message[1], now_ns)
        self._go_on(now_ns)
        drive = self._stream.command(now_ns) if self._stream is not None else None
        if drive is not None:
            self._link.up.send(("drive", None, encode_request(drive)), now_ns)

    def _go_on(self, now_ns: int) -> None:
        stream, state = self._stream, self._state
        if state is None:
            return
        if stream is not None and stream.ending is not None:
            self.endings.append(stream.ending)
            self._stream = stream = None if stream.is_lost else stream
            if stream is not None:
                stream.ending = None
        if stream is not None and not stream.is_wanted and now_ns >= self._renew_ns:
            self._renew_ns = now_ns + RENEW_NS
            self._send(Renew(stream.lease), now_ns)
        if self._asked is not None and now_ns - self._asked[1] < ANSWER_NS:
            return
        if stream is None:
            self._ask(Acquire(), now_ns)
        elif not stream.is_wanted and state.state is ArbiterState.STANDBY:
            stream.expect_engaged()
            self._is_unparked = False
            self._ask(Engage(stream.lease, state.challenge, deadman_s=self._deadman_s), now_ns)
        elif stream.engaged and not self._is_unparked:
            self._ask(Unpark(stream.lease), now_ns)
        elif stream.engaged:
            stream.aim(self._set_point, 0.5, now_ns)

    def _ask(self, request: Request, now_ns: int) -> None:
        self._asked = type(request), now_ns
        self._send(request, now_ns)

    def _send(self, request: Request, now_ns: int) -> None:
        kind = type(request)
        self._link.up.send((VERBS[kind], kind, encode_request(request)), now_ns)

    def _answered(self, kind: type[Request], reply: Reply, now_ns: int) -> None:
        if self._asked is None or self._asked[0] is not kind:
            return
        self._asked = None
        if isinstance(reply, LeaseReply) and kind is Acquire and reply.ok:
            self._stream = DriveStream(reply.lease, NAME)
        elif kind is Unpark:
            self._is_unparked = reply.ok
        elif kind is Engage and not reply.ok and self._stream is not None:
            self._stream.give_up()
            self._renew_ns = now_ns


def trip(profile: LinkProfile, speed_mps: float, seconds: float) -> Trip:
    """Drive over a link for a time, then cut it."""
    rig, link = GatewayRig(), LossyLink(profile, 1)
    operator = FarOperator(rig, link, speed_mps, profile.deadman_s)
    operator.run(10)
    begun, speeds_mps, good = len(rig.events), deque[float](), 0
    for _ in range(round(seconds * 100)):
        operator.run(0.01)
        speeds_mps.append(abs(rig.speed_mps))
        allowed_mps = min(speed_mps, rig.says.travel_speed_limit_mps or speed_mps)
        good += abs(rig.speed_mps) >= 0.9 * allowed_mps
    stops = [event.reason for event in rig.events[begun:] if event.kind is EventKind.STOP]
    link.is_cut, at_m = True, rig.chassis.state.mileage_m
    operator.run(5)
    return Trip(
        good / len(speeds_mps),
        len(stops) * 60 / seconds,
        median(speeds_mps),
        rig.chassis.state.mileage_m - at_m,
        stops,
    )

"""The newest of each robot, and its age. Pure: samples go in, reports come out.

A report never gives an old value as a present one: a state or a health that is too old is not in it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, TypeVar

import msgspec

from gateway.client.payloads import NewerWords, SampleRead, read_sample
from gateway.telemetry.received import Arrival, Missed, TokenChange
from schemas import keys
from schemas.codec import PayloadFault
from schemas.command_line import plain
from schemas.decisions import SafetyState
from schemas.messages import GatewayHealth, Message, RobotState
from schemas.recording import RecorderHealth

STATE_STALE_NS: Final = 1_000_000_000
"""A state, due every 50 ms, is no longer shown after 1 s."""

HEALTH_STALE_NS: Final = 3_500_000_000
"""A health, due every second, is no longer shown after 3.5 s: two may be lost."""

STALE_NS: Final[dict[type[Message], int]] = {
    GatewayHealth: HEALTH_STALE_NS,
    SafetyState: STATE_STALE_NS,
    RobotState: STATE_STALE_NS,
    RecorderHealth: HEALTH_STALE_NS,
}
"""The messages of which the newest is stored, and the age from which it is no longer shown."""

M = TypeVar("M", bound=Message)


class Bounds(msgspec.Struct, frozen=True):
    """Limits of what is stored of a fleet. Any client can publish any number of names, and samples of any size.

    Attributes:
        robots, recorders: at most so many; those that came first stay.
        name_length: a longer name counts as one too many.
        sample_bytes: a larger sample is ignored.
        forgotten_ns: a robot that is silent for so long, and has no token, may be forgotten.
    """

    robots: int = 10_000
    recorders: int = 0
    name_length: int = keys.KEY_MAX_LENGTH
    sample_bytes: int = 1 << 20
    forgotten_ns: int = 60_000_000_000


class RobotStatus(msgspec.Struct, frozen=True):
    """A robot at one moment.

    Attributes:
        connected: its liveliness token is there. That is no proof of health.
        state: the last state; null if it is too old, or if there was none.
        state_age_s: time since the last state arrived; null if there was none.
        health: the last health, with the same rule.
        unreadable: why the last sample that could not be read could not; empty if all could.
        linked: this end is connected to Zenoh.
        newer: what a newer version says and this one does not know; empty if nothing.
        safety: the last of the arbiter's states, with the same rule; null where there is no arbiter.
    """

    robot: str
    connected: bool
    state: RobotState | None
    state_age_s: float | None
    health: GatewayHealth | None
    health_age_s: float | None
    unreadable: str
    linked: bool
    safety: SafetyState | None = None
    newer: str = ""


def alarm(report: RobotStatus) -> str:
    """Return why nothing of the robot's state can be shown; empty if it can."""
    if report.state is not None:
        return ""
    reasons = []
    if not report.linked:
        reasons.append("this end is not connected to Zenoh")
    elif not report.connected:
        reasons.append("its gateway is not connected")
    elif report.health is None:
        reasons.append("its gateway is connected, but sends no health")
    else:
        reasons.append("its gateway is connected and sends health")
    if report.unreadable:
        reasons.append(f"unreadable: {plain(report.unreadable)}")
    what = "no state yet" if report.state_age_s is None else f"no contact for {_duration(report.state_age_s)}"
    return f"{what}; {', '.join(reasons)}"


def _duration(seconds: float) -> str:
    """A time as coarse as it is of use."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"


class Source:
    """The last samples of a robot or a recorder.

    Attributes:
        connected: its liveliness token is there.
        heard_ns: when anything of it arrived last.
        unreadable: why the last sample could not be read; empty if it could.
        newer: what a newer version says and this one does not know.
    """

    def __init__(self) -> None:
        self.connected = False
        self.heard_ns = 0
        self.unreadable = ""
        self.newer = NewerWords()
        self._newest: dict[type[Message], tuple[Message, int]] = {}

    def receive(self, sample: SampleRead, now_ns: int) -> None:
        """Store a message; one that cannot be read changes no value."""
        message = sample.message
        self.newer.note(sample.unknown)
        if isinstance(message, PayloadFault):
            self.unreadable = message.detail
            return
        self.unreadable = ""
        self._newest[type(message)] = message, now_ns

    def fresh(self, kind: type[M], now_ns: int) -> M | None:
        """Return the newest message of a class; None if it is too old, or there was none."""
        message, at_ns = self._newest.get(kind, (None, 0))
        return message if isinstance(message, kind) and now_ns - at_ns < STALE_NS[kind] else None

    def age_s(self, kind: type[Message], now_ns: int) -> float | None:
        """Return the time since the last message of a class; None if there was none."""
        return (now_ns - self._newest[kind][1]) / 1e9 if kind in self._newest else None


class Sources:
    """All robots, or all recorders.

    Attributes:
        refused: how often a name was one too many.
    """

    def __init__(self, most: int, bounds: Bounds) -> None:
        self.refused = 0
        self._most = most
        self._bounds = bounds
        self._refused_before = 0
        self._known: dict[str, Source] = {}

    def __getitem__(self, name: str) -> Source:
        """Return the source of a name; of an unknown one nothing is known."""
        return self._known.get(name) or Source()

    def find(self, name: str, now_ns: int) -> Source | None:
        """Return the source of a name that is heard now; None if there are too many."""
        source = self._known.get(name)
        if source is None:
            if len(self._known) >= self._most or len(name) > self._bounds.name_length:
                self.refused += 1
                return None
            source = self._known[name] = Source()
        source.heard_ns = now_ns
        return source

    def names(self, now_ns: int, forgets: Callable[[str], object] = lambda _name: False) -> list[str]:
        """Return the names of those that are there or were there, as people order them.

        Args:
            now_ns: the time.
            forgets: asked of each that may be forgotten. One that is lost stays until somebody has seen it, or
                until another was refused.
        """
        is_full, self._refused_before = self.refused > self._refused_before, self.refused
        self._known = {
            name: source
            for name, source in self._known.items()
            if source.connected
            or now_ns - source.heard_ns < self._bounds.forgotten_ns
            or not (is_full or forgets(name))
        }
        return sorted(self._known, key=keys.in_order)


class Fleet:
    """All robots and recorders under a root.

    Attributes:
        linked: this end is connected to Zenoh. Without a link no token says anything.
    """

    def __init__(self, root: str, bounds: Bounds = Bounds()) -> None:  # noqa: B008 - it is frozen
        self.linked = True
        self.robots = Sources(bounds.robots, bounds)
        self.recorders = Sources(bounds.recorders, bounds)
        self._root = root
        self._sample_bytes = bounds.sample_bytes

    def receive(self, heard: Arrival, now_ns: int) -> SampleRead | None:
        """Store a sample or a change of a token, and return the sample that was read. Others are ignored."""
        if isinstance(heard, Missed):
            return None  # A newer sample comes soon.
        if isinstance(heard, TokenChange):
            if (source := self.find(heard.key, now_ns)) is not None:
                source.connected = heard.present
            return None
        sample = None if len(heard.payload) > self._sample_bytes else read_sample(heard)
        if sample is None or sample.parts.subject.type not in STALE_NS:
            return None
        if (source := self.find(heard.key, now_ns)) is None:
            return None
        source.receive(sample, now_ns)
        return sample

    def find(self, key: str, now_ns: int) -> Source | None:
        """Return the robot or recorder that publishes a key; None if none does, or there are too many."""
        parts = keys.parse(key)
        if parts is None:
            robot = keys.robot_of_liveliness(self._root, key)
            return None if robot is None else self.robots.find(robot, now_ns)
        if parts.root != self._root:
            return None
        return (
            self.recorders.find(parts.recorder, now_ns)
            if parts.recorder
            else self.robots.find(parts.robot, now_ns)
        )

    def report(self, robot: str, now_ns: int) -> RobotStatus:
        """A robot at this moment; one that was never heard of has an empty report."""
        known = self.robots[robot]
        return RobotStatus(
            robot=robot,
            connected=known.connected and self.linked,
            state=known.fresh(RobotState, now_ns),
            state_age_s=known.age_s(RobotState, now_ns),
            safety=known.fresh(SafetyState, now_ns),
            health=known.fresh(GatewayHealth, now_ns),
            health_age_s=known.age_s(GatewayHealth, now_ns),
            unreadable=known.unreadable,
            linked=self.linked,
            newer=known.newer.text,
        )

"""Samples to the channels and records that a log would have, for viewers instead of a file.

What nobody looks at is not decoded. What comes seldom (events, decisions, who a robot is) is declared before it
comes, so that viewers have subscribed by then, and the newest of it is shown to those who come later.
Its bounds are those of a log's channels: ``gateway.client.fleet`` stores messages, a viewer gets encoded records.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final, Protocol

from recorder.encoding.foxglove_log import log_record
from recorder.encoding.received_sample import ReceivedSample
from recorder.encoding.routes import Route, keep_raw
from recorder.layouts.attached import RobotKeys
from recorder.mcap.channel import LogChannel
from recorder.mcap.chunk import log_time
from recorder.record.actions import Query
from recorder.record.channels import ChannelQuota, Channels
from recorder.record.robots import Robots
from schemas import keys
from schemas.decisions import Decision, SafetyEvent
from schemas.messages import GatewayInfo, Message
from schemas.settings import ROBOT_LIMIT
from schemas.subjects import BY_TYPE

SAMPLE_MAX_BYTES: Final = 1 << 20
"""A larger sample is left out. Robots' routers let none pass either (``docs/authority.md``)."""

SILENT_NS: Final = 1_000_000_000
"""A robot of which nothing came for so long is silent: its state is published at 20 Hz."""

_SELDOM: Final = (SafetyEvent, Decision)
_SHOWN_LATER: Final = frozenset({SafetyEvent, GatewayInfo})


class Viewers(Protocol):
    """The destination of channels and records. No method waits for a viewer."""

    def declare(self, channel: LogChannel) -> None:
        """Add a channel."""
        ...

    def is_wanted(self, channel_id: int) -> bool:
        """True if somebody has subscribed to a channel."""
        ...

    def write(self, channel_id: int, log_ns: int, data: bytes) -> None:
        """Send a record to those who have subscribed to its channel."""
        ...


class LiveChannels:
    """The channels of what robots say.

    Attributes:
        left_out: samples that were too large to be shown.
    """

    def __init__(self, viewers: Viewers, version: str) -> None:
        """Nothing has come yet.

        Args:
            viewers: the destination.
            version: of this package.
        """
        self.left_out = 0
        self._viewers = viewers
        self._channels = Channels(viewers.declare)
        self._robots = Robots("", version)
        self._received_ns: dict[str, int] = {}
        """The last time that something of a robot came, monotonic, by its name; of at most ROBOT_LIMIT."""
        self._changed: deque[RobotKeys] = deque(maxlen=ROBOT_LIMIT)
        self._newest: dict[int, tuple[int, bytes]] = {}
        """Log time and data of the newest record of what is shown to those who come later, by channel."""

    @property
    def robots(self) -> frozenset[str]:
        """The robots of which something came."""
        return frozenset(self._received_ns)

    def silent(self, now_ns: int) -> frozenset[str]:
        """The robots of which nothing came for ``SILENT_NS``."""
        return frozenset(name for name, at_ns in self._received_ns.items() if now_ns - at_ns > SILENT_NS)

    def changed_robots(self) -> Iterator[RobotKeys]:
        """The robots that are new since the last call, or whose bus is known since."""
        while self._changed:
            yield self._changed.popleft()

    def queries(self, now_ns: int) -> list[Query]:
        """The queries that are due."""
        return self._robots.queries(now_ns)

    def receive(self, sample: ReceivedSample, now_ns: int) -> None:
        """Show a sample. It may hold anything: nothing in it raises."""
        if len(sample.payload) + len(sample.attachment) > SAMPLE_MAX_BYTES:
            self.left_out += 1
            return
        route = self._channels.get(sample.key) or self._find_route(sample.key, now_ns)
        if route.robot in self._received_ns:
            self._received_ns[route.robot] = now_ns
        is_shown_later = route.subject is not None and route.subject.type in _SHOWN_LATER
        if not is_shown_later and not self._viewers.is_wanted(route.channel_id):
            return
        log_ns = log_time(sample.received_ns)
        message = route.decode(sample)
        if isinstance(message, str):
            raw = route if route.subject is None else self._channels.declare_raw(sample.key)
            self._viewers.write(raw.channel_id, log_ns, keep_raw(sample, message, log_time(sample.zenoh_time_ns)))
            return
        for _, data in route.transcode(message):
            self._write(route, log_ns, data, is_shown_later=is_shown_later)
        self._act_on(sample.key, message, route, log_ns)

    def show_newest(self, channel_id: int) -> None:
        """Send the newest record of a channel again, if it comes seldom: somebody has just subscribed to it."""
        newest = self._newest.get(channel_id)
        if newest is not None:
            self._viewers.write(channel_id, *newest)

    def _act_on(self, key: str, message: Message, route: Route, log_ns: int) -> None:
        if isinstance(message, GatewayInfo):
            self._robots.receive_info(route.robot, message, log_ns)
        elif isinstance(message, SafetyEvent):
            line = self._channels.declare_line(key, ChannelQuota.TABLE)
            if line is not None:
                self._write(line, log_ns, log_record(message, _robot_of(key)), is_shown_later=True)

    def _write(self, route: Route, log_ns: int, data: bytes, *, is_shown_later: bool) -> None:
        if is_shown_later:
            self._newest[route.channel_id] = log_ns, data
        self._viewers.write(route.channel_id, log_ns, data)

    def _find_route(self, key: str, now_ns: int) -> Route:
        parts = keys.parse(key)
        if parts is None or not parts.robot:
            return self._channels.declare(key, None if parts is None else parts.subject, "")
        robot = self._robots.see(parts.root, parts.robot, now_ns)
        if not self._robots.has_quota(robot, parts.bus):
            return self._channels.declare(key, parts.subject, robot)
        if robot not in self._received_ns:
            self._received_ns[robot] = now_ns
            self._declare_seldom(parts.root, parts.robot, robot)
            self._changed.append(RobotKeys(f"{parts.root}/{parts.robot}"))
        if parts.bus:
            self._changed.append(RobotKeys(f"{parts.root}/{parts.robot}", parts.bus))
        return self._channels.declare(key, parts.subject, robot, ChannelQuota.TABLE)

    def _declare_seldom(self, root: str, robot: str, name: str) -> None:
        for kind in _SELDOM:
            self._channels.declare(keys.build(root, robot, BY_TYPE[kind]), BY_TYPE[kind], name, ChannelQuota.TABLE)
        self._channels.declare_line(keys.build(root, robot, BY_TYPE[SafetyEvent]), ChannelQuota.TABLE)


def _robot_of(key: str) -> str:
    parts = keys.parse(key)
    return parts.robot if parts is not None else key

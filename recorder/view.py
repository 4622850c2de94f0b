"""Robots live in Foxglove and Lichtblick: the channels and records that a log would have, for viewers.

``ViewServer`` is the WebSocket server of foxglove-sdk. It has no capability: it refuses anything that viewers
publish, call or set, with a status message. Each viewer has a ring of records, which drops the oldest.

Channels without subscribers are not decoded. Channels of rare messages (events, decisions, gateway infos) are
declared in advance, so that viewers can subscribe in time; later viewers get the newest message, and the robot's
outline.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, Self

import foxglove
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509 import load_pem_x509_certificates
from foxglove.websocket import ChannelView, Client, ServerListener, StatusLevel

from recorder.encoding.routes import Route, keep_raw
from recorder.encoding.samples import ReceivedSample
from recorder.encoding.viewers import (
    LINES,
    OUTLINES,
    TRANSFORM_NS,
    TRANSFORMS,
    log_record,
    outline_record,
    transform_record,
)
from recorder.layouts.attached import RobotKeys
from recorder.mcap.writer import LogChannel, log_time
from recorder.record.accounting import ChannelQuota, Channels
from recorder.record.actions import Query
from recorder.record.robots import Robots
from recorder.zenoh.source import ZenohSource
from schemas import keys
from schemas.command_line import CommandError, ExitCode, plain, shown_address
from schemas.decisions import Decision, SafetyEvent
from schemas.messages import GatewayInfo, Message, Odometry
from schemas.settings import ROBOT_LIMIT
from schemas.subjects import BY_TYPE

RECORDS_WAITING: Final = 2048  # of a viewer's ring; a batch of a saturated bus has 375 frames
SUBSCRIPTIONS_WAITING: Final = 10_000


class _Subscriptions(ServerListener):
    """Stores the channels of new subscriptions. Called on the server's threads."""

    def __init__(self) -> None:
        self.channels: deque[int] = deque(maxlen=SUBSCRIPTIONS_WAITING)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002 - the SDK's form
        self.channels.append(channel.id)


class ViewServer:
    """A server for viewers; a context manager. No method waits for a viewer.

    Args:
        port: 0 is a free one.
        certificate: the files of a chain and its key, PEM; without them there is no TLS.

    Attributes:
        where: its address for viewers.
    """

    def __init__(self, name: str, host: str, port: int, certificate: tuple[Path, Path] | None = None) -> None:
        # Its log lines are about viewers' mistakes, which the viewers are shown themselves.
        logging.getLogger("foxglove").setLevel(logging.ERROR)
        self._context = foxglove.Context()
        self._channels: dict[int, foxglove.Channel] = {}
        self._ids: dict[int, int] = {}  # our id of a channel, by the SDK's
        self._subscriptions = _Subscriptions()
        chain, key = (None, None) if certificate is None else _read(*certificate)
        try:
            self._server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                capabilities=[],
                server_listener=self._subscriptions,
                context=self._context,
                message_backlog_size=RECORDS_WAITING,
                tls_cert=chain,
                tls_key=key,
            )
        except RuntimeError as error:
            text = plain(str(error).removeprefix("FoxgloveError: "))
            raise CommandError(
                f"cannot listen on {shown_address(host, port)}: {text}", ExitCode.UNREACHABLE
            ) from error
        scheme = "ws" if certificate is None else "wss"
        self.where = f"{scheme}://{shown_address(host, self._server.port)}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self._server.stop()

    def declare(self, channel: LogChannel) -> None:
        schema = foxglove.Schema(
            name=channel.schema_name, encoding=channel.schema_encoding, data=channel.schema_data
        )
        added = foxglove.Channel(
            channel.topic, message_encoding=channel.message_encoding, schema=schema, context=self._context
        )
        self._ids[added.id()] = channel.channel_id
        self._channels[channel.channel_id] = added

    def is_wanted(self, channel_id: int) -> bool:
        return self._channels[channel_id].base.has_sinks()

    def write(self, channel_id: int, log_ns: int, data: bytes) -> None:
        self._channels[channel_id].log(data, log_time=log_ns)

    def subscribed(self) -> Iterator[int]:
        waiting = self._subscriptions.channels
        while waiting:
            channel_id = self._ids.get(waiting.popleft())
            if channel_id is not None:
                yield channel_id

    def warn(self, about: str, text: str) -> None:
        """Show a warning to all viewers; it replaces an earlier one about the same."""
        self._server.publish_status(text, StatusLevel.Warning, about)

    def clear(self, about: str) -> None:
        self._server.remove_status([about])


def _read(chain: Path, key: Path) -> tuple[bytes, bytes]:
    """A certificate chain and its key, in the forms of the SDK."""
    files = f"{plain(str(chain))} and {plain(str(key))}"
    try:
        found = chain.read_bytes()
        certificate = load_pem_x509_certificates(found)[0]
        private = load_pem_private_key(key.read_bytes(), None)
    except (OSError, TypeError, ValueError) as error:
        raise CommandError(f"{files} are no certificate with its key: {error}", ExitCode.USAGE) from error
    if private.public_key() != certificate.public_key():
        raise CommandError(f"{files} do not match", ExitCode.USAGE)
    return found, private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


SAMPLE_MAX_BYTES: Final = 1 << 20  # larger samples are left out; robots' routers block them, too
SILENT_NS: Final = 1_000_000_000  # a robot without samples for this long is silent: states come at 20 Hz

_SELDOM: Final = (SafetyEvent, Decision)
_SHOWN_LATER: Final = frozenset({SafetyEvent, GatewayInfo})


class _Pose:
    """A robot's channel of transforms, and the time of the newest one."""

    def __init__(self, robot: str, transforms: Route) -> None:
        self.robot = robot
        self.transforms = transforms
        self.drawn_ns = -TRANSFORM_NS


class LiveChannels:
    """The channels of robots' samples; ``left_out`` counts samples that are too large."""

    def __init__(self, viewers: ViewServer, version: str) -> None:
        self.left_out = 0
        self._viewers = viewers
        self._channels = Channels(viewers.declare)
        self._robots = Robots("", version)
        self._received_ns: dict[str, int] = {}
        """Monotonic time of each robot's last sample, of at most ROBOT_LIMIT robots."""
        self._changed: deque[RobotKeys] = deque(maxlen=ROBOT_LIMIT)
        self._newest: dict[int, tuple[int, bytes]] = {}
        """Log time and data of the newest record of each rare channel."""
        self._poses: dict[str, _Pose] = {}  # by the key of the odometry

    @property
    def robots(self) -> frozenset[str]:
        return frozenset(self._received_ns)

    def silent(self, now_ns: int) -> frozenset[str]:
        return frozenset(name for name, at_ns in self._received_ns.items() if now_ns - at_ns > SILENT_NS)

    def changed_robots(self) -> Iterator[RobotKeys]:
        """The robots that are new since the last call, or whose bus has become known."""
        while self._changed:
            yield self._changed.popleft()

    def queries(self, now_ns: int) -> list[Query]:
        return self._robots.queries(now_ns)

    def receive(self, sample: ReceivedSample, now_ns: int) -> None:
        """Show a sample; nothing in it raises."""
        if len(sample.payload) + len(sample.attachment) > SAMPLE_MAX_BYTES:
            self.left_out += 1
            return
        route = self._channels.get(sample.key) or self._find_route(sample, now_ns)
        if route.robot in self._received_ns:
            self._received_ns[route.robot] = now_ns
        is_shown_later = route.subject is not None and route.subject.type in _SHOWN_LATER
        pose = self._poses.get(sample.key)
        wanted = [route] if pose is None else [route, pose.transforms]
        if not is_shown_later and not any(self._viewers.is_wanted(one.channel_id) for one in wanted):
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
        """Send the newest record of a rare channel to a new subscriber."""
        if newest := self._newest.get(channel_id):
            self._viewers.write(channel_id, *newest)

    def _act_on(self, key: str, message: Message, route: Route, log_ns: int) -> None:
        if isinstance(message, GatewayInfo):
            self._robots.receive_info(route.robot, message, log_ns)
        elif isinstance(message, SafetyEvent):
            line = self._channels.declare_shown(key, LINES, ChannelQuota.TABLE)
            if line is not None:
                self._write(line, log_ns, log_record(message, _robot_of(key)), is_shown_later=True)
        elif (
            isinstance(message, Odometry)
            and (pose := self._poses.get(key))
            and not 0 <= message.time_ns - pose.drawn_ns < TRANSFORM_NS
        ):
            pose.drawn_ns = message.time_ns
            self._write(pose.transforms, log_ns, transform_record(message, pose.robot), is_shown_later=False)

    def _write(self, route: Route, log_ns: int, data: bytes, *, is_shown_later: bool) -> None:
        if is_shown_later:
            self._newest[route.channel_id] = log_ns, data
        self._viewers.write(route.channel_id, log_ns, data)

    def _find_route(self, sample: ReceivedSample, now_ns: int) -> Route:
        key = sample.key
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
        if parts.subject.type is Odometry:
            self._draw(key, f"{parts.root}/{parts.robot}", log_time(sample.received_ns))
        return self._channels.declare(key, parts.subject, robot, ChannelQuota.TABLE)

    def _draw(self, key: str, robot: str, log_ns: int) -> None:
        """Show a robot's outline, and its pose from now on."""
        transforms = self._channels.declare_shown(key, TRANSFORMS, ChannelQuota.TABLE)
        outlines = self._channels.declare_shown(key, OUTLINES, ChannelQuota.TABLE)
        if transforms is not None and outlines is not None:
            self._poses[key] = _Pose(robot, transforms)
            self._write(outlines, log_ns, outline_record(log_ns, robot), is_shown_later=True)

    def _declare_seldom(self, root: str, robot: str, name: str) -> None:
        for kind in _SELDOM:
            self._channels.declare(keys.build(root, robot, BY_TYPE[kind]), BY_TYPE[kind], name, ChannelQuota.TABLE)
        self._channels.declare_shown(keys.build(root, robot, BY_TYPE[SafetyEvent]), LINES, ChannelQuota.TABLE)


def _robot_of(key: str) -> str:
    parts = keys.parse(key)
    return parts.robot if parts is not None else key


PASS_SAMPLES: Final = 1000  # most samples of a subject between two ticks
TICK_NS: Final = 50_000_000  # pause between two ticks
WARN_NS: Final = 1_000_000_000  # period of a warning, for new viewers
IDLE_S: Final = 0.01  # pause without samples


class ViewLoop:
    """Shows samples to viewers, and calls ``greet`` for a new robot, and when its bus becomes known."""

    def __init__(
        self, source: ZenohSource, server: ViewServer, channels: LiveChannels, greet: Callable[[RobotKeys], None]
    ) -> None:
        self._source = source
        self._server = server
        self._channels = channels
        self._greet = greet
        self._ticked_ns = self._warned_ns = 0
        self._silent: frozenset[str] = frozenset()

    def run(self, stopped: Callable[[], bool]) -> None:
        while not stopped():
            if not self._step(time.monotonic_ns()):
                time.sleep(IDLE_S)

    def _step(self, now_ns: int) -> bool:
        samples = self._source.drain(PASS_SAMPLES)
        for sample in samples:
            self._channels.receive(sample, now_ns)
        if now_ns - self._ticked_ns >= TICK_NS:
            self._ticked_ns = now_ns
            self._tick(now_ns)
        return bool(samples)

    def _tick(self, now_ns: int) -> None:
        for query in self._channels.queries(now_ns):
            self._source.ask(query.key)
        for channel_id in self._server.subscribed():
            self._channels.show_newest(channel_id)
        for robot in self._channels.changed_robots():
            self._greet(robot)
        self._warn_of_silence(now_ns)

    def _warn_of_silence(self, now_ns: int) -> None:
        """Warn viewers, which go on showing the last values, that a robot is silent."""
        before, self._silent = self._silent, self._channels.silent(now_ns)
        for robot in before - self._silent:
            self._server.clear(robot)
        is_due = now_ns - self._warned_ns >= WARN_NS
        if is_due:
            self._warned_ns = now_ns
        for robot in self._silent if is_due else self._silent - before:
            self._server.warn(robot, f"{robot} is silent: its values are out of date")

"""Zenoh for ``cruiser ros``: the session of the ROS graph, as rmw_zenoh has it, and the feed of the robots.

No Python of ours but appending to a queue runs on Zenoh's threads.
"""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, Self

import msgspec
import zenoh
from zenoh import ext

from gateway.telemetry.samples import Received
from gateway.zenoh.client import SessionOwner, received_of
from schemas import keys
from schemas.command_line import CommandError, ExitCode, plain
from schemas.ros import types, wire
from schemas.ros.cdr import encode, type_hash
from schemas.ros.wire import Attachment, Endpoint, EntityKind
from schemas.settings import Settings, ZenohSettings
from schemas.subjects import BY_NAME
from schemas.zenoh_session import join, open_session

log = logging.getLogger(__name__)

WAITING_MAX: Final = 4096  # samples that may wait; beyond it the oldest go
COMMANDS_WAITING: Final = 16  # the same of a topic's commands, of which the newest counts
CALLS_WAITING: Final = 16  # of a service's calls
BATCH: Final = 64  # arrivals of one source that are handed out before the other sources have their turn


def clock_ns() -> int:
    """The time since the computer's start, with that during which it was suspended."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


class Arrivals:
    """Arrivals from Zenoh's threads, for one thread. A source that floods delays no other."""

    def __init__(self) -> None:
        self._sources: list[tuple[Callable[[Any, int], None], deque[tuple[Any, int]]]] = []
        self._event = threading.Event()
        self._fault = ""

    def to(self, take: Callable[[Any, int], None], waiting: int = WAITING_MAX) -> zenoh.handlers.Callback[Any]:
        """A handler of Zenoh's whose items ``take`` gets later, with the time of arrival by ``clock_ns``."""
        queue: deque[tuple[Any, int]] = deque(maxlen=waiting)
        self._sources.append((take, queue))

        def keep(item: object) -> None:
            queue.append((item, clock_ns()))
            self._event.set()

        return zenoh.handlers.Callback(keep, lambda: None)

    def handle(self, timeout_s: float) -> None:
        """Wait for arrivals, and hand out those that are here. One that cannot be handled is left out."""
        self._event.wait(timeout_s)
        self._event.clear()
        # Handling one may add a source: that of a robot that appears.
        for take, queue in list(self._sources):
            for _ in range(min(len(queue), BATCH)):
                try:
                    take(*queue.popleft())
                except Exception as error:  # no message may end a bridge that drives robots
                    if (fault := ascii(error)) != self._fault:
                        self._fault = fault
                        log.exception("a message could not be handled")
            if queue:
                self._event.set()


class RobotFeed(SessionOwner):
    """The samples of robots that are published to ROS; a robot may be a pattern of names."""

    SUBJECTS: Final = ("chassis/odometry", "state", "safety/state", "gateway/health")

    def __init__(
        self,
        session: zenoh.Session,
        root: str,
        robots: Sequence[str],
        arrivals: Arrivals,
        take: Callable[[Received], None],
    ) -> None:
        """Subscribe on a session, which the feed then owns."""
        super().__init__(session)
        handler = arrivals.to(lambda sample, _: take(received_of(sample)))
        self._subscribers: tuple[Any, ...] = tuple(
            session.declare_subscriber(f"{root}/{keys.chunk_of(robot)}/{BY_NAME[subject].name}", handler)
            for robot in robots
            for subject in self.SUBJECTS
        )

    @classmethod
    def open(
        cls, settings: Settings, robots: Sequence[str], arrivals: Arrivals, take: Callable[[Received], None]
    ) -> Self:
        """Open a session to where the settings say, and listen."""
        return cls(join(settings.zenoh), settings.robot.root, robots, arrivals, take)


class RosPublisher:
    """A publisher of the graph."""

    def __init__(self, publisher: Any, type_name: str) -> None:  # noqa: ANN401 - of two classes of Zenoh's
        self._publisher = publisher
        self._type_name = type_name
        self._gid = secrets.token_bytes(wire.GID_BYTES)
        self._sequence = 0

    def publish(self, fields: dict[str, Any]) -> None:
        self._sequence += 1
        attachment = Attachment(self._sequence, time.time_ns(), self._gid).encode()
        self._publisher.put(encode(self._type_name, fields), attachment=attachment)


class RosRequest(msgspec.Struct, frozen=True):
    """A call of a Trigger service that waits for its answer."""

    query: Any
    key: str
    asked: Attachment

    def answer(self, *, success: bool, text: str) -> None:
        attachment = Attachment(self.asked.sequence, time.time_ns(), self.asked.gid).encode()
        answer = encode(types.TRIGGER_RESPONSE, {"success": success, "message": text})
        self.query.reply(self.key, answer, attachment=attachment)
        self.query.drop()


class RosSession(SessionOwner):
    """The session of the ROS graph, a client of the user's rmw_zenohd."""

    def __init__(self, session: zenoh.Session, arrivals: Arrivals, domain: int, *, hashes: bool) -> None:
        """Use a session, which this then owns."""
        super().__init__(session)
        self._arrivals = arrivals
        self._domain = domain
        self._hashes = hashes
        self._zid = str(session.info.zid())
        self._own: set[str] = set()
        self._numbers = 0
        self._declared: list[Any] = []
        self._met: dict[str, Endpoint] = {}
        self._tokens = arrivals.to(lambda sample, _: self._meet(sample))

    @classmethod
    def open(cls, endpoint: str, arrivals: Arrivals, domain: int, *, hashes: bool) -> Self:
        """Connect to the router of the graph.

        Raises:
            CommandError: none answers there, or what answers is no router.
        """
        settings = ZenohSettings(mode="client", given=frozenset({"mode"}))
        where = plain(endpoint)
        try:
            session = open_session(settings, [endpoint], [])
        except CommandError as error:
            hint = "'ros2 run rmw_zenoh_cpp rmw_zenohd' starts it, and --ros says where it is"
            raise CommandError(f"no ROS 2 router answers at {where}: {hint}", ExitCode.UNREACHABLE) from error
        if not session.info.routers_zid():
            session.close()
            raise CommandError(
                f"what answers at {where} is no router: a gateway has the port of rmw_zenohd. Start rmw_zenohd "
                "on another port, and name it with --ros (docs/ros2.md)",
                ExitCode.UNREACHABLE,
            )
        return cls(session, arrivals, domain, hashes=hashes)

    def watch(self, kind: EntityKind, node: Endpoint, topic: str) -> Callable[[], list[str]]:
        """Watch others' endpoints of a topic or service. Returns what lists their nodes, one for each endpoint."""
        name = f"{node.namespace}/{topic}".strip("/")
        # Chunks: root, domain, session, node, endpoint, kind, enclave, namespace, node, topic, type, hash, qos.
        tokens = f"{wire.TOKENS}/{self._domain}/*/*/*/{kind.value}/*/*/*/{wire.mangled(name)}/*/*/*"
        self._declared.append(self._session.liveliness().declare_subscriber(tokens, self._tokens, history=True))

        def nodes() -> list[str]:
            found = [one for one in list(self._met.values()) if one.name == name]
            names = [plain(f"/{one.namespace}/{one.node}".replace("//", "/")) for one in found if one.kind is kind]
            return names if len(self._met) < WAITING_MAX else [*names, "more than can be counted"]

        return nodes

    def node(self, namespace: str, name: str) -> Endpoint:
        """Declare a node."""
        node = Endpoint(self._domain, self._zid, self._number(), 0, EntityKind.NODE, namespace, name)
        node = msgspec.structs.replace(node, endpoint_id=node.node_id)
        self._token(node)
        return node

    def publisher(self, node: Endpoint, topic: str, type_name: str, *, latched: bool = False) -> RosPublisher:
        """Declare a publisher of a topic below the node's namespace; a latched one repeats its last message."""
        name = f"{node.namespace}/{topic}".strip("/")
        key = self._key(name, type_name)
        publisher: Any
        if latched:
            publisher = ext.declare_advanced_publisher(
                self._session, key, cache=ext.CacheConfig(max_samples=1), publisher_detection=True
            )
        else:
            publisher = self._session.declare_publisher(key)
        self._endpoint(node, EntityKind.PUBLISHER, name, type_name, wire.LATCHED if latched else wire.RELIABLE)
        self._declared.append(publisher)
        return RosPublisher(publisher, type_name)

    def subscribe(
        self, node: Endpoint, topic: str, type_names: Sequence[str], take: Callable[[Received, int], None]
    ) -> None:
        """Subscribe to a topic below the node's namespace, whatever the type of its publishers is."""
        name = f"{node.namespace}/{topic}".strip("/")

        def arrived(sample: zenoh.Sample, arrived_ns: int) -> None:
            # A put to a pattern is meant for no robot.
            if "*" not in str(sample.key_expr):
                take(received_of(sample), arrived_ns)

        handler = self._arrivals.to(arrived, COMMANDS_WAITING)
        self._declared.append(self._session.declare_subscriber(f"{self._domain}/{name}/*/*", handler))
        for type_name in type_names:
            self._endpoint(node, EntityKind.SUBSCRIPTION, name, type_name, wire.BEST_EFFORT)

    def serve(self, node: Endpoint, service: str, take: Callable[[RosRequest], None]) -> None:
        """Declare a Trigger service below the node's namespace."""
        name = f"{node.namespace}/{service}".strip("/")
        key = self._key(name, types.TRIGGER)

        def called(query: zenoh.Query, _: int) -> None:
            given = query.attachment
            asked = wire.read_attachment(given.to_bytes()) if given is not None else None
            if str(query.key_expr) != key or asked is None:
                # A pattern asks every service at once: it is no call.
                query.reply_err(b"no call of a ROS service: it needs the service's own key and an attachment")
                query.drop()
            else:
                take(RosRequest(query, key, asked))

        handler = self._arrivals.to(called, CALLS_WAITING)
        self._declared.append(self._session.declare_queryable(key, handler, complete=True))
        self._endpoint(node, EntityKind.SERVER, name, types.TRIGGER, wire.RELIABLE)

    def _key(self, name: str, type_name: str) -> str:
        return wire.key_of(self._domain, name, type_name, hashes=self._hashes)

    def _endpoint(self, node: Endpoint, kind: EntityKind, name: str, type_name: str, qos: str) -> None:
        endpoint = msgspec.structs.replace(
            node,
            endpoint_id=self._number(),
            kind=kind,
            name=name,
            type_name=wire.dds_type(type_name),
            type_hash=type_hash(type_name) if self._hashes else wire.NO_HASH,
            qos=qos,
        )
        self._token(endpoint)

    def _token(self, endpoint: Endpoint) -> None:
        token = endpoint.token()
        self._own.add(token)
        self._declared.append(self._session.liveliness().declare_token(token))

    def _number(self) -> int:
        self._numbers += 1
        return self._numbers

    def _meet(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.DELETE:
            self._met.pop(key, None)
        elif (
            key not in self._own
            and (endpoint := wire.read_token(key)) is not None
            and len(self._met) < WAITING_MAX
        ):
            self._met[key] = endpoint

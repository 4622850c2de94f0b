"""Publishes a log's samples again on Zenoh: no liveliness token, no queryable, nothing that a live robot has.

While it is open it looks out for gateways. Where one is connected under the same root nothing is published.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any, Final

import zenoh

from recorder.replay.run import Halt
from recorder.replay.samples import ReplaySample, overlap, root_of_token
from schemas import keys
from schemas.command_line import CommandError, ExitCode
from schemas.settings import ZenohSettings
from schemas.subjects import Subject
from schemas.zenoh_session import GOSSIP, close_session, is_connected, join, local_port, open_session, said_of

log = logging.getLogger(__name__)

TOKENS_WAITING: Final = 10_000

TOKEN_TIMEOUT_S: Final = 1.0
"""The start asks for gateways for so long."""

POLL_S: Final = 0.02


def key_checked(text: str) -> str:
    """A key expression, in the form that Zenoh wants.

    Raises:
        CommandError: it is none.
    """
    try:
        return str(zenoh.KeyExpr.autocanonize(text))
    except zenoh.ZError as error:
        raise CommandError(f"{text!a} is no key expression", ExitCode.USAGE) from error


def key_matches(expression: str, topic: str) -> bool:
    """True if a Zenoh key expression matches a topic. False of what is no key expression."""
    try:
        return zenoh.KeyExpr.autocanonize(expression).includes(zenoh.KeyExpr(topic))
    except zenoh.ZError:
        return expression == topic


class ZenohOutlet:
    """A session that publishes samples, from its beginning to ``close``.

    Where it is said where to listen, and nowhere to connect, it is a network of its own: who connects there shall
    not see live robots beside those of the log.

    Args:
        settings: of the session.
        root: the beginning of every key.
        waits: a subscriber that is too slow holds the replay up, instead of losing samples.

    Attributes:
        listen: where others are to connect; empty if nothing is said of it.
        sent: samples that Zenoh took...
        failed: ...and those that it did not.
        was_alone: for a while nobody was connected.

    Raises:
        CommandError: the session cannot be opened.
    """

    def __init__(self, settings: ZenohSettings, root: str, *, waits: bool) -> None:
        self.sent = self.failed = 0
        self.was_alone = False
        self._root = root
        self._congestion = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
        _, connect, self.listen, _ = said_of(settings)
        if self.listen and not connect:
            # It connects to nobody of itself, and tells no node that connects to it of another.
            self._session = open_session(settings, [], self.listen, changes={GOSSIP: False})
        else:
            self._session = join(settings, self.listen or local_port(settings))
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._gateways: set[str] = set()
        self._tokens: Any = self._session.liveliness().declare_subscriber(
            keys.ANY_TOKEN, zenoh.handlers.RingChannel(TOKENS_WAITING), history=True
        )

    @property
    def is_connected(self) -> bool:
        """True if any Zenoh node is connected."""
        return is_connected(self._session)

    def wait_for_link(self, timeout_s: float, stopped: Callable[[], bool]) -> bool:
        """Wait until somebody is connected. False if nobody is in time."""
        # Zenoh lists no clients; that one of them subscribes is all that is known of it.
        return self._wait(lambda probe: self.is_connected or _matches(probe), timeout_s, stopped)

    def wait_for_subscriber(self, timeout_s: float | None, stopped: Callable[[], bool]) -> bool:
        """Wait for somebody who wants what will be published: links and declarations take their time.

        Args:
            timeout_s: the longest wait; None waits as long as need be.
            stopped: gives up when it turns true.
        """
        return self._wait(_matches, timeout_s, stopped)

    def _wait(
        self, is_there: Callable[[zenoh.Publisher], bool], timeout_s: float | None, stopped: Callable[[], bool]
    ) -> bool:
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        probe = self._session.declare_publisher(f"{self._root}/**")
        try:
            while not is_there(probe):
                if stopped() or (end_s is not None and time.monotonic() >= end_s):
                    return False
                time.sleep(POLL_S)
            return True
        finally:
            probe.undeclare()

    def find_gateway(self) -> Halt | None:
        """Ask for gateways. The refusal if there is one under the root."""
        for reply in self._session.liveliness().get(keys.ANY_TOKEN, timeout=TOKEN_TIMEOUT_S):
            if reply.ok is not None:
                self._gateways.add(str(reply.ok.key_expr))
        return self._refusal()

    def send(self, item: ReplaySample, shift_ns: int) -> None:
        """Publish a sample, with the quality of service of its subject. Never raises."""
        try:
            if item.is_delete:
                self._session.delete(item.key, congestion_control=self._congestion)
            elif item.subject is None:
                self._session.put(
                    item.key,
                    item.raw,
                    encoding=item.encoding,
                    congestion_control=self._congestion,
                    attachment=item.attachment or None,
                )
            else:
                publisher = self._publishers.get(item.key) or self._declare(item.key, item.subject)
                publisher.put(item.payload(shift_ns))
        except (zenoh.ZError, ValueError) as error:
            self.failed += 1
            log.debug("Zenoh did not take a sample of %s: %s", item.key, error)
        else:
            self.sent += 1

    def attend(self) -> Halt | None:
        """Look out for gateways. Why the replay must end, if one has come."""
        while (token := self._tokens.try_recv()) is not None:
            key = str(token.key_expr)
            if token.kind == zenoh.SampleKind.PUT:
                self._gateways.add(key)
            else:
                self._gateways.discard(key)
        self.was_alone = self.was_alone or not self.is_connected
        return self._refusal()

    def close(self) -> None:
        """Leave Zenoh. Never raises."""
        close_session(self._session)

    def _declare(self, key: str, subject: Subject) -> zenoh.Publisher:
        publisher = self._publishers[key] = self._session.declare_publisher(
            key,
            encoding=subject.encoding,
            congestion_control=self._congestion,
            priority=getattr(zenoh.Priority, subject.qos.priority.value),
            express=subject.qos.express,
        )
        return publisher

    def _refusal(self) -> Halt | None:
        for key in sorted(self._gateways):
            if overlap(root_of_token(key), self._root):
                robot = key.split("/")[-2]
                return Halt(
                    f"the gateway of a robot is connected under this root, {key}: what is replayed would be taken "
                    f"for {robot}; choose another --root",
                    ExitCode.REFUSED,
                )
        return None


def _matches(publisher: zenoh.Publisher) -> bool:
    # The package's own annotation says that it is a bool.
    status = publisher.matching_status
    return bool(getattr(status, "matching", status))

"""A gateway's place on Zenoh before it has found its router: the robot starts, and joins when one answers.

A client's session opens with its router alone. So it is tried again and again on a thread of its own, and the loop
takes it over once it is there. Until then no request comes, and of what the robot publishes the kept samples wait.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Final

from gateway.command.flow import PendingReply
from gateway.command.request import RawRequest
from gateway.telemetry.kept_samples import KeptSamples
from gateway.zenoh.inbox import CommandInbox
from gateway.zenoh.node import ZenohNode
from schemas.authority.proof import SIGNED
from schemas.codec import Sample
from schemas.command_line import CommandError
from schemas.subjects import BY_NAME

log = logging.getLogger(__name__)

AGAIN_S: Final = 1.0
"""Pause between two attempts."""

CLOSE_TIMEOUT_S: Final = 3.0
"""The longest wait of a gateway that ends for an attempt that is under way."""

Joined = tuple[ZenohNode, CommandInbox | None]


class LateInbox:
    """Where requests will wait; none come yet.

    Attributes:
        inbox: the real one, once there is one.
    """

    def __init__(self) -> None:
        self.inbox: CommandInbox | None = None

    @property
    def drops(self) -> int:
        """Requests that were dropped unread since the start."""
        return 0 if self.inbox is None else self.inbox.drops

    def drain(self, holder: str, lease: int = 0, after: int = -1) -> list[RawRequest]:
        """Return the requests that wait, as ``CommandInbox.drain`` does."""
        return [] if self.inbox is None else self.inbox.drain(holder, lease, after)

    def statements(self) -> list[RawRequest]:
        """Return the statements of an authority that wait."""
        return [] if self.inbox is None else self.inbox.statements()

    def reply(self, reply: PendingReply) -> None:
        """Answer who waits for it."""
        if self.inbox is not None:
            self.inbox.reply(reply)

    def close(self) -> None:
        """Leave Zenoh. Never raises."""
        if self.inbox is not None:
            self.inbox.close()


class LateNode:
    """The gateway's node, once a router answers. Nothing here raises or blocks, but for its end."""

    warning: Final = ""

    def __init__(self, join: Callable[[], Joined], inbox: LateInbox | None, cause: str) -> None:
        """Begin to try.

        Args:
            join: opens the sessions, once; raises CommandError where it cannot.
            inbox: is given the inbox; None for a gateway that only listens.
            cause: why the first attempt has failed.
        """
        self._join = join
        self._inbox = inbox
        self._node: ZenohNode | None = None
        self._joined: Joined | None = None
        self._kept = {
            name: KeptSamples(subject.qos.kept_bytes)
            for name, subject in BY_NAME.items()
            if subject.qos.kept_bytes
        }
        self._recent = {
            name: deque[Sample](maxlen=subject.qos.history)
            for name, subject in BY_NAME.items()
            if subject.qos.history and name not in SIGNED
        }
        self._cause = ""
        self._say(cause)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="late-node", daemon=True)
        self._thread.start()

    @property
    def failures(self) -> int:
        """Samples that Zenoh did not take."""
        return 0 if self._node is None else self._node.failures

    def notes(self) -> tuple[str, ...]:
        """Return why the robot is off the network, for people; nothing once it is on it."""
        return () if self._node is not None else (f"off the network: {self._cause}",)

    def publish(self, sample: Sample) -> None:
        """Hand a sample to Zenoh, or keep it for later, as far as its subject is kept."""
        if self._node is not None:
            self._node.publish(sample)
            return
        if sample.subject in self._kept:
            self._kept[sample.subject].add(sample.payload)
        if sample.subject in self._recent:
            self._recent[sample.subject].append(sample)

    def answer(self, reply: Callable[[], bytes]) -> None:
        """Answer the queries that wait; take the node over first, where it has come."""
        if self._node is None and self._joined is not None:
            self._node, inbox = self._joined
            self._node.resume(self._kept, [sample for samples in self._recent.values() for sample in samples])
            if self._inbox is not None and inbox is not None:
                self._node.disregard(inbox.node)
                self._inbox.inbox = inbox
            log.warning("the robot is on the network%s", f"; {self._node.warning}" if self._node.warning else "")
        if self._node is not None:
            self._node.answer(reply)

    def peers(self) -> int:
        """Return the number of nodes connected directly."""
        return 0 if self._node is None else self._node.peers()

    def outside(self) -> tuple[str, ...]:
        """Return the other ends of connections that leave this machine."""
        return () if self._node is None else self._node.outside()

    def close(self) -> None:
        """Leave Zenoh, within a bounded time. Never raises. The inbox that was taken over is closed by itself."""
        self._ends.set()
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._node is not None:
            self._node.close()
        elif self._joined is not None:
            _close(self._joined)

    def _run(self) -> None:
        while not self._ends.wait(AGAIN_S):
            try:
                joined = self._join()
            except CommandError as error:
                self._say(str(error))
                continue
            if self._ends.is_set():
                _close(joined)
            else:
                self._joined = joined
            return

    def _say(self, cause: str) -> None:
        if cause != self._cause:
            log.warning("%s; the robot is off the network, and nobody can command it; trying on", cause)
        self._cause = cause


def _close(joined: Joined) -> None:
    node, inbox = joined
    if inbox is not None:
        inbox.close()
    node.close()

"""The loop of a view: samples from Zenoh to viewers. It waits for neither."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, Protocol

from recorder.layouts.attached import RobotKeys
from recorder.view.live_channels import LiveChannels
from recorder.view.server import ViewServer
from recorder.zenoh.source import ZenohSource

PASS_SAMPLES: Final = 1000
"""Samples of a subject between two ticks at most."""

TICK_NS: Final = 50_000_000
"""Pause between two ticks."""

WARN_NS: Final = 1_000_000_000
"""A warning is repeated so often, for viewers who came after it."""

IDLE_S: Final = 0.01
"""Pause when nothing has come in."""


class Greeting(Protocol):
    """Acts on a robot that is new, or whose bus is known since."""

    def __call__(self, robot: RobotKeys, /) -> None:
        """Act on it."""


class ViewLoop:
    """Shows samples to viewers.

    Args:
        source: of the samples.
        server: the viewers.
        channels: with the server as their destination.
        greet: is called for each robot.
    """

    def __init__(self, source: ZenohSource, server: ViewServer, channels: LiveChannels, greet: Greeting) -> None:
        self._source = source
        self._server = server
        self._channels = channels
        self._greet = greet
        self._ticked_ns = self._warned_ns = 0
        self._silent: frozenset[str] = frozenset()

    def run(self, stopped: Callable[[], bool]) -> None:
        """Show what comes, until stopped."""
        while not stopped():
            if not self._step(time.monotonic_ns()):
                time.sleep(IDLE_S)

    def _step(self, now_ns: int) -> bool:
        """One pass. False if nothing had come in."""
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
        """Viewers go on showing the last values: they are told that these are not current."""
        before, self._silent = self._silent, self._channels.silent(now_ns)
        for robot in before - self._silent:
            self._server.clear(robot)
        is_due = now_ns - self._warned_ns >= WARN_NS
        if is_due:
            self._warned_ns = now_ns
        for robot in self._silent if is_due else self._silent - before:
            self._server.warn(robot, f"{robot} is silent: what is shown of it is not current")

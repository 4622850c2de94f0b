"""Samples of the robots that are this recorder's, where several recorders share a fleet."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import zenoh

from recorder.record.shards import Shard, Shards
from recorder.zenoh.source import TOKENS_WAITING, ZenohSource, distinct, have_overlap
from schemas import keys
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import ZenohSettings

log = logging.getLogger(__name__)

ROBOT_SAMPLES: Final = 1_000
"""Samples of a robot that may wait for each key expression, 1.4 s of a robot at its full rate. A ring takes all of
its memory at once."""

LOOK_NS: Final = 100_000_000
"""Pause between two looks at whose robots these are."""


class ShardedSource(ZenohSource):
    """A Zenoh session that subscribes to the keys of one robot after the other, as they become this recorder's.

    A robot is known by its gateway's liveliness token, and stays known when that is gone.

    Args:
        settings: of the session.
        key_expressions: what of each robot is recorded; the robot's chunk of a key is a robot or a wildcard.
        root: first chunks of the robots' keys.
        own: which one of how many recorders this is.

    Raises:
        CommandError: as ``ZenohSource`` does, or a key expression is not of robots.
    """

    def __init__(self, settings: ZenohSettings, key_expressions: Sequence[str], root: str, own: Shard) -> None:
        self._root = root
        self._expressions = [str(one) for one in distinct(key_expressions)]
        for expression in self._expressions:
            if of_robot(expression, root, "") is None:
                raise CommandError(
                    f"shards are parts of the robots under {root}, and {expression!r} names none", ExitCode.USAGE
                )
        super().__init__(settings, [], ROBOT_SAMPLES)
        self._overlap = have_overlap(distinct(key_expressions))
        self._shards = Shards(own, time.monotonic_ns())
        pattern = (
            rf"{re.escape(root)}/@[^/]+/({keys.ROBOT_PATTERN})/{keys.SHARD_CHUNK}/([1-9][0-9]*)-of-{own.total}"
        )
        self._of_shard = re.compile(pattern)
        self._shard_tokens: Any = self._session.liveliness().declare_subscriber(
            keys.shard(root, keys.ALL, keys.ALL), zenoh.handlers.RingChannel(TOKENS_WAITING), history=True
        )
        self._robots: frozenset[str] = frozenset()
        self._looked_ns = 0
        self._said: list[int] = []
        self._namesakes_said = 1

    def tokens_gone(self) -> Iterator[str]:
        """The keys of the liveliness tokens that are gone since the last call, of the robots recorded here."""
        while (token := self._tokens.try_recv()) is not None:
            robot = keys.robot_of_liveliness(self._root, str(token.key_expr))
            if robot is None:
                continue
            if token.kind == zenoh.SampleKind.PUT:
                self._shards.meet(robot)
            elif robot in self._robots:
                yield str(token.key_expr)

    def robots_left(self) -> Iterable[str]:
        """The robots that another recorder has taken over since the last call. Others come at the same time."""
        now_ns = time.monotonic_ns()
        if now_ns - self._looked_ns < LOOK_NS:
            return ()
        self._looked_ns = now_ns
        self._look_at_shards(now_ns)
        before, self._robots = self._robots, self._shards.recorded(now_ns)
        if before == self._robots:
            return ()
        self._unsubscribe(one for robot in before - self._robots for one in self._of(robot))
        self._subscribe(one for robot in sorted(self._robots - before) for one in self._of(robot))
        there = ", ".join(map(str, self._shards.there(now_ns)))
        own = self._shards.own
        log.info("shard %d of %d: records %d robots; shards that are there: %s", *own, len(self._robots), there)
        return before - self._robots

    def _look_at_shards(self, now_ns: int) -> None:
        while (token := self._shard_tokens.try_recv()) is not None:
            match = self._of_shard.fullmatch(str(token.key_expr))
            if match is not None:
                is_there = token.kind == zenoh.SampleKind.PUT
                self._shards.see(int(match[2]), match[1], is_there=is_there, now_ns=now_ns)
        if not self.is_connected:
            self._shards.wait(now_ns)
        namesakes = self._shards.namesakes()
        if len(namesakes) > self._namesakes_said:
            log.warning("recorders %s are the same shard: each records its robots", ", ".join(namesakes))
        self._namesakes_said = max(1, len(namesakes))

    def _of(self, robot: str) -> Iterator[zenoh.KeyExpr]:
        yield from distinct([one for text in self._expressions if (one := of_robot(text, self._root, robot))])


def of_robot(expression: str, root: str, robot: str) -> str | None:
    """Return what of a key expression is one robot's.

    Args:
        expression: in Zenoh's canonical form.
        root: first chunks of the robots' keys.
        robot: its name; empty for what is any robot's.

    Returns:
        A key expression under the robot's keys; empty if the expression is of other robots; None if it is of none.
    """
    if expression in {"**", f"{root}/**"}:
        return f"{root}/{robot}/**"
    chunk, _, rest = expression.removeprefix(f"{root}/").partition("/")
    if not expression.startswith(f"{root}/") or not rest or chunk.startswith("@"):
        return None
    if chunk == "**":
        return f"{root}/{robot}/**/{rest}"
    if robot and not zenoh.KeyExpr(chunk).includes(zenoh.KeyExpr(robot)):
        return ""
    return f"{root}/{robot}/{rest}"

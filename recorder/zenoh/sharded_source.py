"""Samples of the robots that are this recorder's, where several recorders share a fleet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import zenoh

from recorder.record.shards import Shard
from recorder.zenoh.source import ZenohSource, distinct, have_overlap
from schemas import keys
from schemas.command_line import CommandError, ExitCode
from schemas.settings import ZenohSettings

ROBOT_SAMPLES: Final = 1_000
"""Samples of a robot that may wait for each key expression, 1.4 s of a robot at its full rate. A ring takes all of
its memory at once."""

ROBOTS_MAX: Final = 20_000
"""Robots that are subscribed to at most: anybody may declare a token."""


class ShardedSource(ZenohSource):
    """A Zenoh session that subscribes to the keys of one robot after the other, as they turn up.

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
        self._root, self._own = root, own
        self._expressions = [str(one) for one in distinct(key_expressions)]
        for expression in self._expressions:
            if of_robot(expression, root, "") is None:
                raise CommandError(
                    f"shards are parts of the robots under {root}, and {expression!r} names none", ExitCode.USAGE
                )
        super().__init__(settings, [], ROBOT_SAMPLES)
        self._overlap = have_overlap(distinct(key_expressions))
        self._robots: set[str] = set()

    def tokens_gone(self) -> Iterator[str]:
        """The keys of the liveliness tokens that are gone since the last call, of the robots recorded here."""
        while (token := self._tokens.try_recv()) is not None:
            robot = keys.robot_of_liveliness(self._root, str(token.key_expr))
            if robot is None or not self._own.has(robot):
                continue
            if token.kind != zenoh.SampleKind.PUT:
                yield str(token.key_expr)
            elif robot not in self._robots and len(self._robots) < ROBOTS_MAX:
                self._robots.add(robot)
                self._subscribe(self._of(robot))

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

"""Gateways that have died, of those whose liveliness token is gone. Pure.

The token alone proves nothing: it also goes with the link, and anybody may declare one and take it back. So the
arbiter's states are waited for: a gateway whose states go on lives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

import msgspec

from recorder.encoding.fast_path import Latest
from schemas.decisions import ArbiterState, SafetyState, is_same_run

WAIT_NS: Final = 500_000_000
"""The time without a state that counts as silence: states come every 50 ms."""

LIVES_NS: Final = 10_000_000_000
"""A gateway that still publishes states so long after its token went is alive. States that merely waited for a
busy recorder come sooner."""


class LostGateway(msgspec.Struct, frozen=True):
    """A gateway that has died.

    Attributes:
        key: of its ``safety/state``.
        lost_ns: when its token went, monotonic.
        text: a sentence about it.
        was_commanding: it commanded the chassis when its last state came.
    """

    key: str
    lost_ns: int
    text: str
    was_commanding: bool


class _Waiting(msgspec.Struct, frozen=True):
    latest: Latest
    state: SafetyState
    ended: Callable[[], int | None]
    lost_ns: int


class LostGateways:
    """The tokens that are gone, until their gateways are known to be dead or alive."""

    def __init__(self) -> None:
        self._waiting: dict[str, _Waiting] = {}

    def lose_token(self, key: str, latest: Latest, ended: Callable[[], int | None], now_ns: int) -> None:
        """Note that a gateway's token is gone.

        Args:
            key: of the gateway's ``safety/state``.
            latest: the newest of these; it is looked at again when it is due.
            ended: returns the tick at which the gateway last reported that it shuts down; None if it
                never did.
            now_ns: monotonic.
        """
        if isinstance(latest.message, SafetyState):
            self._waiting.setdefault(key, _Waiting(latest, latest.message, ended, now_ns))

    def due(self, now_ns: int, wall_ns: int) -> Iterator[LostGateway]:
        """Return the gateways that turn out to have died.

        Args:
            now_ns: monotonic.
            wall_ns: since 1970, as are the states' times of receipt.
        """
        for key, waiting in [*self._waiting.items()]:
            waited_ns = now_ns - waiting.lost_ns
            if waited_ns < WAIT_NS:
                continue
            last, newest = waiting.state, waiting.latest.message
            if isinstance(newest, SafetyState) and is_same_run(newest.tick, last.tick):
                if wall_ns - waiting.latest.log_ns < WAIT_NS:
                    if waited_ns > LIVES_NS:
                        del self._waiting[key]
                    continue
                last = newest
            del self._waiting[key]
            was_commanding, ended_tick = last.state is not ArbiterState.STANDBY, waiting.ended()
            if not was_commanding and ended_tick is not None and is_same_run(ended_tick, last.tick):
                continue
            told = f", and told {last.output_speed_mps:.2f} m/s" if was_commanding else ""
            text = f"the gateway died, or the link to it: its token is gone, and it was {last.state.value}{told}"
            yield LostGateway(key, waiting.lost_ns, text, was_commanding)

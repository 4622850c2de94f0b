"""The newest statements of the authorities of a log's robots: each of its files holds what proves it. Pure.

A robot repeats once a minute what is in force. An incident, or a file of a log that was begun anew, may be over
before: so what was said last is written into it as metadata. Anybody may publish something on a robot's keys: with
the authority's keys the recorder knows what is signed by it, and nothing that is not takes the place of that.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import Final

from recorder.record.actions import LogAction, WriteMetadata
from schemas.authority.proof import TEXT_MAX_BYTES, Rotation, StatementFault, read_chain
from schemas.authority.trust import Trust

STATEMENTS_NAME: Final = "cruiser.statements"
"""The metadata record: by ``{root}/{robot} {time} {number}`` the texts, the time in nanoseconds since 1970."""

STATEMENTS_MAX_BYTES: Final = 131_072
"""Statements of a log that are kept: those that the authority signed, and as many of all others; beyond it the one
goes that was not repeated for longest."""

TRUSTS_MAX: Final = 8
"""The authority before a rotation, and those after: what each signed is proven."""

VERIFIED_PER_TICK: Final = 2
"""Statements that are verified in a tick, up to three signatures each: a flood of forged ones costs no more."""


class Statements:
    """The statements that the robots of a log have shown.

    Args:
        log: the log's name.
        trust: the authority; None if the recorder was not provisioned with one, so that nothing is proven.
    """

    def __init__(self, log: str, trust: Trust | None = None) -> None:
        self._log = log
        self._trusts = [] if trust is None else [trust]
        self._proven = _Room()
        self._unproven = _Room()
        self._left = VERIFIED_PER_TICK
        self._is_new = False

    def tick(self) -> None:
        """Verify a few more from now on."""
        self._left = VERIFIED_PER_TICK

    def receive(self, robot: str, text: str, time_ns: int) -> None:
        """Keep a statement of a robot, with the time when it was said first. A text that is too long is none.

        Args:
            robot: the beginning of its keys, root and name.
            text: the statement with its chain.
            time_ns: by the robot's clock, since 1970.
        """
        if len(text.encode()) > TEXT_MAX_BYTES:
            # Nobody signed the message: one alone must not displace all others.
            return
        place = robot, text
        if self._proven.repeat(place):
            return
        if self._is_proven(text):
            self._proven.add(place, self._unproven.remove(place, time_ns))
        elif self._unproven.repeat(place):
            return
        else:
            self._unproven.add(place, time_ns)
        self._is_new = True

    def _is_proven(self, text: str) -> bool:
        """Return True if the authority signed it, or one that a rotation led to; whatever is revoked or over."""
        if not self._trusts or not self._left:
            return False
        chain = read_chain(text.encode())
        if isinstance(chain, StatementFault):
            return False
        keys = {key for trust in self._trusts for key in (trust.active, trust.standby)}
        if chain[-1].signer not in keys:
            return False
        self._left -= 1
        if not any(trust.has_signed(chain) for trust in self._trusts):
            return False
        newer = self._trusts[-1].rotate(chain[0]) if isinstance(chain[0].statement, Rotation) else None
        if isinstance(newer, Trust):
            self._trusts = [*self._trusts[-TRUSTS_MAX + 1 :], newer]
        return True

    def describe(self) -> list[LogAction]:
        """Write what is kept, unless the log already ends with the same."""
        if not self._is_new:
            return []
        self._is_new = False
        said = [*self._proven.said.items(), *self._unproven.said.items()]
        entries = {f"{robot} {time_ns} {number}": text for number, ((robot, text), time_ns) in enumerate(said)}
        return [WriteMetadata(self._log, STATEMENTS_NAME, entries, lasts=True)]


class _Room:
    """Statements of one worth, each with the time when it was said first, the one last that was repeated last."""

    def __init__(self) -> None:
        self.said: OrderedDict[tuple[str, str], int] = OrderedDict()
        self._bytes = 0

    def repeat(self, place: tuple[str, str]) -> bool:
        """Note that a statement was repeated. False if it is not here."""
        if place not in self.said:
            return False
        self.said.move_to_end(place)
        return True

    def add(self, place: tuple[str, str], time_ns: int) -> None:
        self.said[place] = time_ns
        self._bytes += len(place[1].encode())
        while self._bytes > STATEMENTS_MAX_BYTES:
            self.remove(next(iter(self.said)), 0)

    def remove(self, place: tuple[str, str], otherwise_ns: int) -> int:
        """Remove a statement, if it is here. Returns when it was said first."""
        if place not in self.said:
            return otherwise_ns
        self._bytes -= len(place[1].encode())
        return self.said.pop(place)

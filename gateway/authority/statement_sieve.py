"""The choice of the statements that a robot verifies in a tick: no flood of them keeps a revocation out. Pure.

A signature costs a hundred times as much as a look at the text. So the text alone says of which kind a statement
claims to be, and each kind has room of its own: what is junk, stale or of another authority is in nobody's way.
Within a kind chance decides, since whoever floods would find out any other order.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from enum import Enum
from random import SystemRandom
from typing import Any, Final, Generic, TypeVar

from gateway.authority.admission import SignedAdmission
from schemas.authority.proof import ALGORITHM, statement_id

WORDS_PER_TICK: Final = 4
"""New lists of revocations, and rotations, that are verified in a tick: one signature each, 0.5 ms in all."""

OTHERS_PER_TICK: Final = 1
"""All other statements that are verified in a tick: up to three signatures each."""

KEPT_WAITING: Final = 16
"""Statements of a kind that wait for the next tick; of more than that, chance drops some."""


class StatementKind(Enum):
    """The kind of a statement, by its text alone: what it says may be forged."""

    WORD = "a newer list of revocations, or rotation, in the name of the authority or the standby"
    KNOWN = "a grant that was verified"
    NEW = "a grant in the name of the authority"
    QUESTION = "nothing: somebody asks the robot who it is"
    REST = "whatever else"


_Item = TypeVar("_Item")
_CHANCE: Final = SystemRandom()


class StatementSieve(Generic[_Item]):
    """Statements that wait to be verified, by kind."""

    def __init__(
        self,
        admission: SignedAdmission,
        sample: Callable[[list[Any], int], list[Any]] = _CHANCE.sample,
    ) -> None:
        """Nothing waits.

        Args:
            admission: knows the authority's keys, the newest serials, and the grants that were verified.
            sample: draws so many of a list.
        """
        self._admission = admission
        self._sample = sample
        self._waiting: dict[StatementKind, list[_Item]] = {kind: [] for kind in StatementKind}
        # The kind that was chosen last is the last to be chosen again.
        self._turns: list[StatementKind] = [kind for kind in StatementKind if kind is not StatementKind.WORD]

    def choose(self, arrived: Iterable[tuple[bytes, _Item]]) -> list[_Item]:
        """The statements that are verified in this tick, of those that have arrived and those that waited.

        Args:
            arrived: the text of each, and what stands for it.
        """
        for text, item in arrived:
            self._waiting[self.kind_of(text)].append(item)
        chosen = self._draw(StatementKind.WORD, WORDS_PER_TICK)
        for _ in range(OTHERS_PER_TICK):
            kind = next((one for one in self._turns if self._waiting[one]), None)
            if kind is not None:
                self._turns.remove(kind)
                self._turns.append(kind)
                chosen += self._draw(kind, 1)
        for kind, items in self._waiting.items():
            if len(items) > KEPT_WAITING:
                self._waiting[kind] = self._sample(items, KEPT_WAITING)
        return chosen

    def kind_of(self, text: bytes) -> StatementKind:
        """The kind that a statement claims to be of."""
        if not text:
            return StatementKind.QUESTION
        body, _, proofs = text.partition(b"\n")
        if (word := _WORD.match(body)) is not None:
            return StatementKind.WORD if self._is_news(word, proofs) else StatementKind.REST
        if body.startswith(_GRANT):
            if self._admission.known(statement_id(body)) is not None:
                return StatementKind.KNOWN
            if text.rstrip().rpartition(b"\n")[2].startswith(_by(self._admission.trust.active)):
                return StatementKind.NEW
        return StatementKind.REST

    def _draw(self, kind: StatementKind, most: int) -> list[_Item]:
        """Take so many of those that wait."""
        waiting = self._waiting[kind]
        places = self._sample(list(range(len(waiting))), min(most, len(waiting)))
        chosen = [waiting[place] for place in places]
        self._waiting[kind] = [item for place, item in enumerate(waiting) if place not in places]
        return chosen

    def _is_news(self, word: re.Match[bytes], proofs: bytes) -> bool:
        trust = self._admission.trust
        is_rotation, serial = word[1] == b"rotation", int(word[2])
        if serial <= (trust.rotation if is_rotation else trust.list_serial):
            return False
        signers = (trust.standby,) if is_rotation else (trust.active, trust.standby)
        return proofs.startswith(tuple(map(_by, signers)))


def _by(key: bytes) -> bytes:
    """The beginning of the line of a signature of this key."""
    return f"{ALGORITHM} {key.hex()} ".encode()


_WORD: Final = re.compile(rb'\{"kind":"(revocations|rotation)","serial":(\d{1,16}),')
_GRANT: Final = b'{"kind":"grant",'

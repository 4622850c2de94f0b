"""The order in which minutes are run again: what is rare among them first. Pure.

A minute is as novel as the rarest thing that happened in it: of all events, refusals and limits that bound a
command, the one that fewest minutes have. Of the minutes with the same rarest thing one comes first, and the
others wait for the next round, so that soon there was one of each.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from math import inf
from typing import Final

import msgspec

from schemas.decisions import Decision, SafetyEvent, Verdict

WITNESSES: Final = ("safety/decision", "safety/event")
"""The subjects that say what happened in a minute."""


class Novelty(msgspec.Struct, frozen=True):
    """The place of a minute in the order.

    Attributes:
        minute: its number among all.
        rarest: the rarest thing in it; empty if nothing was in it but drive commands that were carried out.
        minutes: so many minutes have that thing.
    """

    minute: int
    rarest: str
    minutes: int


def happenings(message: object) -> Iterator[str]:
    """The things that a message says have happened, in words that are the same for alike ones."""
    match message:
        case SafetyEvent():
            yield f"{message.kind.value} {message.reason.value}"
        case Decision():
            if message.verdict is Verdict.REFUSED:
                yield f"{message.request} refused: {message.reason.value}"
            elif message.request != "drive":
                yield message.request
            yield from (f"{message.request} bound by {bound.value}" for bound in message.bound_by)
        case _:
            pass


def by_novelty(minutes: Sequence[Collection[str]]) -> list[Novelty]:
    """Return the order of minutes, by what happened in each."""
    counts = Counter(thing for minute in minutes for thing in set(minute))
    found = []
    for number, minute in enumerate(minutes):
        count, rarest = min(((counts[thing], thing) for thing in minute), default=(0, ""))
        found.append(Novelty(number, rarest, count))
    rounds: Counter[str] = Counter()
    keys: dict[int, tuple[float, int, str]] = {}
    for one in found:
        keys[one.minute] = (rounds[one.rarest] if one.rarest else inf, one.minutes, one.rarest)
        rounds[one.rarest] += 1
    return sorted(found, key=lambda one: keys[one.minute])

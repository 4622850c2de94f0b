"""Times of which logs lack the states of a robot's arbiter, though its gateway was there and said them.

Logs that lost nothing, by the account of their recorder, are not looked into.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import chain
from typing import Final

import msgspec

from recorder.encoding.event_digest import KEPT_NS
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress, Row, Selection, decoded_rows
from recorder.reading.survey import survey
from recorder.record.accounting import COMPLETENESS_NAME, KeyReport
from recorder.review.rerun.comparison import BATCH_NS
from schemas.decisions import SafetyState, is_same_run

STATES: Final = "safety/state"

HOLE_NS: Final = KEPT_NS
"""The arbiter says its state every 50 ms; a shorter time is no hole. A digest leaves out as much."""

LONGEST_NS: Final = 1_800_000_000_000
"""Of a longer hole its end counts: a gateway keeps some ten minutes of its journal, and seldom more."""

FOUND_MAX: Final = 20_000
"""Holes that are found in logs; later ones are told as missing."""

JOINT_NS: Final = 5_000_000_000
"""Time at the ends of two files between which a hole may be."""


class StateHole(msgspec.Struct, frozen=True):
    """A time without states of a robot's arbiter. All times are nanoseconds since 1970.

    Attributes:
        robot: as the review calls it.
        key: the beginning of its keys, root and name.
        from_ns, to_ns: what was published from then on, and before then, may be missing. Batches hold what was
            before the last state, too.
        log_from_ns, log_to_ns: the log times of the last state before it, and of the first one behind it.
        late_ns: the state before it was received so much later than it was published.
    """

    robot: str
    key: str
    from_ns: int
    to_ns: int
    log_from_ns: int
    log_to_ns: int
    late_ns: int


def pieces(hole: StateHole, length_ns: int) -> Iterator[StateHole]:
    """Yield parts of a hole, one behind the other, each of this length at most."""
    from_ns, log_from_ns = hole.from_ns, hole.log_from_ns
    while hole.to_ns - from_ns > length_ns:
        to_ns = from_ns + length_ns
        log_to_ns = min(max(to_ns + hole.late_ns, log_from_ns), hole.log_to_ns)
        yield msgspec.structs.replace(
            hole, from_ns=from_ns, to_ns=to_ns, log_from_ns=log_from_ns, log_to_ns=log_to_ns
        )
        from_ns, log_from_ns = to_ns, log_to_ns
    yield msgspec.structs.replace(hole, from_ns=from_ns, log_from_ns=log_from_ns)


def holes(logs: Sequence[LogFile], faults: Faults, progress: Progress = lambda _: None) -> list[StateHole]:
    """Return the holes of logs, by their log times.

    Args:
        logs: in the order of their beginnings.
        faults: takes what cannot be read.
        progress: is called with no bytes: they are read for another question.
    """
    found: set[StateHole] = set()
    for suspect in _suspects(logs):
        last: dict[str, tuple[int, int, SafetyState]] = {}
        for row, state in chain.from_iterable(_states(suspect, part, faults, progress) for part in suspect.parts):
            robot = row.topic.robot
            was, last[robot] = last.get(robot), (row.log_ns, row.sequence, state)
            if len(found) >= FOUND_MAX:
                break
            if was is not None and _is_hole(was[1], was[2], row.sequence, state):
                found.add(
                    StateHole(
                        robot,
                        row.topic.name.removesuffix(f"/{STATES}"),
                        max(was[2].time_ns, state.time_ns - LONGEST_NS) - BATCH_NS,
                        state.time_ns + BATCH_NS,
                        max(was[0], row.log_ns - LONGEST_NS),
                        row.log_ns,
                        was[0] - was[2].time_ns,
                    )
                )
    return sorted(found, key=lambda one: (one.log_from_ns, one.robot))


class _Suspect(msgspec.Struct, frozen=True):
    """A place to look for a hole.

    Attributes:
        logs: that may hold the states.
        parts: ranges of log times, one behind the other.
        robots: whose states are looked at; None looks at all.
    """

    logs: list[LogFile]
    parts: list[tuple[int, int]]
    robots: frozenset[str] | None


def _states(
    suspect: _Suspect, part: tuple[int, int], faults: Faults, progress: Progress
) -> Iterator[tuple[Row, SafetyState]]:
    robots = suspect.robots
    selection = Selection(
        lambda topic: topic.subject == STATES and (robots is None or topic.robot in robots),
        *part,
        is_digested=True,
        is_filled=True,
    )
    for row, state in decoded_rows(suspect.logs, selection, faults, lambda _: progress(0)):
        if isinstance(state, SafetyState):
            yield row, state


def _is_hole(was_sequence: int, was: SafetyState, sequence: int, state: SafetyState) -> bool:
    """Report whether states between these two are missing: the first one of a run has the sequence 0."""
    if state.time_ns - was.time_ns <= HOLE_NS:
        return False
    return sequence != was_sequence + 1 if is_same_run(was.tick, state.tick) else sequence > 0


def _suspects(logs: Sequence[LogFile]) -> Iterator[_Suspect]:
    """Yield the logs whose recorder lost states or does not say, and the times between two logs."""
    of_robots: dict[str, list[LogFile]] = defaultdict(list)
    for log in logs:
        accounts = survey([log], Faults()).metadata.get(COMPLETENESS_NAME)
        losers = None if accounts is None else frozenset(_losers(accounts, log))
        if log.end_ns and losers != frozenset():
            # The last state before a hole may be in the file before; of hundreds of robots the others' need not be
            # opened.
            its = [one for one in logs if one.robots & log.robots or not (one.robots and log.robots)]
            yield _Suspect(its, [(max(0, log.start_ns - JOINT_NS), log.end_ns + 1)], losers)
        for root, name in sorted(log.robots):
            of_robots[f"{root}/{name}" if name in log.namesakes else name].append(log)
    for robot, its in of_robots.items():
        end_ns = 0
        for log in its:
            if end_ns and log.start_ns - end_ns > HOLE_NS:
                ends = [(max(0, end_ns - JOINT_NS), end_ns + 1), (log.start_ns, log.start_ns + JOINT_NS)]
                yield _Suspect(its, ends, frozenset({robot}))
            end_ns = max(end_ns, log.end_ns)


def _losers(accounts: dict[str, str], log: LogFile) -> Iterator[str]:
    """Yield the robots of whose states a recorder lost some, by its account."""
    for root, name in log.robots:
        with suppress(msgspec.MsgspecError):
            text = accounts.get(f"{root}/{name}/{STATES}", "{}")
            if msgspec.json.decode(text, type=KeyReport).lost:
                yield f"{root}/{name}" if name in log.namesakes else name

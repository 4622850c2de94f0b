"""Asks one recorder after the other for what is missing, and hands over what is to be written. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Final

from recorder.backfill.answers import Conversation
from recorder.backfill.excerpt import LoggedBytes
from recorder.backfill.filling import Filling
from recorder.backfill.questions import questions
from schemas.recording import Backfill, BackfillPiece

BACKFILLED_FROM: Final = "cruiser.backfilled_from"
"""The entry of a channel's metadata that names the recorder which sent its messages."""


def fill_holes(
    filling: Filling,
    topics: Mapping[str, set[str]],
    recorders: Sequence[str],
    ask: Callable[[str, Backfill], Iterable[BackfillPiece]],
    write: Callable[[LoggedBytes, str], None],
    learn: Callable[[], None],
    stopped: Callable[[], bool],
) -> tuple[list[str], list[str]]:
    """Ask recorders as long as something may be missing.

    Args:
        filling: the holes.
        topics: those that each robot is known to publish, by the beginning of its keys.
        recorders: their names, in the order in which they are asked.
        ask: sends a request to a recorder, and streams the pieces.
        write: takes what was missing, and the name of the recorder that sent it.
        learn: has ``filling`` hold what was written: the next recorder may send it again.
        stopped: ends it.

    Returns:
        The recorders that answered, and what they said besides.
    """
    answered: list[str] = []
    details: dict[str, None] = {}
    for recorder in recorders:
        holes = filling.open_holes
        if not holes or stopped():
            break
        if answered:
            learn()
        is_heard = True
        for question in questions(holes, topics):
            # Who has not answered the first question is not asked the others.
            conversation = Conversation(partial(ask, recorder), question)
            if is_heard and not stopped():
                for message in _missing(conversation, filling, stopped):
                    write(message, recorder)
                is_heard = conversation.is_heard
            if not conversation.is_over:
                filling.give_up(question)
            details |= dict.fromkeys(f"{recorder}: {one}" for one in conversation.details)
        filling.end_round()
        if is_heard:
            answered.append(recorder)
    return answered, list(details)


def _missing(conversation: Conversation, filling: Filling, stopped: Callable[[], bool]) -> Iterator[LoggedBytes]:
    for answer in conversation.answers(stopped):
        yield from filter(filling.add, answer.messages)
        filling.settle(answer.next_ns)

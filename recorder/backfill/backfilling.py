"""Asks one recorder after the other for what is missing, and hands over what is to be written. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Final

from recorder.backfill.answers import Conversation
from recorder.backfill.excerpt import LoggedBytes
from recorder.backfill.filling import Filling
from recorder.backfill.questions import questions
from schemas.recording import Backfill, BackfillPiece

BACKFILLED_FROM: Final = "cruiser.backfilled_from"
"""The entry of a channel's metadata that names the recorder which sent its messages."""


class Backfilling:
    """One backfill.

    Args:
        ask: sends a request to a recorder, and streams the pieces.
        filling: the holes.
        topics: what each robot is known to say, by the beginning of its keys.
        write: takes what was missing, and the name of the recorder that sent it.
        learn: has ``filling`` hold what was written: the next recorder may send it again.
    """

    def __init__(
        self,
        ask: Callable[[str, Backfill], Iterable[BackfillPiece]],
        filling: Filling,
        topics: Mapping[str, set[str]],
        write: Callable[[LoggedBytes, str], None],
        learn: Callable[[], None],
    ) -> None:
        self._ask = ask
        self._filling = filling
        self._topics = topics
        self._write = write
        self._learn = learn
        self.details: list[str] = []
        """What the recorders said besides."""

    def run(self, recorders: Sequence[str], stopped: Callable[[], bool]) -> list[str]:
        """Ask as long as something may be missing. Returns those who answered."""
        answered: list[str] = []
        for recorder in recorders:
            holes = self._filling.open_holes
            if not holes or stopped():
                break
            if answered:
                self._learn()
            is_heard = True
            for question in questions(holes, self._topics):
                # Who has not answered the first question is not asked the others.
                conversation = Conversation(partial(self._ask, recorder), question)
                if is_heard and not stopped():
                    self._hear(conversation, recorder, stopped)
                    is_heard = conversation.is_heard
                if not conversation.is_over:
                    self._filling.give_up(question)
                said = [f"{recorder}: {one}" for one in conversation.details]
                self.details = list(dict.fromkeys(self.details + said))
            self._filling.end_round()
            if is_heard:
                answered.append(recorder)
        return answered

    def _hear(self, conversation: Conversation, recorder: str, stopped: Callable[[], bool]) -> None:
        for answer in conversation.answers(stopped):
            for message in answer.messages:
                if self._filling.take(message):
                    self._write(message, recorder)
            self._filling.settle(answer.next_ns)

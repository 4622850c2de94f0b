"""Reads the pieces of an answer, and asks again until all is answered. What comes is untrusted. Pure."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from io import BytesIO
from typing import Final

import msgspec
from mcap import records

from recorder.backfill.excerpt import PIECE_NAME, LoggedBytes
from recorder.backfill.questions import BackfillQuestion
from recorder.mcap.channel import LogChannel
from recorder.mcap.reader import Fault, LoggedMessage, Walked, walk
from recorder.mcap.writer import MESSAGE_ENCODING, SCHEMA_ENCODING
from schemas.recording import Backfill, BackfillPiece

FIRST_BYTES: Final = 1_000_000
"""Bytes that the first request asks for; each further one asks for twice as much."""

MOST_BYTES: Final = 16_000_000
"""Bytes of the largest request. After a lost piece half as much is asked for: the link may drop more."""

LEAST_BYTES: Final = 65_536

TRIES: Final = 8
"""Requests in a row that get no further, then the question is given up."""

Ask = Callable[[Backfill], Iterable[BackfillPiece]]
"""Sends a request and streams the pieces; fewer if the link fails."""


class Answer(msgspec.Struct, frozen=True):
    """A part of the answer to a question.

    Attributes:
        messages: of one piece.
        next_ns: all that was published before this time has come.
    """

    messages: list[LoggedBytes]
    next_ns: int


class Conversation:
    """One question to one recorder.

    Attributes:
        answered_ns: all that was published before this time has come.
        details: other remarks of the recorder.
        is_heard: it has answered at all.
    """

    def __init__(self, ask: Ask, question: BackfillQuestion) -> None:
        self._ask = ask
        self._question = question
        self._max_bytes = FIRST_BYTES
        self.answered_ns = question.from_ns
        self.details: list[str] = []
        self.is_heard = False

    @property
    def is_over(self) -> bool:
        """All that was asked for has come."""
        return self.answered_ns >= self._question.to_ns

    def answers(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[Answer]:
        """The answers; without all of them if the recorder does not give them, or when it is stopped."""
        tries = 0
        while not self.is_over and tries < TRIES and not stopped():
            before_ns = self.answered_ns
            is_whole = yield from self._once(stopped)
            tries = tries + 1 if self.answered_ns == before_ns else 0
            grown = self._max_bytes * 2 if is_whole else self._max_bytes // 2
            self._max_bytes = min(max(grown, LEAST_BYTES), MOST_BYTES)

    def _once(self, stopped: Callable[[], bool]) -> Generator[Answer, None, bool]:
        """One request. Returns whether its last piece came, and none before it was lost."""
        question = self._question
        request = Backfill(
            key=question.key, from_ns=self.answered_ns, to_ns=question.to_ns, max_bytes=self._max_bytes
        )
        for number, piece in enumerate(self._ask(request)):
            self.is_heard = True
            if piece.detail and piece.detail not in self.details:
                self.details.append(piece.detail)
            if not piece.ok:
                return False
            messages = read_piece(piece, number, self.answered_ns)
            if messages is None or not self.answered_ns <= piece.next_ns <= question.to_ns:
                return False
            self.answered_ns = piece.next_ns
            yield Answer(messages, piece.next_ns)
            if piece.is_last:
                return True
            if stopped():
                return False
        return False


def read_piece(piece: BackfillPiece, number: int, from_ns: int) -> list[LoggedBytes] | None:
    """The messages of a piece; None if it is damaged, or not the next one.

    Args:
        piece: the received one.
        number: of pieces that came before it in this answer.
        from_ns: the end of those.
    """
    if not piece.mcap:
        # The last piece has messages if any has: of an empty one none before it can be lost.
        return [] if piece.is_last and not number and not piece.messages else None
    reader = _PieceReader()
    for walked in walk(BytesIO(piece.mcap), len(piece.mcap)):
        if not reader.add(walked):
            return None
    expected = {"number": str(number), "from_ns": str(from_ns)}
    is_next = reader.about == expected and len(reader.messages) == piece.messages
    return reader.messages if is_next else None


class _PieceReader:
    def __init__(self) -> None:
        self.messages: list[LoggedBytes] = []
        self.about: dict[str, str] = {}
        self._schemas: dict[int, records.Schema] = {}
        self._channels: dict[int, LogChannel] = {}

    def add(self, walked: Walked) -> bool:
        """Add a record. Return False if nothing of the piece can be believed."""
        match walked:
            case LoggedMessage():
                channel = self._channels.get(walked.channel_id)
                if channel is None:
                    return False
                times = walked.log_ns, walked.publish_ns
                self.messages.append(LoggedBytes(channel, walked.sequence, *times, walked.data))
            case records.Schema():
                self._schemas[walked.id] = walked
            case records.Channel():
                schema = self._schemas.get(walked.schema_id)
                is_known = walked.message_encoding == MESSAGE_ENCODING
                if schema is None or not is_known or schema.encoding != SCHEMA_ENCODING:
                    return False
                self._channels[walked.id] = LogChannel(walked.id, walked.topic, schema.name, schema.data)
            case records.Metadata() if walked.name == PIECE_NAME:
                self.about = walked.metadata
            case Fault():
                return False
            case _:
                pass
        return True

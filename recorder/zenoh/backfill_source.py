"""Asks other recorders over Zenoh for what their logs hold. No Python of ours runs on Zenoh's threads."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from typing import Any, Final

import msgspec
import zenoh

from recorder.zenoh.session import open_session
from schemas import codec, keys
from schemas.exit_codes import CommandError, ExitCode
from schemas.recording import Backfill, BackfillPiece
from schemas.settings import ZenohSettings
from schemas.subjects import RECORDER_BY_VERB
from schemas.zenoh_link import reason

log = logging.getLogger(__name__)

PIECES_WAITING: Final = 256
"""More than a request brings: a piece that found no room would hold up Zenoh's own thread."""

QUERY_TIMEOUT_S: Final = 180.0
"""A request may wait for five others of 30 s each."""

LOOK_S: Final = 0.3
"""How long one query waits for recorders to be found; then it is asked again."""

PAUSE_S: Final = 0.5
"""Before a request is sent again that was refused, or that nobody answered: the link may come back."""

POLL_S: Final = 0.002
"""How often a piece is looked for."""

_COMMAND: Final = RECORDER_BY_VERB["backfill"]
_DECODER: Final = msgspec.msgpack.Decoder(BackfillPiece)


def key_matches(expression: str, topic: str) -> bool:
    """True if a Zenoh key expression matches a topic. False of what is no key expression."""
    try:
        return zenoh.KeyExpr.autocanonize(expression).includes(zenoh.KeyExpr(topic))
    except zenoh.ZError:
        return expression == topic


class BackfillSource:
    """A session from which recorders are asked, from its beginning to ``close``.

    Args:
        settings: of the session.
        root: the first chunks of the recorders' keys.
        operator: who asks.
        stopped: give up waiting.

    Raises:
        CommandError: the session cannot be opened.
    """

    def __init__(
        self, settings: ZenohSettings, root: str, operator: str, stopped: Callable[[], bool] = lambda: False
    ) -> None:
        self._root = root
        self._operator = operator
        self._stopped = stopped
        self._session = open_session(settings)

    def recorders(self, name: str, timeout_s: float) -> list[str]:
        """The recorders that are there, as soon as there are any; of that name alone unless it is ALL.

        Raises:
            CommandError: there is none.
        """
        key = keys.of_recorder(self._root, name)
        end_s = time.monotonic() + timeout_s
        while not self._stopped():
            handler: Any = zenoh.handlers.FifoChannel(PIECES_WAITING)
            replies = self._session.liveliness().get(key, handler, timeout=LOOK_S)
            found = {str(sample.key_expr).rpartition("/")[2] for sample in self._samples(replies)}
            if found:
                return sorted(found)
            if time.monotonic() >= end_s:
                break
        whom = "no recorder answers" if name == keys.ALL else f"recorder {name} does not answer"
        raise CommandError(whom, ExitCode.UNREACHABLE)

    def ask(self, recorder: str, request: Backfill) -> Iterator[BackfillPiece]:
        """The pieces of an answer, as they come; fewer if the link fails.

        Raises:
            CommandError: the session is closed.
        """
        key = keys.recorder_command(self._root, recorder, self._operator, _COMMAND.verb)
        try:
            replies: Any = self._session.get(
                key,
                zenoh.handlers.FifoChannel(PIECES_WAITING),
                payload=codec.encode(request),
                encoding=_COMMAND.encoding,
                target=zenoh.QueryTarget.BEST_MATCHING,
                # All pieces have one key, and all of them count.
                consolidation=zenoh.ConsolidationMode.NONE,
                # The present goes first on a thin link.
                priority=zenoh.Priority.BACKGROUND,
                timeout=QUERY_TIMEOUT_S,
            )
        except zenoh.ZError as error:
            raise CommandError(f"cannot ask: {reason(str(error))}", ExitCode.UNREACHABLE) from error
        is_answered = False
        for sample in self._samples(replies):
            if str(sample.key_expr) != key:
                continue
            try:
                piece = _DECODER.decode(sample.payload.to_bytes())
            except msgspec.MsgspecError as error:
                log.debug("a piece cannot be read: %s", error)
                return
            is_answered = piece.ok
            yield piece
        if not is_answered and not self._stopped():
            time.sleep(PAUSE_S)

    def close(self) -> None:
        """Leave Zenoh."""
        self._session.close()

    def _samples(self, replies: Any) -> Iterator[zenoh.Sample]:  # noqa: ANN401 - Zenoh's handlers have no common type
        """What comes, until nothing more will."""
        try:
            while not self._stopped():
                reply = replies.try_recv()
                if reply is None:
                    time.sleep(POLL_S)
                elif reply.ok is not None:
                    yield reply.ok
        except zenoh.ZError:
            return  # Zenoh's way to say that the query has ended.

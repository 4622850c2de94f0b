"""Asks recorders over Zenoh for what operators order, and for what their logs hold.

No Python of ours runs on Zenoh's threads.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Iterator
from typing import Any, Final, TypeVar

import zenoh

from recorder.record.admission import OPEN_TO_ALL, OrderProof
from recorder.zenoh.session import open_session, said_of
from schemas import codec, keys
from schemas.codec import PayloadFault
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.recording import Backfill, BackfillPiece, RecorderReply, Status
from schemas.requests import Request
from schemas.settings import ZenohSettings
from schemas.subjects import AUTHORITY_CHUNK, RECORDER_BY_VERB, RECORDER_CHUNK
from schemas.versions import encoding_fault, names_schema
from schemas.zenoh_link import reason

log = logging.getLogger(__name__)

REPLIES_WAITING: Final = 256
"""More than a request for a backfill brings: a piece that found no room would hold up Zenoh's own thread."""

LONGEST_S: Final = 86_400.0
"""Zenoh waits no longer than a day."""

BACKFILL_TIMEOUT_S: Final = 180.0
"""A request for a backfill may wait for five others of 30 s each."""

LOOK_S: Final = 0.3
"""Duration of one query for recorders; then it is repeated."""

PAUSE_S: Final = 0.5
"""Before a backfill is asked for again that was refused, or that nobody answered: the link may come back."""

PROOF_S: Final = 2.0
"""The longest wait for a recorder's challenge, and for its reply to a grant."""

POLL_S: Final = 0.002
"""Period at which replies are looked for."""

Answer = TypeVar("Answer", RecorderReply, BackfillPiece)


def _read(kind: type[Answer], verb: str, sample: zenoh.Sample) -> Answer | PayloadFault:
    named, known = str(sample.encoding), RECORDER_BY_VERB[verb].reply_encoding
    if named != known:
        return PayloadFault(
            f"the reply to {verb} is {encoding_fault(named, known, 'this program', 'the recorder')}"
        )
    read = codec.understand(kind, sample.payload.to_bytes())
    return read if isinstance(read, PayloadFault) else read.message


class RecorderClient:
    """A session from which recorders are asked, from its beginning to ``close``.

    Args:
        settings: of the session.
        root: the first chunks of the recorders' keys.
        operator: who asks.
        stopped: give up waiting.
        proof: signs what is asked, for recorders in signed mode, in the name of its grant; None signs nothing.

    Raises:
        CommandError: the session cannot be opened.
    """

    def __init__(
        self,
        settings: ZenohSettings,
        root: str,
        operator: str,
        stopped: Callable[[], bool] = lambda: False,
        proof: OrderProof | None = None,
    ) -> None:
        self._root = root
        self._operator = operator if proof is None else proof.name
        self._proof = proof
        self._stopped = stopped
        self._name = re.compile(rf"{re.escape(root)}/{RECORDER_CHUNK}/({keys.ROBOT_PATTERN})/.+")
        self._place = ", ".join(map(plain, said_of(settings).connect))
        self._session = open_session(settings)

    def ask(
        self, recorder: str, verb: str, request: Request, timeout_s: float
    ) -> Iterator[tuple[str, RecorderReply]]:
        """The replies to a request, each with the recorder that it is from.

        Args:
            recorder: its name; ``keys.ALL`` for all.
            verb: a row of the table of verbs, but not ``backfill``.
            request: what is asked.
            timeout_s: how long to wait for replies.
        """
        for sample in self._query(
            recorder,
            verb,
            request,
            target=zenoh.QueryTarget.ALL,
            # The replies have it too: a recorder must not wait for the link to a client that does not read.
            congestion_control=zenoh.CongestionControl.DROP,
            timeout=min(timeout_s, LONGEST_S),
        ):
            name = self._name.fullmatch(str(sample.key_expr))
            if name is None:
                continue  # Whoever answered so is no recorder of ours.
            reply = _read(RecorderReply, verb, sample)
            if isinstance(reply, RecorderReply):
                yield name[1], reply
            elif names_schema(str(sample.encoding)):
                log.warning("recorder %s: %s", name[1], plain(reply.detail))

    def recorders(self, name: str, timeout_s: float) -> list[str]:
        """The recorders that are there, as soon as there are any; of that name alone unless it is ALL.

        Raises:
            CommandError: there is none.
        """
        key = keys.of_recorder(self._root, name)
        end_s = time.monotonic() + timeout_s
        while not self._stopped():
            handler: Any = zenoh.handlers.FifoChannel(REPLIES_WAITING)
            replies = self._session.liveliness().get(key, handler, timeout=LOOK_S)
            found = {str(sample.key_expr).rpartition("/")[2] for sample in self._samples(replies)}
            if found:
                return sorted(found)
            if time.monotonic() >= end_s:
                break
        raise self.nobody(name)

    def nobody(self, name: str) -> CommandError:
        """Return the error that no recorder of this name answers, or none at all if it is ALL."""
        info = self._session.info
        if not info.peers_zid() and not info.routers_zid():
            who = f"no Zenoh node answered at {self._place}"
        else:
            who = "no recorder answers" if name == keys.ALL else f"recorder {name} does not answer"
        return CommandError(who, ExitCode.UNREACHABLE)

    def backfill(self, recorder: str, request: Backfill) -> Iterator[BackfillPiece]:
        """The pieces of an answer, as they come; fewer if the link fails.

        Raises:
            CommandError: the session is closed.
        """
        is_answered = False
        for sample in self._query(
            recorder,
            "backfill",
            request,
            target=zenoh.QueryTarget.BEST_MATCHING,
            # The present goes first on a thin link.
            priority=zenoh.Priority.BACKGROUND,
            timeout=BACKFILL_TIMEOUT_S,
        ):
            if str(sample.key_expr) != self._key(recorder, "backfill"):
                continue
            piece = _read(BackfillPiece, "backfill", sample)
            if isinstance(piece, PayloadFault):
                log.warning("recorder %s: a piece cannot be read: %s", recorder, plain(piece.detail))
                return
            is_answered = piece.ok
            yield piece
        if not is_answered and not self._stopped():
            time.sleep(PAUSE_S)

    def close(self) -> None:
        """Leave Zenoh."""
        self._session.close()

    def _key(self, recorder: str, verb: str) -> str:
        return keys.recorder_command(self._root, recorder, self._operator, verb)

    def _attachment(self, recorder: str, verb: str, payload: bytes) -> bytes | None:
        """The proof of an order: the recorder is shown the grant, and gives the challenge to echo."""
        if self._proof is None or verb in OPEN_TO_ALL or recorder == keys.ALL:
            return None
        replies = self.ask(recorder, "status", Status(), PROOF_S)
        challenge = next((reply.health.challenge for _, reply in replies if reply.health.challenge), b"")
        if not challenge:
            return None  # It is in open mode, or does not answer: then nor will it what is asked.
        key = keys.of_recorder(self._root, recorder, AUTHORITY_CHUNK)
        handler: Any = zenoh.handlers.FifoChannel(REPLIES_WAITING)
        for _ in self._samples(self._session.get(key, handler, payload=self._proof.statement, timeout=PROOF_S)):
            break
        return self._proof.attachment(recorder, verb, payload, challenge)

    def _query(self, recorder: str, verb: str, request: Request | Backfill, **how: Any) -> Iterator[zenoh.Sample]:  # noqa: ANN401 - the options of Zenoh's get
        payload = codec.encode(request)
        attachment = self._attachment(recorder, verb, payload)
        try:
            replies: Any = self._session.get(
                self._key(recorder, verb),
                zenoh.handlers.FifoChannel(REPLIES_WAITING),
                payload=payload,
                attachment=attachment,
                encoding=RECORDER_BY_VERB[verb].encoding,
                # Several replies may have one key, and all of them count.
                consolidation=zenoh.ConsolidationMode.NONE,
                **how,
            )
        except zenoh.ZError as error:
            raise CommandError(f"cannot ask: {reason(str(error))}", ExitCode.UNREACHABLE) from error
        return self._samples(replies)

    def _samples(self, replies: Any) -> Iterator[zenoh.Sample]:  # noqa: ANN401 - Zenoh's handlers have no common type
        """Yield the replies until the query is over."""
        try:
            while not self._stopped():
                reply = replies.try_recv()
                if reply is None:
                    time.sleep(POLL_S)
                elif reply.ok is not None:
                    yield reply.ok
        except zenoh.ZError:
            return  # Zenoh's way to say that the query has ended.

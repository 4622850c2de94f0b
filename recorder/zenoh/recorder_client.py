"""Asks recorders over Zenoh.

No Python of ours runs on Zenoh's threads.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Iterator
from typing import Any, Final

import zenoh

from schemas import codec, keys
from schemas.codec import PayloadFault, encoding_fault, names_schema
from schemas.command_line import CommandError, ExitCode, plain
from schemas.recording import RecorderReply
from schemas.requests import Request
from schemas.settings import ZenohSettings
from schemas.subjects import RECORDER_BY_VERB, RECORDER_CHUNK
from schemas.zenoh_session import close_session, is_connected, join, place, reason

log = logging.getLogger(__name__)

REPLIES_WAITING: Final = 256
"""More than there are recorders: a reply that found no room would hold up Zenoh's own thread."""

LONGEST_S: Final = 86_400.0
"""Zenoh waits no longer than a day."""

POLL_S: Final = 0.002
"""Period at which replies are looked for."""


def _read(verb: str, sample: zenoh.Sample) -> RecorderReply | PayloadFault:
    named, known = str(sample.encoding), RECORDER_BY_VERB[verb].reply_encoding
    if named != known:
        return PayloadFault(
            f"the reply to {verb} is {encoding_fault(named, known, 'this program', 'the recorder')}"
        )
    read = codec.understand(RecorderReply, sample.payload.to_bytes())
    return read if isinstance(read, PayloadFault) else read.message


class RecorderClient:
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
        self,
        settings: ZenohSettings,
        root: str,
        operator: str,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self._root = root
        self._operator = operator
        self._stopped = stopped
        self._name = re.compile(rf"{re.escape(root)}/{RECORDER_CHUNK}/({keys.ROBOT_PATTERN})/.+")
        self._place = place(settings)
        self._session = join(settings)

    def ask(
        self, recorder: str, verb: str, request: Request, timeout_s: float
    ) -> Iterator[tuple[str, RecorderReply]]:
        """The replies to a request, each with the recorder that it is from.

        Args:
            recorder: its name; ``keys.ALL`` for all.
            verb: a row of the table of verbs.
            request: what is asked.
            timeout_s: how long to wait for replies.
        """
        try:
            replies: Any = self._session.get(
                keys.recorder_command(self._root, recorder, self._operator, verb),
                zenoh.handlers.FifoChannel(REPLIES_WAITING),
                payload=codec.encode(request),
                encoding=RECORDER_BY_VERB[verb].encoding,
                target=zenoh.QueryTarget.ALL,
                # Two recorders on different hosts may have one name, and so one key.
                consolidation=zenoh.ConsolidationMode.NONE,
                # The replies have it too: a recorder must not wait for the link to a client that does not read.
                congestion_control=zenoh.CongestionControl.DROP,
                timeout=min(timeout_s, LONGEST_S),
            )
        except zenoh.ZError as error:
            raise CommandError(f"cannot ask: {reason(str(error))}", ExitCode.UNREACHABLE) from error
        for sample in self._samples(replies):
            name = self._name.fullmatch(str(sample.key_expr))
            if name is None:
                continue  # Whoever answered so is no recorder of ours.
            reply = _read(verb, sample)
            if isinstance(reply, RecorderReply):
                yield name[1], reply
            elif names_schema(str(sample.encoding)):
                log.warning("recorder %s: %s", name[1], plain(reply.detail))

    def nobody(self, name: str) -> CommandError:
        """Return the error that no recorder of this name answers, or none at all if it is ALL."""
        if not is_connected(self._session):
            who = f"no Zenoh node answered at {self._place}"
        else:
            who = "no recorder answers" if name == keys.ALL else f"recorder {name} does not answer"
        return CommandError(who, ExitCode.UNREACHABLE)

    def close(self) -> None:
        """Leave Zenoh."""
        close_session(self._session)

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

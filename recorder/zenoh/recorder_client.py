"""Asks recorders over Zenoh."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final

import msgspec
import zenoh

from recorder.zenoh.session import open_session
from schemas import keys
from schemas.recording import RecorderReply
from schemas.requests import Request
from schemas.settings import ZenohSettings
from schemas.subjects import RECORDER_BY_VERB, RECORDER_CHUNK

REPLIES_WAITING: Final = 256

LONGEST_S: Final = 86_400.0
"""Zenoh waits no longer than a day."""

_DECODER = msgspec.msgpack.Decoder(RecorderReply)


class RecorderClient:
    """A session from which recorders are asked, from its beginning to ``close``.

    Args:
        settings: of the session.
        root: the first chunks of the recorders' keys.
        operator: who asks.

    Raises:
        CommandError: the session cannot be opened.
    """

    def __init__(self, settings: ZenohSettings, root: str, operator: str) -> None:
        self._root = root
        self._operator = operator
        self._name = re.compile(rf"{re.escape(root)}/{RECORDER_CHUNK}/({keys.ROBOT_PATTERN})/.+")
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
        row = RECORDER_BY_VERB[verb]
        replies: Any = self._session.get(
            keys.recorder_command(self._root, recorder, self._operator, verb),
            zenoh.handlers.FifoChannel(REPLIES_WAITING),
            payload=msgspec.msgpack.encode(request),
            encoding=row.encoding,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            # The replies have it too: a recorder must not wait for the link to a client that does not read.
            congestion_control=zenoh.CongestionControl.DROP,
            timeout=min(timeout_s, LONGEST_S),
        )
        for reply in replies:
            if reply.ok is None:
                continue
            name = self._name.fullmatch(str(reply.ok.key_expr))
            if name is None:
                continue  # Whoever answered so is no recorder of ours...
            try:
                yield name[1], _DECODER.decode(reply.ok.payload.to_bytes())
            except msgspec.MsgspecError:
                continue  # ...nor who says what none says.

    def close(self) -> None:
        """Leave Zenoh."""
        self._session.close()

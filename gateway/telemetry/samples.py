"""Samples and liveliness tokens as they arrive, and the newest of those that late joiners ask for. Pure."""

from __future__ import annotations

from collections import deque
from itertools import islice

import msgspec

from schemas.subjects import KEPT_PIECE


class Received(msgspec.Struct, frozen=True):
    """A sample, undecoded."""

    key: str
    encoding: str
    payload: bytes
    attachment: bytes = b""


class Missed(msgspec.Struct, frozen=True):
    """More samples came than can wait: some may be missing from those before this."""


class TokenChange(msgspec.Struct, frozen=True):
    """A gateway's liveliness token has appeared or gone."""

    key: str
    present: bool


Arrival = Received | Missed | TokenChange


class KeptSamples:
    """The newest payloads of one subject. The nth one that was added has the sequence n.

    Args:
        max_bytes: of payloads; beyond it the oldest go.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._payloads: deque[bytes] = deque()
        self._bytes = 0
        self._oldest = 0

    def add(self, payload: bytes) -> None:
        """The newest one."""
        self._payloads.append(payload)
        self._bytes += len(payload)
        while self._bytes > self._max_bytes:
            self._bytes -= len(self._payloads.popleft())
            self._oldest += 1

    def piece(self, first: int) -> list[bytes]:
        """Those from this sequence on, or from the oldest that is kept: a bounded number."""
        start = max(0, first - self._oldest)
        return list(islice(self._payloads, start, start + KEPT_PIECE))

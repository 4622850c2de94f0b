"""Received samples and liveliness tokens, and recent samples for late joiners. Pure."""

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
    """A queue overflowed: samples before this may be missing."""


class TokenChange(msgspec.Struct, frozen=True):
    """A gateway's liveliness token appeared or disappeared."""

    key: str
    present: bool


Arrival = Received | Missed | TokenChange


class KeptSamples:
    """The newest payloads of one subject, up to a number of bytes. The nth one that was added has sequence n."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._payloads: deque[bytes] = deque()
        self._bytes = 0
        self._oldest = 0

    def add(self, payload: bytes) -> None:
        self._payloads.append(payload)
        self._bytes += len(payload)
        while self._bytes > self._max_bytes:
            self._bytes -= len(self._payloads.popleft())
            self._oldest += 1

    def piece(self, first: int) -> list[bytes]:
        """Return a bounded number of payloads from this sequence on, or from the oldest one stored."""
        start = max(0, first - self._oldest)
        return list(islice(self._payloads, start, start + KEPT_PIECE))

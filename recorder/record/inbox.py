"""Samples that wait to be recorded: bounded by their bytes, the oldest go first, and are counted. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final

from recorder.encoding.received_sample import ReceivedSample, copy

SAMPLE_BYTES: Final = 500
"""Memory that a sample takes besides its payload and key, about."""


class SampleInbox:
    """A queue of samples.

    Args:
        limit_bytes: memory of what may wait, payloads, keys and all.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._waiting: deque[tuple[ReceivedSample, int]] = deque()
        self.bytes = 0
        """Bytes that wait."""

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, sample: ReceivedSample) -> list[tuple[str, int]]:
        """Have a sample wait. Returns key and receipt of those that are dropped for it, which may be itself."""
        size = len(sample.payload) + len(sample.attachment) + len(sample.key) + SAMPLE_BYTES
        self._waiting.append((copy(sample), size))
        self.bytes += size
        if self.bytes <= self._limit_bytes:
            return []
        dropped = []
        while self.bytes > self._limit_bytes:
            oldest, size = self._waiting.popleft()
            self.bytes -= size
            dropped.append((oldest.key, oldest.received_ns))
        return dropped

    def take(self, limit: int, limit_bytes: int) -> Iterator[ReceivedSample]:
        """Return the oldest samples: at most so many, and about so many bytes."""
        taken_bytes = 0
        for _ in range(min(limit, len(self._waiting))):
            sample, size = self._waiting.popleft()
            self.bytes -= size
            yield sample
            taken_bytes += size
            if taken_bytes > limit_bytes:
                return

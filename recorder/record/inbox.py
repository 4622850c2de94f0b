"""Samples that wait to be recorded: bounded by their bytes, the oldest go first, and are counted. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final

from recorder.encoding.sample import Sample, copy

SAMPLE_BYTES: Final = 500
"""What a sample takes in memory besides its payload and key, about."""


class Inbox:
    """A queue of samples.

    Args:
        limit_bytes: payloads, keys and all, that may wait.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._waiting: deque[tuple[Sample, int]] = deque()
        self.bytes = 0
        """Bytes that wait."""

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, sample: Sample) -> list[tuple[str, int]]:
        """Have a sample wait. Key and receipt of those that must go instead; of this one if it is too much."""
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

    def take(self, limit: int, limit_bytes: int) -> Iterator[Sample]:
        """The oldest samples: so many, and about so many bytes, at most."""
        taken_bytes = 0
        for _ in range(min(limit, len(self._waiting))):
            sample, size = self._waiting.popleft()
            self.bytes -= size
            yield sample
            taken_bytes += size
            if taken_bytes > limit_bytes:
                return

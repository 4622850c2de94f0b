"""What reached the recorder and is not in its log, until it is told: one for each log, key and reason. Pure."""

from __future__ import annotations

from typing import Final

import msgspec

from recorder.encoding.key_counters import SEQUENCE_SPAN
from recorder.mcap.chunk import log_time
from schemas.keys import KEY_MAX_LENGTH
from schemas.recording import GapReason, RecordGap

KEYS_MAX: Final = 10_000
"""Gaps that wait to be told; what a log loses of further keys meanwhile is one gap of the key ``OTHER_KEYS``, and
so is what it loses of keys that are none of ours for their length."""

OTHER_KEYS: Final = "**"


class _Gap(msgspec.Struct):
    first_ns: int
    last_ns: int
    count: int = 0


class Gaps:
    """Gathers losses, and tells them together."""

    def __init__(self) -> None:
        self._gaps: dict[tuple[str, str, GapReason], _Gap] = {}
        self._sequence = 0

    def add(self, log: str, key: str, reason: GapReason, count: int, first_ns: int, last_ns: int) -> None:
        """So many samples or messages of a key, received between these times since 1970, are not in this log."""
        is_new = (log, key, reason) not in self._gaps
        if len(key) > KEY_MAX_LENGTH or (is_new and len(self._gaps) >= KEYS_MAX):
            key = OTHER_KEYS
        gap = self._gaps.setdefault((log, key, reason), _Gap(first_ns, last_ns))
        gap.first_ns = min(gap.first_ns, first_ns)
        gap.last_ns = max(gap.last_ns, last_ns)
        gap.count += count

    def tell(self, wall_ns: int) -> list[tuple[str, RecordGap]]:
        """The gaps since the last call, each with its log."""
        told = []
        for (log, key, reason), gap in self._gaps.items():
            time_ns, first_ns, last_ns = map(log_time, (wall_ns, gap.first_ns, gap.last_ns))
            told.append((log, RecordGap(time_ns, self._sequence, key, reason, first_ns, last_ns, gap.count)))
            self._sequence = (self._sequence + 1) % SEQUENCE_SPAN
        self._gaps.clear()
        return told

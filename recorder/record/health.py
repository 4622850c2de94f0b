"""The health of a recorder, from what its parts count. Pure."""

from __future__ import annotations

from collections import Counter
from typing import Final

import msgspec

from recorder.encoding.key_counters import SEQUENCE_SPAN
from recorder.record.recorder import Recorder
from schemas.recording import GapReason, RecorderHealth, RecorderState

SECOND_NS: Final = 1_000_000_000


class Vitals(msgspec.Struct, frozen=True):
    """Figures from the disk, the inbox and the door, which ``RecorderHealth`` has under the same names."""

    files: int = 0
    files_ended: int = 0
    ended_bytes: int = 0
    queue_bytes: int = 0
    disk_queue_bytes: int = 0
    disk_free_bytes: int = 0
    disk_used_bytes: int = 0
    incident_bytes: int = 0


class HealthReport:
    """Makes the health of each second.

    Args:
        recorder: its name.
        version: of the recorder.
        now_ns: when it was started.
    """

    def __init__(self, recorder: str, version: str, now_ns: int) -> None:
        self._recorder = recorder
        self._version = version
        self._started_ns = self._state_since_ns = self._last_ns = now_ns
        self._state: RecorderState | None = None
        self._sequence = 0
        self._received = self._cpu_ns = 0
        self._received_per_s = self._cpu_percent = 0.0

    def is_due(self, now_ns: int) -> bool:
        """A second has passed."""
        return now_ns - self._last_ns >= SECOND_NS

    def next(self, recorder: Recorder, vitals: Vitals, cpu_ns: int, now_ns: int, wall_ns: int) -> RecorderHealth:
        """The health of the second that has passed; ``cpu_ns`` is what the process has used by now."""
        span_ns = max(1, now_ns - self._last_ns)
        self._cpu_percent = max(0, cpu_ns - self._cpu_ns) * 100 / span_ns
        self._sequence = (self._sequence + 1) % SEQUENCE_SPAN
        health = self.now(recorder, vitals, now_ns, wall_ns)
        self._received_per_s = max(0, health.received - self._received) * SECOND_NS / span_ns
        self._received, self._cpu_ns, self._last_ns = health.received, cpu_ns, now_ns
        return msgspec.structs.replace(health, received_per_s=self._received_per_s)

    def now(self, recorder: Recorder, vitals: Vitals, now_ns: int, wall_ns: int) -> RecorderHealth:
        """The health as it is, with the rates of the last whole second."""
        if recorder.state is not self._state:
            # What it does at first, it does since the start.
            self._state_since_ns = self._started_ns if self._state is None else now_ns
            self._state = recorder.state
        lost: Counter[GapReason] = Counter()
        received = messages = missed = keys = 0
        for counters in recorder.counters:
            keys += 1
            received += counters.samples + counters.unread
            messages += counters.messages - counters.unwritten
            missed += counters.missed
            lost.update(counters.lost)
        return RecorderHealth(
            time_ns=wall_ns,
            sequence=self._sequence,
            recorder=self._recorder,
            recorder_version=self._version,
            uptime_s=(now_ns - self._started_ns) / SECOND_NS,
            state=recorder.state,
            state_since_s=(now_ns - self._state_since_ns) / SECOND_NS,
            robots=recorder.robots,
            keys=keys,
            received=received,
            received_per_s=self._received_per_s,
            written=max(0, messages),
            missed=missed,
            dropped={reason.value: count for reason, count in sorted(lost.items(), key=lambda one: one[0].value)},
            ring_bytes=recorder.ring_bytes,
            incidents=recorder.incidents,
            cpu_percent=self._cpu_percent,
            **msgspec.structs.asdict(vitals),
        )

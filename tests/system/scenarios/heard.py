"""What has arrived from the chassis: all that a gateway can know."""

from __future__ import annotations

from collections import deque
from typing import Final

from tests.system.scenarios.plant import AUTO, BODY, DRIVE, REMOTE, WHEELS, CanFrame, checksum

LATELY_S: Final = 0.15
NEVER_S, NOT_YET_S = -9.0, 999.0
MODE_UNKNOWN_S: Final = 0.2  # a mode of this age may be unknown: ten periods of its frame, by the rule on silence
MODE_KNOWN_S: Final = MODE_UNKNOWN_S + LATELY_S  # a mode of this age must be unknown


class Heard:
    """The newest whole frames.

    Attributes:
        remote_s: since when the remote control has the robot; ``NOT_YET_S`` while it has not.
        unchanged_s: when drive or wheels last changed.
    """

    def __init__(self, *, fine: bool) -> None:
        self._bit_mps, self._zero, self._mask = (0.001, 32768, 0xFFFF) if fine else (0.04, 200, 0x1FF)
        self._payloads: dict[int, bytes] = {}
        self._body_s = NEVER_S
        self._lately: deque[tuple[float, float]] = deque()
        self.remote_s = NOT_YET_S
        self.unchanged_s = 0.0

    def receive(self, frames: list[CanFrame], now_s: float) -> None:
        for identifier, data in frames:
            if len(data) != 8 or data[7] != checksum(data):
                continue
            before = self._payloads.get(identifier)
            self._payloads[identifier] = data[:6]
            if identifier in {DRIVE, WHEELS}:
                self._lately.append((now_s, self.speed_mps))
                if data[:6] != before:
                    self.unchanged_s = now_s
            elif identifier == BODY:
                self._body_s = now_s
                is_remote = data[5] & 3 == REMOTE
                self.remote_s = min(self.remote_s, now_s) if is_remote else NOT_YET_S

    def forget(self) -> None:
        """The mode is unknown from here on."""
        self._body_s, self.remote_s = NEVER_S, NOT_YET_S

    @property
    def speed_mps(self) -> float:
        drive, wheels = (self._payloads.get(identifier) for identifier in (DRIVE, WHEELS))
        speeds = [0.0] if drive is None else [int.from_bytes(drive[1:3], "little") * self._bit_mps]
        if wheels is not None:
            raws = ((int.from_bytes(wheels[at : at + 2], "little") & self._mask) for at in (1, 3))
            speeds += [abs(raw - self._zero) * self._bit_mps for raw in raws]
        return max(speeds)

    @property
    def reads_auto(self) -> bool:
        """The last mode is auto, also in a damaged frame with a right checksum."""
        body = self._payloads.get(BODY)
        return body is None or body[5] & 3 == AUTO

    def greatest_mps(self, now_s: float) -> float:
        while self._lately and self._lately[0][0] < now_s - LATELY_S:
            self._lately.popleft()
        return max([self.speed_mps, *(speed_mps for _, speed_mps in self._lately)])

    def may_be_unknown(self, now_s: float) -> bool:
        """No body frame for so long that the mode counts as unknown."""
        return round(now_s - self._body_s, 6) >= MODE_UNKNOWN_S

    def is_ours(self, now_s: float) -> bool:
        """The mode is known, and not remote."""
        return now_s - self._body_s < MODE_KNOWN_S and self.remote_s == NOT_YET_S

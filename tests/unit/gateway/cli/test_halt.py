"""``cruiser halt``: its wait for another sender."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.frame import Frame
from gateway.chassis.port import Actuation
from gateway.cli import halt
from schemas.messages import Variant
from schemas.settings import Settings

MS = 1_000_000
TICK_NS = 10 * MS


class CommandedBus:
    """A bus with its own clock. Others send a burst each tick at given times, and no chassis answers."""

    drops = 0

    def __init__(self, *times_ms: tuple[int, int]) -> None:
        self.now_ns = 0
        self.sent_ns: list[int] = []
        self._maker = FrameMaker()
        self._due_ns = [at for begin, end in times_ms for at in range(begin * MS, end * MS, TICK_NS)]
        self._waiting: list[Frame] = []

    def monotonic_ns(self) -> int:
        return self.now_ns

    def receive(self, timeout_s: float) -> Frame | None:
        end_ns = self.now_ns + round(timeout_s * 1e9)
        if not self._waiting and self._due_ns and self._due_ns[0] <= end_ns:
            self.now_ns = max(self.now_ns, self._due_ns.pop(0))
            self._waiting = self._maker.make(Actuation(enabled=True), [], Variant.COARSE)
            self._maker.sent(self._waiting)
        if self._waiting:
            return self._waiting.pop(0)
        self.now_ns = end_ns
        return None

    def send(self, _frame: Frame) -> None:
        self.sent_ns.append(self.now_ns)

    def close(self) -> None: ...


@pytest.mark.parametrize("gap_ms", [90, 110, 200, 290])
def test_a_guard_that_begins_late_is_waited_for(
    gap_ms: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It begins when its gateway was silent for 80 ms, on a busy machine later."""
    monkeypatch.setenv("CRUISER_GATEWAY_STATE_DIR", str(tmp_path))
    end_ms = 500 + gap_ms + 2_000
    bus = CommandedBus((0, 500), (490 + gap_ms, end_ms))
    monkeypatch.setattr(halt, "time", SimpleNamespace(monotonic_ns=bus.monotonic_ns))
    halt.HaltSequence(bus, Settings(), lambda: False).run(force=False)
    assert bus.sent_ns[0] >= end_ms * MS

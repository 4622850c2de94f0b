"""``cruiser watch``: when a view is drawn."""

from collections.abc import Iterator

import pytest

from gateway.cli import list_robots
from gateway.cli import watch as watch_command
from gateway.cli.list_robots import Sightings
from gateway.client.fleet import RobotStatus
from gateway.telemetry.samples import Arrival
from gateway.zenoh.client import RobotListener


class FakeClock:
    """Time that passes only by sleeping."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def monotonic_ns(self) -> int:
        return int(self.now_s * 1e9)

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


class SilentListener(RobotListener):
    def __init__(self) -> None:
        pass

    def connected(self) -> bool:
        return True

    def drain(self) -> Iterator[Arrival]:
        return iter(())


def test_a_pause_is_one_line_not_many(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock()
    monkeypatch.setattr(watch_command, "time", clock)
    shown_s: list[float] = []

    def draw(_reports: list[RobotStatus]) -> None:
        shown_s.append(round(clock.now_s, 1))
        if len(shown_s) == 2:
            clock.now_s += 60.3

    monkeypatch.setattr(list_robots, "time", clock)
    watch_command.show(Sightings(SilentListener(), "fleet", []), draw, 1.0, lambda: clock.now_s >= 70.0)
    assert shown_s == [0.2, 1.2, 61.5, 62.2, 63.2, 64.2, 65.2, 66.2, 67.2, 68.2, 69.2]

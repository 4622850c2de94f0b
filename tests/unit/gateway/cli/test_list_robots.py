"""``cruiser list`` and ``watch``: refused settings, and when a view is drawn."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.authority.enrolment import TransportRole
from gateway.cli import list_robots
from gateway.cli import watch as watch_command
from gateway.cli.list_robots import Sightings, check_role
from gateway.client.fleet import RobotStatus
from gateway.telemetry.samples import Arrival
from gateway.zenoh.client import RobotListener
from schemas.command_line import CommandError, ExitCode
from tests.support.secured import Network


@pytest.mark.parametrize("role", [TransportRole.ROBOT, TransportRole.ROUTER, TransportRole.VIEWER])
def test_settings_with_which_no_robot_is_seen_are_named_with_what_to_use(
    tmp_path: Path, role: TransportRole
) -> None:
    config = Network(tmp_path, "tls/127.0.0.1:47447").node(role, "somebody") / f"{role.value}.json5"
    if role is TransportRole.VIEWER:
        check_role(str(config))
        return
    with pytest.raises(CommandError, match=rf"settings of a {role.value} .*operator\.toml") as caught:
        check_role(str(config))
    assert caught.value.code is ExitCode.USAGE
    config.write_text("{mode: 'client'}")
    check_role(str(config))


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

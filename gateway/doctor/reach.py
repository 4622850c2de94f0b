"""The sum of the settings: the metres that a robot goes on until a fault is noticed, and until it stands."""

from __future__ import annotations

from typing import Final, NamedTuple

from gateway.doctor.facts import Facts
from gateway.sim.parameters import SPEED_LAG_S
from schemas.settings import GUARD_LATE_NS

_SOFTLY: Final = "command.deceleration_mps2"
_AT_ONCE: Final = "command.emergency_deceleration_mps2"


class Way(NamedTuple):
    """The way that a robot goes on at its highest speed, on level ground.

    Attributes:
        event: why it stops.
        notice_m: until that is noticed.
        notice_setting: what makes this shorter if it is lowered; empty if none does.
        stop_m: from there until it stands, with the lag of the virtual chassis's drive.
        stop_setting: what makes this shorter if it is raised.
    """

    event: str
    notice_m: float
    notice_setting: str
    stop_m: float
    stop_setting: str

    def __str__(self) -> str:
        lower = f" (lower {self.notice_setting})" if self.notice_setting else ""
        noticed = f"noticed after {self.notice_m:.2f} m{lower}, then " if self.notice_m else ""
        return f"{self.event}: {noticed}{self.stop_m:.2f} m to stop (raise {self.stop_setting})"


class Reach(NamedTuple):
    """All of them.

    Attributes:
        speed_mps: the highest speed that the settings allow.
        speed_setting: the one that bounds it.
        ways: those from this speed.
    """

    speed_mps: float
    speed_setting: str
    ways: list[Way]

    @property
    def lines(self) -> list[str]:
        """For people."""
        first = f"the settings allow {self.speed_mps:.2f} m/s (all is shorter with a lower {self.speed_setting})"
        return [first, *(f"  {way}" for way in self.ways)]


def reach(facts: Facts) -> Reach:
    """Add the settings up."""
    command, health = facts.settings.command, facts.zenoh.health
    delay_s = command.deadman_s + command.view_delay_s
    limits = {
        "command.speed_limit_mps": command.speed_limit_mps,
        "command.travel_delay_m": command.travel_delay_m / delay_s,
    }
    if health is not None and not health.realtime:
        limits["command.speed_limit_without_realtime_mps"] = command.speed_limit_without_realtime_mps
    speed_setting = min(limits, key=lambda name: limits[name])
    speed_mps = limits[speed_setting]

    def stop_m(deceleration_mps2: float) -> float:
        return speed_mps**2 / 2 / deceleration_mps2 + speed_mps * SPEED_LAG_S

    softly_m, at_once_m = stop_m(command.deceleration_mps2), stop_m(command.emergency_deceleration_mps2)
    fastest_m = speed_mps * delay_s
    ways = [
        Way("a fast link that is cut", fastest_m, "command.deadman_s", softly_m, _SOFTLY),
        Way("the slowest link that is cut", command.travel_delay_m, "command.travel_delay_m", softly_m, _SOFTLY),
        Way("a gateway that dies", speed_mps * GUARD_LATE_NS / 1e9, "", at_once_m, _AT_ONCE),
        Way("a bumper that is hit, or a remote stop", 0.0, "", at_once_m, _AT_ONCE),
    ]
    return Reach(speed_mps, speed_setting, ways)

"""Facts about a robot's computer, bus and samples, and the metres that it goes until it stands."""

from __future__ import annotations

from typing import Final, NamedTuple

import msgspec

from gateway.sim.body import SPEED_LAG_S
from schemas.decisions import SafetyState
from schemas.messages import GatewayHealth, RobotState
from schemas.recording import RecorderHealth
from schemas.settings import GUARD_LATE_NS, Settings


class CanInterface(msgspec.Struct, frozen=True):
    """A CAN interface of the kernel's.

    Attributes:
        is_present, is_up: it is there; it is up.
        is_virtual: it has no controller, and so no bit rate: vcan.
        bitrate: bit/s; None if it has none, or if nobody could be asked.
        controller: the controller's state in the kernel's words, such as BUS-OFF; empty if it is not known.
        restart_ms: time after which a controller that is off the bus comes back; None if it is not known.
    """

    is_present: bool = False
    is_up: bool = False
    is_virtual: bool = False
    bitrate: int | None = None
    controller: str = ""
    restart_ms: int | None = None
    queue_frames: int = 0


class BusReport(msgspec.Struct, frozen=True):
    """The feedback that was received from a CAN bus in a second, without sending.

    Attributes:
        why_not: why it could not be opened; empty if it could.
        health: the supervision of its frames, as a gateway reports it; None if it could not be opened.
        state: the chassis as it is seen; the same.
        is_commanded: somebody commands the chassis: frames that move it were received.
    """

    why_not: str = ""
    health: GatewayHealth | None = None
    state: RobotState | None = None
    is_commanded: bool = False


class ZenohReport(msgspec.Struct, frozen=True):
    """The samples that were received on Zenoh.

    Attributes:
        place: where it was connected to, in words.
        why_not: why nothing is connected there; empty if something is.
        is_blind: it was asked with the robot's own certificate, which sees no telemetry.
        health, safety, state: the newest of the robot; None if there was none.
        clock_moved_s: so far somebody has set the robot's clock since its gateway started; below zero: back.
        settings: those of the one gateway that answers; None if they are not known.
    """

    place: str = ""
    why_not: str = ""
    is_blind: bool = False
    is_named: bool = False
    gateways: int = 0
    health: GatewayHealth | None = None
    safety: SafetyState | None = None
    state: RobotState | None = None
    ahead_s: float = 0.0
    clock_moved_s: float = 0.0
    recorders: list[RecorderHealth] = []
    settings: Settings | None = None


class ServiceUnit(msgspec.Struct, frozen=True):
    """A unit of systemd's.

    Attributes:
        name: such as ``cruiser-gateway.service``.
        result: why it ended last, in systemd's word; success if it did not fail, or if that is forgotten.
        restarts: how often systemd has started it again since it was started by hand or at boot.
        ended_s: when it failed last, seconds since 1970; None if that is not known.
    """

    name: str
    state: str
    result: str = "success"
    restarts: int = 0
    ended_s: float | None = None


class LogDisk(msgspec.Struct, frozen=True):
    """The file system of the logs.

    Attributes:
        why_not: why it cannot be written to; empty if it can.
        used_bytes: by the logs.
    """

    directory: str
    why_not: str = ""
    is_read_only: bool = False
    free_bytes: int = 0
    size_bytes: int = 0
    used_bytes: int = 0


class Credential(msgspec.Struct, frozen=True):
    """A certificate with its key, or a grant.

    Attributes:
        problem: what is wrong with it, with its cure, in one line; empty if nothing is.
        warning: that it ends soon; the same.
        ends_s: when it ends, seconds since 1970; None if that is not known.
    """

    name: str
    problem: str = ""
    warning: str = ""
    ends_s: int | None = None


class Facts(msgspec.Struct, frozen=True):
    """All that is judged.

    Attributes:
        now_s: this machine's clock, seconds since 1970.
        earliest_s: a time that is past for certain: when this was installed, or the newest that the authority
            said.
        is_synchronised: the kernel's clock is kept by a time server; None if the kernel does not say.
        booted_s: when this computer was started, seconds since 1970.
        was_shut_down: before that it was shut down in order; None if its journal does not say.
        stop_note: of a stop by the guard, or by the early stop, that is latched: when and why, in one line; empty
            if there is none, or if it is not for this user to read.
        hole: what a certificate without any right can do at the router, with the cure, or why that could not be
            tried; empty if it can do nothing, None if it was not tried.
        bus_of_settings: the bus of the settings where the gateway has another, which was looked at; else empty.
        interface: the CAN interface; None where the bus is none of the kernel's.
        claims: gateways of this machine that command the bus.
        bus: what was received of it; None if it was not listened to, because a gateway reports it.
        disk: that of the logs; None where no recorder is to run on this machine.
    """

    settings: Settings
    version: str
    now_s: float
    earliest_s: float = 0.0
    is_synchronised: bool | None = None
    interface: CanInterface | None = None
    claims: int = 0
    bus: BusReport | None = None
    zenoh: ZenohReport = ZenohReport()
    disk: LogDisk | None = None
    units: list[ServiceUnit] = []
    credentials: list[Credential] = []
    booted_s: float = 0.0
    was_shut_down: bool | None = None
    stop_note: str = ""
    bus_of_settings: str = ""
    hole: str | None = None

    @property
    def health(self) -> GatewayHealth | None:
        """The gateway's health; without a gateway that of the bus as it was listened to."""
        return self.zenoh.health or (None if self.bus is None else self.bus.health)

    @property
    def state(self) -> RobotState | None:
        """The chassis, from the same source."""
        return self.zenoh.state or (None if self.bus is None else self.bus.state)


_SOFTLY: Final = "command.deceleration_mps2"
_AT_ONCE: Final = "command.emergency_deceleration_mps2"


class Way(NamedTuple):
    """The way that a robot goes on at its highest speed, on level ground.

    Attributes:
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
        speed_setting: the one that bounds it.
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

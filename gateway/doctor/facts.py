"""Facts about a robot's computer, bus and samples, and its stopping distances."""

from __future__ import annotations

from typing import Final, NamedTuple

import msgspec

from gateway.sim.body import SPEED_LAG_S
from schemas.decisions import SafetyState
from schemas.messages import GatewayHealth, RobotState
from schemas.recording import RecorderHealth
from schemas.settings import GUARD_LATE_NS, Settings


class CanInterface(msgspec.Struct, frozen=True):
    """A CAN interface of the kernel's."""

    is_present: bool = False  # the interface exists
    is_up: bool = False
    is_virtual: bool = False  # it has no controller, and so no bit rate: vcan
    bitrate: int | None = None  # bit/s; None if it has none or it is unknown
    controller: str = ""  # the controller's state as the kernel names it, such as BUS-OFF; empty if unknown
    restart_ms: int | None = None  # time until a controller restarts after bus-off; None if unknown
    queue_frames: int = 0


class BusReport(msgspec.Struct, frozen=True):
    """Feedback received from a CAN bus in a second, without sending.

    Attributes:
        health, state: as a gateway would report them; None if the bus could not be opened.
    """

    why_not: str = ""  # why it could not be opened; empty if it could
    health: GatewayHealth | None = None
    state: RobotState | None = None
    is_commanded: bool = False  # frames that move the chassis were received


class ZenohReport(msgspec.Struct, frozen=True):
    """Samples received on Zenoh.

    Attributes:
        health, safety, state: the newest of the robot; None if there was none.
    """

    place: str = ""  # the endpoint, as text
    why_not: str = ""  # why there is no connection; empty if there is one
    is_blind: bool = False  # the robot's own certificate was used, which receives no telemetry
    is_named: bool = False
    gateways: int = 0
    health: GatewayHealth | None = None
    safety: SafetyState | None = None
    state: RobotState | None = None
    ahead_s: float = 0.0
    clock_moved_s: float = 0.0  # steps of the robot's clock since its gateway started; negative if it was set back
    recorders: list[RecorderHealth] = []
    settings: Settings | None = None  # of the gateway that answers; None if unknown


class ServiceUnit(msgspec.Struct, frozen=True):
    """A systemd unit."""

    name: str  # such as ``cruiser-gateway.service``
    state: str
    result: str = "success"  # systemd's result of its last run; success if it did not fail or the result is lost
    restarts: int = 0  # automatic restarts since it was started by hand or at boot
    ended_s: float | None = None  # time of its last failure, seconds since 1970; None if unknown


class LogDisk(msgspec.Struct, frozen=True):
    """The file system of the logs."""

    directory: str
    why_not: str = ""  # why it cannot be written to; empty if it can
    is_read_only: bool = False
    free_bytes: int = 0
    size_bytes: int = 0
    used_bytes: int = 0  # by the logs


class Credential(msgspec.Struct, frozen=True):
    """A certificate with its key, or a grant."""

    name: str
    problem: str = ""  # what is wrong, and the cure, in one line; empty if it is valid
    warning: str = ""  # set when it expires soon, in the same form
    ends_s: int | None = None  # expiry, seconds since 1970; None if unknown


class Facts(msgspec.Struct, frozen=True):
    """Everything that the checks judge.

    Attributes:
        earliest_s: a time that is certainly past: the installation's, or the newest known from the authority.
        stop_note: time and cause of a latched stop by the guard or the early stop, in one line; empty if there is
            none, or this user may not read it.
        hole: what a certificate without rights can do at the router, with the cure, or why the test failed; empty
            if it can do nothing, None if it was not tested.
    """

    settings: Settings
    version: str
    now_s: float  # this machine's clock, seconds since 1970
    earliest_s: float = 0.0
    is_synchronised: bool | None = None  # the kernel's clock is synchronised with a time server; None if unknown
    interface: CanInterface | None = None  # None where the bus is not a kernel interface
    claims: int = 0  # gateways on this computer that command the bus
    bus: BusReport | None = None  # None if it was not examined, because a gateway reports it
    zenoh: ZenohReport = ZenohReport()
    disk: LogDisk | None = None  # None where no recorder runs on this computer
    units: list[ServiceUnit] = []
    credentials: list[Credential] = []
    booted_s: float = 0.0  # boot time of this computer, seconds since 1970
    was_shut_down: bool | None = None  # it was shut down before it booted; None if its journal does not say
    stop_note: str = ""
    bus_of_settings: str = ""  # the bus of the settings, where the gateway uses another one; else empty
    hole: str | None = None

    @property
    def health(self) -> GatewayHealth | None:
        """The gateway's health, or that of the examined bus if there is no gateway."""
        return self.zenoh.health or (None if self.bus is None else self.bus.health)

    @property
    def state(self) -> RobotState | None:
        """The chassis, from the same source."""
        return self.zenoh.state or (None if self.bus is None else self.bus.state)


_SOFTLY: Final = "command.deceleration_mps2"
_AT_ONCE: Final = "command.emergency_deceleration_mps2"


class Way(NamedTuple):
    """The stopping distance from the highest speed on level ground, after one event."""

    event: str
    notice_m: float  # until the event is detected
    notice_setting: str  # lower it to shorten ``notice_m``; empty if no setting does
    stop_m: float  # from there to standstill, with the drive lag of the virtual chassis
    stop_setting: str  # raise it to shorten ``stop_m``

    def __str__(self) -> str:
        lower = f" (lower {self.notice_setting})" if self.notice_setting else ""
        noticed = f"noticed after {self.notice_m:.2f} m{lower}, then " if self.notice_m else ""
        return f"{self.event}: {noticed}{self.stop_m:.2f} m to stop (raise {self.stop_setting})"


class Reach(NamedTuple):
    """All stopping distances at the highest speed, and the setting that bounds that speed."""

    speed_mps: float
    speed_setting: str
    ways: list[Way]

    @property
    def lines(self) -> list[str]:
        first = f"the settings allow {self.speed_mps:.2f} m/s (all is shorter with a lower {self.speed_setting})"
        return [first, *(f"  {way}" for way in self.ways)]


def reach(facts: Facts) -> Reach:
    """Calculate the stopping distances from the settings."""
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

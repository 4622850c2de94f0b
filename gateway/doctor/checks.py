"""The checks of ``cruiser doctor`` in one table: each row has a check, its finding and its cure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from typing import Final, NamedTuple

import msgspec

from gateway.doctor.facts import CanInterface, Facts
from schemas.command_line import plain
from schemas.messages import ControllerState, GatewayHealth, Variant
from schemas.reasons import TEXTS, Reason, cure_of, of_a_robot
from schemas.recording import RecorderState
from schemas.settings import STANDSTILL_MPS

QUEUE_MAX_FRAMES: Final = 10  # a longer transmit queue would deliver stale commands
USUAL_BITRATE: Final = 500_000  # the manual gives none; this is common for the family

CLOCK_MAX_S: Final = 1.0
"""Tolerance between the robot's clock and this one: its health is up to this old when it is read."""

LOST_MAX_SHARE: Final = 0.001  # share of samples that a recorder may miss without a finding

ERROR_FRAME: Final = "error_frame"

DAMAGE: Final = frozenset({"checksum", "implausible", "alive_counter"})
"""Failures of frames that arrive but are wrong."""

CHASSIS_REASONS: Final = frozenset(
    {
        Reason.BUS_DOWN,
        Reason.BUS_OFF,
        Reason.BUS_ERRORS,
        Reason.FEEDBACK_MISSING,
        Reason.FEEDBACK_FAULTY,
        Reason.VARIANT_UNKNOWN,
        Reason.OTHER_COMMANDER,
        Reason.UNGUARDED,
    }
)
"""Reasons that have more specific checks in this table."""

USE_REASONS: Final = frozenset(
    {
        Reason.NO_LEASE,
        Reason.NOT_ENGAGED,
        Reason.ENGAGING,
        Reason.STOPPING,
        Reason.MOVING,
        Reason.PARKED,
        Reason.GEAR_SHIFTING,
        Reason.COMMAND_NOT_ZERO,
        Reason.HAND_TRANSMITTER,
        Reason.MODE_NOT_AUTO,
        Reason.SHUTDOWN,
    }
)
"""Reasons of a healthy robot, in use or at rest."""


class Detail(NamedTuple):
    """The particulars of a finding, beyond the texts of its row."""

    text: str = ""  # the figures; may be empty
    cure: str = ""  # replaces the row's cure unless empty
    means: str = ""  # replaces the row's text unless empty


Look = Callable[[Facts], Iterable[Detail]]


class Check(msgspec.Struct, frozen=True):
    """A row."""

    name: str
    means: str  # text of the finding
    cure: str  # with placeholders ROBOT, CHANNEL and BITRATE
    look: Look
    is_note: bool = False  # the robot works all the same; the exit code is not affected


class Diagnosis(msgspec.Struct, frozen=True):
    """A finding as text."""

    check: str
    text: str
    cure: str
    is_note: bool

    @property
    def line(self) -> str:
        return f"{'note: ' if self.is_note else ''}{self.check}: {self.text} -> {self.cure}"


def diagnose(facts: Facts) -> list[Diagnosis]:
    """Return all findings in the order of the table: the first is the likely cause of the others."""
    return [
        Diagnosis(
            check.name,
            plain(": ".join(filter(None, (found.means or check.means, found.text)))),
            plain(_filled(found.cure or check.cure, facts)),
            check.is_note,
        )
        for check in CHECKS
        for found in check.look(facts)
    ]


def summary(facts: Facts) -> str:
    words = []
    if facts.state is not None and facts.state.speed_mps is not None:
        speed_mps = facts.state.speed_mps
        stands = abs(speed_mps) <= STANDSTILL_MPS
        words.append("standing" if stands else f"moving at {speed_mps:+.2f} m/s")
    words += ["feedback complete", "guarded", "recording"]
    if facts.settings.gateway.listen_only:
        words[words.index("guarded")] = "not commanded (gateway.listen_only)"
    end_s = authority_ends_s(facts)
    signed = facts.settings.authority.mode == "signed" and end_s is not None
    words.append(f"authority valid until {_utc(end_s)}" if signed and end_s else "open to this machine alone")
    return ", ".join(words)


def authority_ends_s(facts: Facts) -> int | None:
    """Return when the robot's certificate or grant expires first, seconds since 1970; None if unknown."""
    health = facts.zenoh.health
    ends_ns = [] if health is None else [health.certificate_ends_ns, health.grant_ends_ns]
    ends = [end // 10**9 for end in ends_ns if end is not None]
    return min(ends or (one.ends_s for one in facts.credentials if one.ends_s is not None), default=None)


def _filled(cure: str, facts: Facts) -> str:
    can = facts.settings.can
    cure = cure.replace("CHANNEL", can.channel).replace("BITRATE", str(can.bitrate or USUAL_BITRATE))
    return cure_of(cure, facts.settings.robot.name)


def _found(holds: bool, text: str = "", cure: str = "") -> Iterator[Detail]:  # noqa: FBT001 - the condition
    if holds:
        yield Detail(text, cure)


def _utc(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M UTC")


# The bus.


def _interface(facts: Facts) -> CanInterface:
    """Return the interface, or a healthy stand-in where the bus has none."""
    return facts.interface or CanInterface(is_present=True, is_up=True, is_virtual=True)


def _bus_detail(facts: Facts) -> str:
    """Return why the bus is not open; empty if it is, or if the interface's state explains it."""
    interface = _interface(facts)
    if not (interface.is_present and interface.is_up):
        return ""
    health = facts.zenoh.health
    if health is not None:
        return "" if health.bus_up else health.bus_detail or "it is being opened"
    return "" if facts.bus is None else facts.bus.why_not


def _open_bus(facts: Facts) -> GatewayHealth | None:
    """Return the health of an open bus; None if it is closed or unknown."""
    return facts.health if facts.health is not None and facts.health.bus_up else None


def _is_heard(health: GatewayHealth) -> bool:
    """Report whether any frame of the chassis arrives."""
    return any(row.valid and not row.silent for row in health.feedback)


def _has_errors(facts: Facts, health: GatewayHealth) -> bool:
    """Report whether the CAN controller has errors, by error frames or by the kernel's state."""
    troubled = health.controller in {ControllerState.BUS_OFF, ControllerState.PASSIVE}
    return bool(health.faults.get(ERROR_FRAME)) or troubled or _interface(facts).controller in _TROUBLED


_TROUBLED: Final = {"BUS-OFF", "ERROR-PASSIVE", "ERROR-WARNING"}


def _interface_down(facts: Facts) -> Iterable[Detail]:
    interface = _interface(facts)
    virtual = "ip link set CHANNEL up" if interface.is_virtual else ""
    return _found(interface.is_present and not interface.is_up, facts.settings.can.channel, virtual)


def _other_bus(facts: Facts) -> Iterable[Detail]:
    can = facts.settings.can
    text = f"{can.interface} {can.channel}, and not {facts.bus_of_settings}"
    return _found(bool(facts.bus_of_settings), text)


def _bit_rate(facts: Facts) -> Iterable[Detail]:
    health, rate = _open_bus(facts), _interface(facts).bitrate
    if health is not None and not _is_heard(health) and _has_errors(facts, health):
        errors = health.faults.get(ERROR_FRAME, 0)
        yield Detail(f"{errors} error frames, and none of the chassis{f', at {rate} bit/s' if rate else ''}")


def _bit_rate_differs(facts: Facts) -> Iterable[Detail]:
    rate, wanted = _interface(facts).bitrate, facts.settings.can.bitrate
    return _found(bool(rate and wanted and rate != wanted), f"it has {rate} bit/s, can.bitrate is {wanted}")


def _bus_silent(facts: Facts) -> Iterable[Detail]:
    health = _open_bus(facts)
    silent = health is not None and not health.frames_per_s and not _has_errors(facts, health)
    return _found(silent and not _bus_commanded(facts), facts.settings.can.channel)


def _other_device(facts: Facts) -> Iterable[Detail]:
    health = _open_bus(facts)
    if health is None or _is_heard(health) or _has_errors(facts, health) or _damaged(health):
        return
    if not health.frames_per_s:
        return
    strangers = ", ".join(sorted(health.unknown_identifiers)[:5])
    yield Detail(f"identifiers {strangers}" if strangers else f"{health.frames_per_s:g} frames/s")


def _missing(health: GatewayHealth, facts: Facts) -> list[str]:
    seen = {row.name for row in health.feedback if row.valid and not row.silent}
    return [name for name in facts.settings.chassis.required_feedback if name not in seen]


def _feedback_missing(facts: Facts) -> Iterable[Detail]:
    health = _open_bus(facts)
    if health is not None and _is_heard(health) and (names := _missing(health, facts)):
        yield Detail(", ".join(names))


def _feedback_faulty(facts: Facts) -> Iterable[Detail]:
    health = _open_bus(facts)
    if health is not None and (damaged := _damaged(health)):
        yield Detail(", ".join(f"{name} ({', '.join(why)})" for name, why in damaged.items()))


def _damaged(health: GatewayHealth) -> dict[str, list[str]]:
    """Return the failures of frames that arrive damaged. A late frame may have waited on this computer."""
    found = {row.name: [why for why in row.failures if why in DAMAGE] for row in health.feedback}
    return {name: why for name, why in found.items() if why}


def _variant_unknown(facts: Facts) -> Iterable[Detail]:
    health = _open_bus(facts)
    return _found(health is not None and _is_heard(health) and health.variant is Variant.UNKNOWN)


def _queue_long(facts: Facts) -> Iterable[Detail]:
    frames = _interface(facts).queue_frames
    is_real = not _interface(facts).is_virtual
    return _found(is_real and frames > QUEUE_MAX_FRAMES, f"{frames} frames, not {QUEUE_MAX_FRAMES}")


def _bus_commanded(facts: Facts) -> bool:
    by_another = facts.zenoh.safety is not None and Reason.OTHER_COMMANDER in facts.zenoh.safety.blocked_by
    return by_another or (facts.bus is not None and facts.bus.is_commanded)


# Zenoh and the services.


def _has_router(facts: Facts) -> bool:
    return bool(facts.settings.zenoh.connect or facts.settings.zenoh.config)


def _gateway_missing(facts: Facts) -> Iterable[Detail]:
    zenoh = facts.zenoh
    known = zenoh.health is not None or zenoh.is_named or zenoh.gateways > 0
    away = not known and not (zenoh.why_not and _has_router(facts))
    return _found(away, f"no gateway answers as {facts.settings.robot.name} at {zenoh.place}")


def _gateway_hangs(facts: Facts) -> Iterable[Detail]:
    zenoh = facts.zenoh
    hangs = zenoh.is_named and zenoh.health is None and not (zenoh.is_blind and zenoh.gateways)
    return _found(hangs, facts.settings.robot.name)


def _unguarded(facts: Facts) -> Iterable[Detail]:
    safety = facts.zenoh.safety
    if safety is None or Reason.BUS_DOWN in safety.blocked_by:  # Without a bus there is nothing to guard.
        return ()
    return _found(not safety.guarded, cure=TEXTS[Reason.UNGUARDED].cure)


def _service_failed(facts: Facts) -> Iterable[Detail]:
    for unit in facts.units:
        if unit.state != "active":
            why = "" if unit.result == "success" else f", because of {unit.result}"
            yield Detail(
                f"{unit.name} is {unit.state}{why}", f"journalctl -u {unit.name}; systemctl start {unit.name}"
            )


def _restarts(facts: Facts) -> Iterable[Detail]:
    for unit in facts.units:
        if unit.restarts:
            often = "once" if unit.restarts == 1 else f"{unit.restarts} times, last"
            why = "" if unit.result == "success" else f" because of {unit.result}{RESULTS.get(unit.result, '')}"
            at = "" if unit.ended_s is None else f" at {_utc(unit.ended_s)}"
            yield Detail(f"{unit.name}, {often}{why}{at}", f"journalctl -u {unit.name}")


RESULTS: Final = {
    "watchdog": " (it hung)",
    "signal": " (it was killed)",
    "oom-kill": " (memory ran out)",
    "core-dump": " (it crashed)",
    "exit-code": " (it gave up)",
}
"""Explanations of systemd's service results."""


def _versions(facts: Facts) -> Iterable[Detail]:
    health = facts.zenoh.health
    others = [] if health is None else [f"gateway {health.gateway_version}"]
    others += [f"recorder {one.recorder} {one.recorder_version}" for one in facts.zenoh.recorders]
    other = [text for text in others if text.rpartition(" ")[2] != facts.version]
    return _found(bool(other), f"{', '.join(other)}; this is {facts.version}")


# The arbiter.


def _reasons(reasons: Iterable[Reason], facts: Facts) -> Iterator[Detail]:
    every = list(reasons)
    stop_detail = "" if facts.zenoh.safety is None else facts.zenoh.safety.stop_detail
    for reason in every:
        text = of_a_robot(reason, every)
        is_last = facts.zenoh.safety is not None and facts.zenoh.safety.stop_reason is reason
        detail = facts.stop_note if reason is Reason.GUARD else ""
        detail = detail or (stop_detail if is_last else "")
        yield Detail(f"{text.means}{f' ({detail})' if detail else ''}", text.cure, reason.value)


def _blocked(facts: Facts) -> Iterable[Detail]:
    safety = facts.zenoh.safety
    if safety is None:
        return ()
    known = {*safety.latched, *CHASSIS_REASONS, *USE_REASONS}
    return _reasons((reason for reason in safety.blocked_by if reason not in known), facts)


# Time, certificates, disk.


def _clock_differs(facts: Facts) -> Iterable[Detail]:
    ahead_s = facts.zenoh.ahead_s
    way = "ahead" if ahead_s > 0 else "behind"
    return _found(abs(ahead_s) > CLOCK_MAX_S, f"the robot's is {abs(ahead_s):.1f} s {way}")


def _split(text: str) -> Detail:
    """Split a file's problem from its cure, which follows a semicolon."""
    what, _, cure = text.partition("; ")
    return Detail("", cure, what)


def _disk_unusable(facts: Facts) -> Iterable[Detail]:
    disk = facts.disk
    return _found(disk is not None and bool(disk.why_not) and not disk.is_read_only, disk.why_not if disk else "")


def _disk_full(facts: Facts) -> Iterable[Detail]:
    disk = facts.disk
    if disk is None or disk.why_not or not disk.size_bytes:
        return ()
    floor = min(facts.settings.recorder.floor_bytes, disk.size_bytes // 10)
    return _found(disk.free_bytes < floor, f"{disk.directory}: {_mb(disk.free_bytes)} free, not {_mb(floor)}")


def _mb(size: int) -> str:
    return f"{size / 1e6:,.0f} MB"


# The recorder.


def _recorder_stopped(facts: Facts) -> Iterable[Detail]:
    recorders = facts.zenoh.recorders
    if any(one.state is RecorderState.RECORDING for one in recorders):
        return
    for one in recorders:
        full = "free space on the disk" if one.state is RecorderState.FULL else ""
        yield Detail(f"{one.recorder} is {one.state.value}", full)


def _losses(facts: Facts) -> Iterable[Detail]:
    health = facts.zenoh.health
    counts = []
    if health is not None:
        counts = [
            ("frames not read in time, or garbled (bus_drops)", health.bus_drops),
            ("requests dropped unread (inbox_drops)", health.inbox_drops),
            ("samples that Zenoh did not accept (publish_failures)", health.publish_failures),
            ("losses of the bus (bus_losses)", health.bus_losses),
        ]
    for recorder in facts.zenoh.recorders:
        missed = recorder.missed if recorder.missed > LOST_MAX_SHARE * recorder.received else 0
        counts.append((f"samples that {recorder.recorder} missed", missed))
        counts.append((f"samples that {recorder.recorder} dropped", sum(recorder.dropped.values())))
    return [Detail(f"{count} {what}") for what, count in counts if count]


_UP: Final = (
    "ip link set CHANNEL up txqueuelen 10 type can bitrate BITRATE restart-ms 100; at each start: 'cruiser setup'"
)
_CABLE: Final = "check the cable, its termination (60 ohms between the wires) and the other senders"

CHECKS: Final = (
    Check(
        "other_bus",
        "the bus examined is not the one in the settings",
        "pass the settings file of the running gateway: --config",
        _other_bus,
        is_note=True,
    ),
    Check(
        "interface_missing",
        "the interface does not exist",
        "plug in the adapter, or set can.channel to another one; 'ip link' lists them",
        lambda facts: _found(not _interface(facts).is_present, facts.settings.can.channel),
    ),
    Check("interface_down", "the interface is down", _UP, _interface_down),
    Check(
        "bus_unreachable",
        "the bus cannot be opened",
        "check can.interface and can.channel, and which program uses the interface",
        lambda facts: _found(bool(detail := _bus_detail(facts)), detail),
    ),
    Check(
        "bit_rate",
        "the bus runs at another bit rate, or is damaged",
        "set the chassis's bit rate: 'cruiser setup --bitrate N'; if it is right, " + _CABLE,
        _bit_rate,
    ),
    Check(
        "bit_rate_differs",
        "the interface's bit rate differs from the settings",
        "'cruiser setup --bitrate BITRATE', or change can.bitrate",
        _bit_rate_differs,
    ),
    Check(
        "bus_silent",
        "nothing is received on the bus",
        "check the chassis's power and button, and the cable",
        _bus_silent,
    ),
    Check(
        "other_device",
        "frames are received, but none from this chassis",
        "connect the chassis to this bus, or set can.channel to its bus",
        _other_device,
    ),
    Check(
        "feedback_missing",
        "required feedback frames are missing",
        "check the chassis; chassis.required_feedback lists the required frames",
        _feedback_missing,
    ),
    Check("feedback_faulty", "frames from the chassis are damaged", _CABLE, _feedback_faulty),
    Check(
        "variant_unknown",
        "the firmware variant, and with it the scale of speeds, is not known",
        "let the robot stand still; if it already does, chassis.variant is set wrong",
        _variant_unknown,
    ),
    Check(
        "other_commander",
        "another computer commands the chassis",
        "stop the other one: a chassis takes commands from one computer only",
        lambda facts: _found(_bus_commanded(facts), facts.settings.can.channel),
    ),
    Check(
        "two_gateways",
        "more than one gateway commands the bus",
        "stop one, or set its gateway.listen_only",
        lambda facts: _found(facts.claims > 1, f"{facts.claims} on {facts.settings.can.channel}"),
    ),
    Check(
        "two_of_one_name",
        "more than one gateway has the robot's name",
        "rename one: robot.name",
        lambda facts: _found(
            facts.zenoh.gateways > 1, f"{facts.zenoh.gateways} are called {facts.settings.robot.name}"
        ),
    ),
    Check(
        "queue_long",
        "the transmit queue is long enough to deliver stale commands",
        "ip link set CHANNEL txqueuelen 10",
        _queue_long,
    ),
    Check(
        "no_restart",
        "the CAN controller does not restart automatically after bus-off",
        "ip link set CHANNEL type can restart-ms 100, while it is down",
        lambda facts: _found(_interface(facts).restart_ms == 0),
    ),
    Check(
        "router_unreachable",
        "the router cannot be reached",
        "check the network, and the router: 'systemctl status cruiser-router' on its computer",
        lambda facts: _found(
            bool(facts.zenoh.why_not) and _has_router(facts), f"{facts.zenoh.place}: {facts.zenoh.why_not}"
        ),
    ),
    Check(
        "gateway_missing",
        "the gateway is not running",
        "'systemctl start cruiser-gateway', or 'cruiser gateway'",
        _gateway_missing,
    ),
    Check(
        "gateway_hangs",
        "the gateway is connected, but sends no health",
        "wait 10 s until systemd restarts it, or 'systemctl restart cruiser-gateway'",
        _gateway_hangs,
    ),
    Check(
        "not_asked",
        "the gateway could not be queried: a robot's own certificate receives no telemetry",
        "install a recorder's or viewer's certificate here ('cruiser provision recorder'), or pass --zenoh-config",
        lambda facts: _found(facts.zenoh.is_blind and not facts.zenoh.why_not),
    ),
    Check(
        "not_shut_down",
        "the computer lost its power, or was reset, without being shut down",
        "check the battery and the supply; the recorder repairs the log it was writing",
        lambda facts: _found(facts.was_shut_down is False, f"before {_utc(facts.booted_s)}"),
        is_note=True,
    ),
    Check("service_not_active", "a service is not running", "journalctl -u cruiser-gateway", _service_failed),
    Check(
        "service_restarted",
        "systemd restarted a service",
        "journalctl -u cruiser-gateway",
        _restarts,
        is_note=True,
    ),
    Check(
        "realtime",
        "the gateway has no real-time priority: the lower speed limit applies",
        "LimitRTPRIO=20",
        lambda facts: _found(
            facts.zenoh.health is not None and not facts.zenoh.health.realtime, cure=TEXTS[Reason.NO_REALTIME].cure
        ),
    ),
    Check(
        "unguarded",
        "no guard process watches the gateway",
        "wait a second",
        _unguarded,
    ),
    Check(
        "latched",
        "a reset is required",
        "'cruiser reset ROBOT'",
        lambda facts: () if facts.zenoh.safety is None else _reasons(facts.zenoh.safety.latched, facts),
    ),
    Check("blocked", "the robot cannot be engaged", "'cruiser why ROBOT'", _blocked),
    Check(
        "clock_behind",
        "this computer's clock is behind",
        "set it with 'timedatectl set-time' or a time server; check its battery",
        lambda facts: _found(
            facts.now_s < facts.earliest_s,
            f"it reads {_utc(facts.now_s)}, but it is at least {_utc(facts.earliest_s)}",
        ),
    ),
    Check(
        "clock_set_back",
        "the robot's clock was set back since its gateway started",
        "use a time server; logs contain the times in between twice",
        lambda facts: _found(facts.zenoh.clock_moved_s < -CLOCK_MAX_S, f"by {-facts.zenoh.clock_moved_s:.0f} s"),
        is_note=True,
    ),
    Check(
        "clock_unsynchronised",
        "the clock is not synchronised with a time server",
        "run chrony or systemd-timesyncd, with access to a server; 'timedatectl' shows the state",
        lambda facts: _found(facts.is_synchronised is False),
        is_note=True,
    ),
    Check(
        "clock_differs",
        "the robot's clock differs from this computer's",
        "synchronise both with a time server",
        _clock_differs,
    ),
    Check(
        "credentials_missing",
        "authority.mode is signed, but there are no keys",
        "'cruiser provision robot ROBOT' makes them, 'cruiser setup --bundle FILE' installs the answer",
        lambda facts: _found(
            facts.settings.authority.mode == "signed" and not facts.credentials, facts.settings.robot.name
        ),
    ),
    Check(
        "credentials",
        "a credential is missing, wrong, expired, or readable by others",
        "'cruiser provision renew robot' asks for another",
        lambda facts: [_split(one.problem) for one in facts.credentials if one.problem],
    ),
    Check(
        "credentials_end",
        "a certificate or a grant ends soon",
        "'cruiser provision renew robot' asks for another",
        lambda facts: [_split(one.warning) for one in facts.credentials if one.warning and not one.problem],
        is_note=True,
    ),
    Check(
        "hole",
        "a certificate without rights gets past the router",
        "install router.json5 on the router again, and restart it",
        lambda facts: [_split(facts.hole)] if facts.hole else [],
    ),
    Check(
        "shut_out",
        "a certificate without rights can neither send, receive nor answer",
        "nothing to do",
        lambda facts: _found(facts.hole == ""),
        is_note=True,
    ),
    Check(
        "disk_unusable",
        "logs cannot be written",
        "create the directory, owned by the recorder's user",
        _disk_unusable,
    ),
    Check(
        "disk_read_only",
        "the file system is mounted read-only",
        "check the disk ('dmesg'), then remount it",
        lambda facts: _found(
            facts.disk is not None and facts.disk.is_read_only, facts.disk.directory if facts.disk else ""
        ),
    ),
    Check("disk_full", "the disk is full", "move logs off the disk, or lower recorder.budget_bytes", _disk_full),
    Check(
        "recorder_missing",
        "no recorder is running",
        "'systemctl start cruiser-recorder', or 'cruiser record'",
        lambda facts: _found(facts.zenoh.health is not None and not facts.zenoh.recorders, facts.zenoh.place),
    ),
    Check(
        "recorder_stopped",
        "a recorder runs, but does not record",
        "set recorder.standby to false",
        _recorder_stopped,
    ),
    Check("versions", "versions differ", "update the older ones while the robot stands", _versions, is_note=True),
    Check("losses", "data was lost", "see the alert of the same name in docs/operate.md", _losses, is_note=True),
)
"""All checks, likely causes first."""

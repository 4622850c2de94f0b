"""The checks of ``cruiser doctor``: each cause gives its finding and no other."""

from collections.abc import Callable

import msgspec
import pytest

from gateway.doctor.checks import CHECKS, diagnose, summary
from gateway.doctor.facts import (
    BusReport,
    CanInterface,
    Credential,
    Facts,
    LogDisk,
    ServiceUnit,
    ZenohReport,
    reach,
)
from schemas.messages import ControllerState, FrameHealth, GatewayHealth, Variant
from schemas.reasons import Reason
from schemas.recording import RecorderState
from schemas.settings import (
    AuthoritySettings,
    CanSettings,
    ChassisSettings,
    CommandSettings,
    RecorderSettings,
    Settings,
    ZenohSettings,
)
from tests.support import SUPPORT
from tests.support.messages import HEALTH, STANDBY, STATE, recorder_health

replace = msgspec.structs.replace
DAY_S = 86_400
NOW_S = 1_800_000_000.0

FEEDBACK = [replace(HEALTH.feedback[0], name=name) for name in ChassisSettings().required_feedback]
WELL_HEALTH = replace(HEALTH, feedback=FEEDBACK, certificate_ends_ns=round((NOW_S + 20 * DAY_S) * 1e9))
RECORDER = replace(recorder_health(), recorder_version="0.1.0", received=1_000_000)
WELL = Facts(
    Settings(
        can=CanSettings(bitrate=500_000),
        zenoh=ZenohSettings(connect=["tls/router.example:7447"]),
        recorder=RecorderSettings(budget_bytes=20_000_000_000),
        authority=AuthoritySettings(mode="signed"),
    ),
    version="0.1.0",
    now_s=NOW_S,
    earliest_s=NOW_S - DAY_S,
    is_synchronised=True,
    interface=CanInterface(
        is_present=True, is_up=True, bitrate=500_000, controller="ERROR-ACTIVE", restart_ms=100, queue_frames=10
    ),
    claims=1,
    zenoh=ZenohReport(
        "tls/router.example:7447",
        is_named=True,
        gateways=1,
        health=WELL_HEALTH,
        safety=replace(STANDBY, blocked_by=[Reason.NO_LEASE, Reason.NOT_ENGAGED]),
        state=replace(STATE, speed_mps=0.0),
        recorders=[RECORDER],
    ),
    disk=LogDisk("/var/lib/cruiser/logs", free_bytes=40_000_000_000, size_bytes=64_000_000_000),
    units=[ServiceUnit("cruiser-gateway.service", "active")],
    credentials=[Credential("certificate", ends_s=round(NOW_S + 20 * DAY_S))],
)

SILENT = [replace(row, silent=True) for row in FEEDBACK]
DEAD = replace(WELL_HEALTH, feedback=SILENT, frames_per_s=0.0, variant=Variant.UNKNOWN)


def zenoh(**changes: object) -> Facts:
    return replace(WELL, zenoh=replace(WELL.zenoh, **changes))


def health(**changes: object) -> Facts:
    return zenoh(health=replace(WELL_HEALTH, **changes))


def safety(**changes: object) -> Facts:
    return zenoh(safety=replace(STANDBY, **changes))


def interface(**changes: object) -> Facts:
    assert WELL.interface is not None
    return replace(WELL, interface=replace(WELL.interface, **changes))


def listened(report: BusReport, **changes: object) -> Facts:
    """Facts without a gateway, from the bus itself."""
    return replace(WELL, zenoh=ZenohReport("tcp/127.0.0.1:7447"), bus=report, claims=0, **changes)


def disk(**changes: object) -> Facts:
    assert WELL.disk is not None
    return replace(WELL, disk=replace(WELL.disk, **changes))


def dead(**changes: object) -> GatewayHealth:
    return replace(DEAD, **changes)


def failing(*failures: str) -> FrameHealth:
    return replace(SILENT[0] if "silence" in failures else FEEDBACK[0], failures=[*failures])


NO_BUS = replace(
    WELL.zenoh,
    health=replace(DEAD, bus_up=False),
    safety=replace(STANDBY, guarded=False, blocked_by=[Reason.BUS_DOWN, Reason.UNGUARDED]),
)

CASES: dict[str, Facts] = {
    "other_bus": replace(WELL, bus_of_settings="socketcan can5, by robot.toml"),
    "interface_missing": replace(interface(is_present=False), zenoh=NO_BUS),
    "interface_down": replace(interface(is_up=False), zenoh=NO_BUS),
    "bus_unreachable": zenoh(health=dead(bus_up=False, bus_detail="no server")),
    "bit_rate": zenoh(health=dead(faults={"error_frame": 9})),
    "bit_rate_differs": interface(bitrate=250_000),
    "bus_silent": zenoh(health=DEAD),
    "other_device": zenoh(health=dead(frames_per_s=90.0, unknown_identifiers={"200": 9, "18FF50E5": 1})),
    "feedback_missing": health(feedback=FEEDBACK[1:]),
    "feedback_faulty": health(feedback=[replace(FEEDBACK[0], failures=["checksum", "period"]), *FEEDBACK[1:]]),
    "variant_unknown": health(variant=Variant.UNKNOWN),
    "other_commander": safety(blocked_by=[Reason.OTHER_COMMANDER]),
    "two_gateways": replace(WELL, claims=2),
    "two_of_one_name": zenoh(gateways=2),
    "queue_long": interface(queue_frames=1000),
    "no_restart": interface(restart_ms=0),
    "router_unreachable": zenoh(
        why_not="refused", health=None, safety=None, state=None, recorders=[], is_named=False, gateways=0
    ),
    "gateway_missing": zenoh(health=None, safety=None, state=None, recorders=[], is_named=False, gateways=0),
    "gateway_hangs": zenoh(health=None, safety=None),
    "not_asked": zenoh(is_blind=True, health=None, safety=None),
    "not_shut_down": replace(WELL, was_shut_down=False, booted_s=NOW_S - 60),
    "service_not_active": replace(WELL, units=[ServiceUnit("cruiser-recorder.service", "failed", "exit-code")]),
    "service_restarted": replace(
        WELL, units=[ServiceUnit("cruiser-gateway.service", "active", "watchdog", 2, NOW_S)]
    ),
    "realtime": health(realtime=False),
    "unguarded": safety(guarded=False),
    "latched": safety(
        latched=[Reason.ROLLING], blocked_by=[Reason.ROLLING], stop_reason=Reason.ROLLING, stop_detail="0.2"
    ),
    "blocked": safety(blocked_by=[Reason.SELF_TEST]),
    "clock_behind": replace(WELL, now_s=0.0),
    "clock_set_back": zenoh(clock_moved_s=-3600.2),
    "clock_unsynchronised": replace(WELL, is_synchronised=False),
    "clock_differs": zenoh(ahead_s=-3.25),
    "credentials_missing": replace(WELL, credentials=[]),
    "credentials": replace(WELL, credentials=[Credential("c", "robot-tls.pem ended 2.0 days ago; renew it")]),
    "credentials_end": replace(
        WELL, credentials=[Credential("c", "", "robot-tls.pem ends in 2.0 days; renew it")]
    ),
    "hole": replace(WELL, hole="a put on X arrives; the router at R has to run from the router.json5"),
    "shut_out": replace(WELL, hole=""),
    "disk_unusable": disk(why_not="logs: no such file"),
    "disk_read_only": disk(is_read_only=True, why_not="x"),
    "disk_full": disk(free_bytes=1_000_000),
    "recorder_missing": zenoh(recorders=[]),
    "recorder_stopped": zenoh(recorders=[replace(RECORDER, state=RecorderState.FULL)]),
    "versions": health(gateway_version="0.0.9"),
    "losses": health(bus_drops=3),
}

FINDINGS = SUPPORT.parent / "data" / "findings.txt"
"""The line of each case; ``python -m tests.unit.gateway.doctor.test_checks`` writes it."""


def test_a_robot_that_is_well_has_no_finding() -> None:
    assert diagnose(WELL) == []
    said = "standing, feedback complete, guarded, recording, authority valid until 2027-02-04 08:00 UTC"
    assert summary(WELL) == said


def test_a_robot_in_open_mode_is_open_to_this_machine_alone() -> None:
    settings = replace(WELL.settings, authority=AuthoritySettings())
    assert summary(replace(WELL, settings=settings)).endswith("recording, open to this machine alone")
    assert summary(zenoh(state=replace(STATE, speed_mps=-0.5))).startswith("moving at -0.50 m/s, ")


@pytest.mark.parametrize("name", CASES)
def test_each_cause_has_its_finding_and_no_other(name: str) -> None:
    (found,) = diagnose(CASES[name])
    assert found.check == name
    assert found.line in FINDINGS.read_text("utf-8").splitlines()
    assert found.cure
    assert not any(word in found.cure for word in ("ROBOT", "CHANNEL", "BITRATE"))


def test_a_stop_by_the_guard_says_from_its_note_why_it_was() -> None:
    stopped = safety(latched=[Reason.GUARD, Reason.ROLLING], stop_reason=Reason.GUARD, stop_detail="by note")
    assert "(by note)" in diagnose(stopped)[0].text
    guard, rolling = diagnose(replace(stopped, stop_note="2027-01-15T08:00:00.000+00:00 early stop: it moved"))
    assert guard.text.endswith("in place of the gateway (2027-01-15T08:00:00.000+00:00 early stop: it moved)")
    assert "early stop" not in rolling.text


def test_every_check_has_a_case() -> None:
    assert [check.name for check in CHECKS] == list(CASES)


@pytest.mark.parametrize(
    ("report", "said"),
    [
        (BusReport("no such device"), "bus_unreachable"),
        (BusReport("", DEAD), "bus_silent"),
        (BusReport("", dead(controller=ControllerState.PASSIVE)), "bit_rate"),
        (BusReport("", dead(frames_per_s=90.0)), "other_device"),
        (BusReport("", dead(frames_per_s=90.0, feedback=[failing("checksum", "silence")])), "feedback_faulty"),
        (BusReport("", replace(WELL_HEALTH, feedback=[failing("period"), *FEEDBACK[1:]])), ""),
        (BusReport("", WELL_HEALTH, STATE, is_commanded=True), "other_commander"),
        (BusReport("", WELL_HEALTH, STATE), ""),
    ],
)
def test_without_a_gateway_the_bus_is_judged_as_it_was_heard(report: BusReport, said: str) -> None:
    settings = replace(WELL.settings, zenoh=ZenohSettings())
    found = [one.check for one in diagnose(listened(report, settings=settings))]
    assert found == [*([said] if said else []), "gateway_missing"]


def test_a_virtual_interface_has_neither_bit_rate_nor_queue() -> None:
    virtual = interface(is_virtual=True, bitrate=None, queue_frames=1000, restart_ms=None)
    assert diagnose(virtual) == []
    assert virtual.interface is not None
    down = replace(virtual, interface=replace(virtual.interface, is_up=False), zenoh=zenoh(health=None).zenoh)
    assert diagnose(down)[0].cure == "ip link set can0 up"


def test_text_of_others_is_printed_as_text() -> None:
    """Escape sequences are shown, not executed."""
    make: Callable[..., Facts] = health
    assert r"\x1b[2J" in diagnose(make(gateway_version="\x1b[2J"))[0].text


def test_the_settings_add_up_to_metres() -> None:
    found = reach(WELL)
    assert (found.speed_mps, found.speed_setting) == (1.0, "command.speed_limit_mps")
    assert [(round(way.notice_m, 2), round(way.stop_m, 2)) for way in found.ways] == [
        (0.3, 0.57),
        (1.0, 0.57),
        (0.08, 0.4),
        (0.0, 0.4),
    ]
    command = CommandSettings(speed_limit_mps=2.0, view_delay_s=0.2, travel_delay_m=0.8)
    delayed = reach(replace(WELL, settings=replace(WELL.settings, command=command)))
    assert (delayed.speed_mps, delayed.speed_setting) == (1.6, "command.travel_delay_m")
    assert delayed.ways[0].notice_m == pytest.approx(0.8)
    slow = replace(WELL.settings, command=CommandSettings(speed_limit_without_realtime_mps=0.5))
    assert reach(replace(health(realtime=False), settings=slow)).speed_mps == 0.5
    assert reach(replace(health(realtime=True), settings=slow)).speed_mps == 1.0


if __name__ == "__main__":
    FINDINGS.write_text("".join(f"{one.line}\n" for facts in CASES.values() for one in diagnose(facts)), "utf-8")

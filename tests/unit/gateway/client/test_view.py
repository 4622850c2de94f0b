import io

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console, RenderableType

from gateway.client import fleet
from gateway.client.fleet import RobotStatus, alarm
from schemas.decisions import ArbiterState, SafetyState
from schemas.messages import GatewayHealth, Mode, RobotState, Variant
from schemas.reasons import Reason
from tests.support.messages import HEALTH, STATE
from tests.support.strategies import TEXTS, message_of
from tests.unit.gateway.client.test_drive_stream import ENGAGED

FRESH = RobotStatus(
    robot="cruiser-1",
    connected=True,
    state=STATE,
    state_age_s=0.04,
    health=HEALTH,
    health_age_s=0.5,
    unreadable="",
    linked=True,
)
STALE = msgspec.structs.replace(FRESH, state=None, state_age_s=3.21)

REPORTS = st.builds(
    RobotStatus,
    robot=st.just("cruiser-1"),
    connected=st.booleans(),
    state=st.none() | message_of(RobotState),
    state_age_s=st.none() | st.floats(0, 1e6),
    health=st.none() | message_of(GatewayHealth),
    health_age_s=st.none() | st.floats(0, 1e6),
    unreadable=TEXTS,
    linked=st.booleans(),
    safety=st.none() | message_of(SafetyState),
)


def drawn(renderable: RenderableType, width: int = 200) -> str:
    """What a terminal of this width shows."""
    console = Console(file=io.StringIO(), width=width, color_system=None, force_terminal=False)
    with console.capture() as capture:
        console.print(renderable)
    return capture.get()


def listed(report: RobotStatus) -> str:
    """A report in the list."""
    return "\n".join(fleet.list_lines([report]))


def every_view(report: RobotStatus) -> list[str]:
    """A report as a line, as a panel and as a row of a table."""
    return [fleet.line(report), drawn(fleet.panel(report)), drawn(fleet.table([report]))]


def test_a_fresh_state_shows_what_the_robot_does() -> None:
    """Mode, gear, signed speed and angle, brakes, bumpers, lamps, variant, bus, faults and age are all there."""
    for text in (fleet.line(FRESH), drawn(fleet.panel(FRESH))):
        for part in (
            "auto",
            "drive",
            "+1.25 m/s",
            "-3.5 deg",
            "released",
            "clear",
            "headlamp",
            "coarse",
            "up",
            "0.04 s",
        ):
            assert part in text
        assert "OFFLINE" not in text


def test_the_view_shows_how_old_the_commands_are() -> None:
    """Row 'travel delay': the age, the metres and the limit from it, while the robot obeys commands."""
    safety = msgspec.structs.replace(
        ENGAGED, link_age_s=0.43, link_age_p50_s=0.42, link_age_p99_s=0.81, deadman_s=1.0, travel_delay_m=0.71,
        travel_speed_limit_mps=0.7,
    )  # fmt: skip
    far = msgspec.structs.replace(FRESH, safety=safety)
    words = "command latency 430 ms (p99 810 ms), timeout 1000 ms, reaction distance 0.71 m"
    for text in (fleet.line(far), drawn(fleet.panel(far))):
        assert f"{words}, speed limit 0.70 m/s" in text
    for report in (
        FRESH,
        msgspec.structs.replace(FRESH, safety=ENGAGED),
        msgspec.structs.replace(STALE, safety=safety),
    ):
        assert not any("reaction distance" in text for text in every_view(report))


def test_the_view_shows_what_is_latched_and_the_limit_in_force() -> None:
    """Nobody has to ask ``why`` to see that a robot is latched, or how fast it may go."""
    latched = msgspec.structs.replace(
        ENGAGED, state=ArbiterState.STANDBY, latched=[Reason.REMOTE_STOP, Reason.ROLLING]
    )
    for text in every_view(msgspec.structs.replace(FRESH, safety=latched)):
        assert "latched remote_stop, rolling" in text
        assert "limit" not in text
    driven = msgspec.structs.replace(FRESH, safety=msgspec.structs.replace(ENGAGED, speed_limit_mps=0.5))
    for text in (fleet.line(driven), drawn(fleet.panel(driven))):
        assert "limit 0.50 m/s" in text
        assert "latched" not in text


def of(safety: SafetyState) -> RobotStatus:
    """A report of a robot whose arbiter says this."""
    return msgspec.structs.replace(FRESH, safety=safety)


def test_the_view_shows_who_drives_and_why_it_does_not_move() -> None:
    """A robot after a remote stop does not look like one that idles, nor does one that its deadman stopped."""
    driven = of(msgspec.structs.replace(ENGAGED, lease_holder="ann"))
    idle = msgspec.structs.replace(
        ENGAGED, state=ArbiterState.STANDBY, lease_holder="", blocked_by=[Reason.NO_LEASE, Reason.NOT_ENGAGED]
    )
    stopped = msgspec.structs.replace(
        idle,
        latched=[Reason.REMOTE_STOP],
        blocked_by=[Reason.NO_LEASE, Reason.REMOTE_STOP, Reason.BUS_DOWN, Reason.NOT_ENGAGED],
        stop_reason=Reason.REMOTE_STOP,
        stop_detail="by bob",
    )
    lapsed = msgspec.structs.replace(idle, stop_reason=Reason.DEADMAN)
    for text in (fleet.line(driven), drawn(fleet.panel(driven))):
        assert "driver ann" in text
        assert "blocked" not in text
    for text in (fleet.line(of(idle)), drawn(fleet.panel(of(idle)))):
        assert "driver nobody" in text
        assert "blocked by no_lease, not_engaged" in text
        assert "last stop" not in text
    for text in (fleet.line(of(stopped)), drawn(fleet.panel(of(stopped)))):
        assert "blocked by no_lease, bus_down, not_engaged" in text
        assert "last stop remote_stop (by bob)" in text
    assert "last stop deadman" in fleet.line(of(lapsed))
    # Among many, what is wrong alone.
    assert "blocked" not in drawn(fleet.table([of(idle)]))
    assert "bus_down" in drawn(fleet.table([of(stopped)]))


def test_a_stale_view_says_so_and_shows_no_value() -> None:
    """When no state comes any more, every view says so loudly, and no old value stands as a present one."""
    for text in every_view(STALE):
        assert "OFFLINE" in text
        assert "3.2" in text
        for value in ("auto", "1.25", "-3.5"):
            assert value not in text


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"linked": False, "connected": False}, "this end is not connected"),
        ({"connected": False}, "its gateway is not connected"),
        ({"health": None}, "sends no health"),
        ({}, "sends health"),
        ({"unreadable": "state is of version 2"}, "state is of version 2"),
        ({"state_age_s": None}, "no state yet"),
    ],
)
def test_an_alarm_says_what_is_known_of_the_cause(change: dict[str, object], reason: str) -> None:
    """Why no state comes: this end, the gateway, its health, or what it sends."""
    assert reason in alarm(msgspec.structs.replace(STALE, **change))


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"front_bumper": True}, "bumpers front HIT"),
        ({"front_bumper": True, "rear_bumper": True}, "bumpers front and rear HIT"),
        ({"bus_up": False}, "bus DOWN"),
        ({"silent": ["Auto_DriveFeedBack"]}, "silent Auto_DriveFeedBack"),
        ({"variant": Variant.UNKNOWN}, "variant unknown"),
    ],
)
def test_what_is_wrong_is_in_every_view(change: dict[str, object], word: str) -> None:
    """A bumper hit, a bus that is down, silent frames and an unknown variant are never left out."""
    report = msgspec.structs.replace(FRESH, state=msgspec.structs.replace(STATE, **change))
    assert word in fleet.line(report)
    assert word in drawn(fleet.table([report]))
    assert word.split(" ", 1)[1] in drawn(fleet.panel(report))


def test_what_is_wrong_with_the_gateway_is_shown() -> None:
    """Faults by kind, losses and a lost bus are shown with the reason that the gateway gives."""
    sick = msgspec.structs.replace(
        HEALTH, bus_up=False, bus_detail="no such device", faults={"checksum": 3, "length": 0}, realtime=False
    )
    report = msgspec.structs.replace(FRESH, health=sick)
    for text in (listed(report), drawn(fleet.panel(report)), drawn(fleet.table([report]))):
        assert "checksum 3" in text
        assert "length" not in text
        assert "no such device" in text
        assert "real-time" in text
    assert "faults checksum 3" in fleet.line(report)


def test_a_value_that_is_not_known_is_no_zero() -> None:
    """A field that is null is shown as missing."""
    unknown = msgspec.structs.replace(
        STATE, speed_mps=None, angle_deg=None, mode=Mode.UNDEFINED, front_bumper=None
    )
    text = fleet.line(msgspec.structs.replace(FRESH, state=unknown))
    assert "mode undefined  gear drive  --  --" in text
    assert "bumpers --" in text


def test_a_robot_without_health_is_said_to_have_none() -> None:
    """Connected is not healthy: the list says what it has not heard."""
    report = msgspec.structs.replace(FRESH, health=None)
    assert listed(report) == "cruiser-1  telemetry only  +1.25 m/s  no health"
    assert "no health" in drawn(fleet.table([report]))


def test_an_empty_fleet_is_said_to_be_empty() -> None:
    """A table without robots says that there are none."""
    assert "no robot is connected" in drawn(fleet.table([]))


def test_the_table_keeps_what_matters_in_80_columns() -> None:
    """In a small terminal the names, the motion and the alarm are still whole."""
    text = drawn(fleet.table([FRESH, STALE]), width=80)
    for part in ("cruiser-1", "telemetry only", "+1.25 m/s", "-3.5 deg", "OFFLINE"):
        assert part in text


@given(report=REPORTS)
def test_any_report_can_be_shown(report: RobotStatus) -> None:
    """Whatever a robot sends, a line is one printable line, and panel and table are drawn."""
    assert fleet.line(report).isprintable()
    assert all(line.isprintable() for line in fleet.list_lines([report]))
    for text in (drawn(fleet.panel(report), 80), drawn(fleet.table([report]), 80)):
        assert text.replace("\n", "").isprintable()


def test_nothing_is_shown_as_less_than_zero_when_it_rounds_to_zero() -> None:
    """An angle a hair right of straight ahead is shown as zero, not as minus zero."""
    straight = msgspec.structs.replace(STATE, angle_deg=-0.0006, speed_mps=-0.001)
    assert "+0.00 m/s  +0.0 deg" in fleet.line(msgspec.structs.replace(FRESH, state=straight))

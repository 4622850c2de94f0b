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
    return "\n".join(line.plain for line in fleet.list_view([report]))


def every_view(report: RobotStatus) -> list[str]:
    """A report as a line, as a panel and in the list."""
    return [fleet.line(report), drawn(fleet.panel(report)), listed(report)]


def of(safety: SafetyState = ENGAGED, **changes: object) -> RobotStatus:
    """A report of a robot whose arbiter says this, but for the changes."""
    return msgspec.structs.replace(FRESH, safety=msgspec.structs.replace(safety, **changes))


IDLE = msgspec.structs.replace(
    ENGAGED, state=ArbiterState.STANDBY, lease_holder="", blocked_by=[Reason.NO_LEASE, Reason.NOT_ENGAGED]
)
BUS_DOWN = of(
    IDLE,
    latched=[Reason.REMOTE_STOP],
    blocked_by=[Reason.NO_LEASE, Reason.REMOTE_STOP, Reason.BUS_DOWN, Reason.NOT_ENGAGED],
    stop_reason=Reason.REMOTE_STOP,
    stop_detail="by bob",
)
FAR = msgspec.structs.replace(
    ENGAGED, link_age_s=0.43, link_age_p50_s=0.42, link_age_p99_s=0.81, deadman_s=1.0, travel_delay_m=0.71,
    travel_speed_limit_mps=0.7,
)  # fmt: skip
LINE_AND_PANEL, ALL = ("line", "panel"), ("line", "panel", "list")
Row = tuple[RobotStatus, tuple[str, ...], tuple[str, ...], tuple[str, ...]]
SHOWN: dict[str, Row] = {
    "what a robot does": (
        FRESH,
        LINE_AND_PANEL,
        ("auto", "drive", "+1.25 m/s", "-3.5 deg", "released", "clear", "headlamp", "coarse", "up", "0.04 s"),
        ("OFFLINE",),
    ),
    "row 'travel delay': age, metres and limit of commands that it obeys": (
        of(FAR),
        LINE_AND_PANEL,
        (
            "command latency 430 ms (p99 810 ms), timeout 1000 ms, reaction distance 0.71 m",
            "reaction distance 0.71 m, speed limit 0.70 m/s",
        ),
        (),
    ),
    "no age of commands where nothing is known of them": (FRESH, ALL, (), ("reaction distance",)),
    "nor where there are none": (of(), ALL, (), ("reaction distance",)),
    "nor of a robot that is silent": (
        msgspec.structs.replace(STALE, safety=FAR),
        ALL,
        ("OFFLINE", "3.2"),
        ("reaction distance", "auto", "1.25", "-3.5"),
    ),
    "what is latched": (
        of(state=ArbiterState.STANDBY, latched=[Reason.REMOTE_STOP, Reason.ROLLING]),
        LINE_AND_PANEL,
        ("latched remote_stop, rolling",),
        ("limit",),
    ),
    "the limit in force": (of(speed_limit_mps=0.5), LINE_AND_PANEL, ("limit 0.50 m/s",), ("latched",)),
    "who drives": (of(lease_holder="ann"), LINE_AND_PANEL, ("driver ann",), ("blocked",)),
    "why it does not move": (
        of(IDLE),
        LINE_AND_PANEL,
        ("driver nobody", "blocked by no_lease, not_engaged"),
        ("last stop",),
    ),
    "a remote stop is no idling": (
        BUS_DOWN,
        LINE_AND_PANEL,
        ("blocked by no_lease, bus_down, not_engaged", "last stop remote_stop (by bob)"),
        (),
    ),
    "a timeout is none": (of(IDLE, stop_reason=Reason.DEADMAN), ("line",), ("last stop deadman",), ()),
    "among many, what is wrong alone": (
        BUS_DOWN,
        ("list",),
        ("bus_down", "attention: remote stop, reset"),
        ("latched",),
    ),
    "and nothing of what is not": (of(IDLE), ("list",), (), ("blocked",)),
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_view_shows(name: str) -> None:
    """These words, and not those."""
    report, views, words, others = SHOWN[name]
    drawn_as = dict(zip(ALL, every_view(report), strict=True))
    for view_name in views:
        text = drawn_as[view_name]
        assert [word for word in words if word not in text] == [], text
        assert [word for word in others if word in text] == [], text


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
    assert word in listed(report)
    assert word.split(" ", 1)[1] in drawn(fleet.panel(report))


def test_what_is_wrong_with_the_gateway_is_shown() -> None:
    """Faults by kind, losses and a lost bus are shown with the reason that the gateway gives."""
    sick = msgspec.structs.replace(
        HEALTH, bus_up=False, bus_detail="no such device", faults={"checksum": 3, "length": 0}, realtime=False
    )
    report = msgspec.structs.replace(FRESH, health=sick)
    for text in (listed(report), drawn(fleet.panel(report))):
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


@given(report=REPORTS)
def test_any_report_can_be_shown(report: RobotStatus) -> None:
    """Whatever a robot sends, a line is one printable line, and the panel is drawn."""
    assert fleet.line(report).isprintable()
    for text in (listed(report), drawn(fleet.panel(report), 80)):
        assert text.replace("\n", "").isprintable()


def test_nothing_is_shown_as_less_than_zero_when_it_rounds_to_zero() -> None:
    """An angle a hair right of straight ahead is shown as zero, not as minus zero."""
    straight = msgspec.structs.replace(STATE, angle_deg=-0.0006, speed_mps=-0.001)
    assert "+0.00 m/s  +0.0 deg" in fleet.line(msgspec.structs.replace(FRESH, state=straight))

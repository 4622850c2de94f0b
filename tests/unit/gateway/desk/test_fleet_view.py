"""Samples in, changed rows out; and a robot's row."""

import math

import msgspec
import pytest

from gateway.choice.chassis import CHASSIS
from gateway.client.fleet import FINE, LOOK, WORDS, RobotStatus
from gateway.desk.fleet_view import EVENTS_KEPT, FIELDS, LENGTH, PERIOD_NS, FleetView, row_of, why_not
from gateway.desk.words import RecorderRow, RobotRow
from gateway.telemetry.samples import Missed
from schemas.decisions import ArbiterState, SafetyState, Severity, StopPhase
from schemas.messages import Message, Mode, RobotState
from schemas.reasons import Reason
from tests.support.messages import HEALTH, SECOND, STANDBY, STATE, event, recorder_health
from tests.support.metrics import received

START = 10 * SECOND


class Scene:
    def __init__(self) -> None:
        self.view = FleetView("fleet")
        self.now_ns = START
        self.recorders: list[RecorderRow] | None = None

    def say(self, *messages: Message) -> None:
        for message in messages:
            self.view.receive(received(message))

    def step(self, seconds: float = 0.2) -> dict[str, RobotRow | None]:
        self.now_ns += round(seconds * SECOND)
        self.view.update(self.now_ns, linked=True)
        rows, self.recorders = self.view.changed_rows(self.now_ns)
        return rows

    def row(self, seconds: float = 0.2) -> RobotRow:
        """Return the only changed row."""
        (row,) = self.step(seconds).values()
        assert row is not None
        return row


def test_a_robot_that_is_lost_stays_until_somebody_has_seen_it() -> None:
    scene = Scene()
    scene.say(STATE)
    scene.step()
    row = scene.row(5000)
    assert (row.word, row.text) == ("offline", "no contact for 83 min; its gateway is not connected")
    scene.view.acknowledge("cruiser-1", row.word, "ann")
    assert scene.step() == {"cruiser-1": None}
    assert scene.view.all_rows()[0] == {}


def test_of_each_key_the_newest_is_read() -> None:
    scene = Scene()
    for speed in range(50):
        scene.say(msgspec.structs.replace(STATE, speed_mps=speed / 100))
    for number in range(EVENTS_KEPT + 7):
        scene.say(event(number, severity=Severity.WARNING, text=f"event {number}"))
    scene.view.receive(Missed())
    row = scene.row()
    assert (row.speed_mps, row.event) == (0.49, f"event {EVENTS_KEPT + 6}")
    assert len(scene.view.events("cruiser-1")) == EVENTS_KEPT


def test_recorders_are_listed_while_they_are_heard() -> None:
    scene = Scene()
    scene.say(recorder_health())
    scene.step()
    assert scene.recorders is not None
    assert [one.name for one in scene.recorders] == ["depot"]
    scene.say(recorder_health())
    scene.step()
    assert scene.recorders is None
    scene.step(5)
    assert scene.recorders == []


def test_the_last_minutes_are_there_at_once() -> None:
    scene = Scene()
    for number in range(LENGTH + 20):
        scene.say(msgspec.structs.replace(STATE, speed_mps=float(number)))
        scene.step(PERIOD_NS / SECOND)
    history = scene.view.histories.of("cruiser-1", scene.now_ns + SECOND)
    assert history.age_s == 1.0
    assert set(history.values) == set(FIELDS)
    assert history.values["speed_mps"] == [float(number) for number in range(20, LENGTH + 20)]
    assert set(history.values["asked_mps"]) == {None}


def test_the_path_is_by_the_odometry_over_the_states() -> None:
    scene = Scene()
    angle_deg = math.degrees(math.atan(math.pi / 4 * CHASSIS.wheelbase_m))
    for number in range(41):
        driven = {"speed_mps": 1.0, "angle_deg": 0.0 if number <= 20 else angle_deg}
        scene.say(msgspec.structs.replace(STATE, time_ns=STATE.time_ns + number * SECOND // 10, **driven))
        scene.step(0.1)
    pose = scene.view.histories.pose("cruiser-1")
    assert pose is not None
    radius_m = 4 / math.pi
    assert pose.x_m == pytest.approx(2 + radius_m, abs=0.15)  # The angle changes between two looks.
    assert pose.y_m == pytest.approx(radius_m, abs=0.15)
    assert pose.heading_rad == pytest.approx(math.pi / 2, abs=0.1)
    values = scene.view.histories.of("cruiser-1", scene.now_ns).values
    assert (values["x_m"][-1], values["y_m"][-1]) == pytest.approx((pose.x_m, pose.y_m))
    assert values["x_m"][0] == 0
    assert scene.view.histories.pose("cruiser-9") is None


def test_a_row_says_who_sees_to_it() -> None:
    scene = Scene()
    scene.say(STATE, msgspec.structs.replace(STANDBY, lease_holder="ann"), HEALTH)
    row = scene.row()
    assert row.acknowledged == ""
    scene.view.acknowledge("cruiser-1", row.word, "cat")
    assert scene.row().acknowledged == "cat"
    row = scene.row(2)
    assert (row.word, row.acknowledged) == ("offline", "")
    # Another alarm is not seen to, nor the first one when it comes back.
    scene.say(STATE, msgspec.structs.replace(STANDBY, lease_holder="ann"), HEALTH)
    assert scene.row().acknowledged == ""


READY = msgspec.structs.replace(
    STANDBY,
    state=ArbiterState.STANDBY,
    engaged=False,
    latched=[],
    lease_holder="",
    stop_phase=StopPhase.IDLE,
    blocked_by=[Reason.NO_LEASE, Reason.NOT_ENGAGED],
)
AUTO = msgspec.structs.replace(STATE, mode=Mode.AUTO, bus_up=True, speed_mps=0.0, silent=[])


def report(state: RobotState | None, safety: SafetyState | None) -> RobotStatus:
    return RobotStatus("cruiser-1", True, state, 0.05, HEALTH, 0.5, "", True, safety)  # noqa: FBT003 - as declared


def safety(**change: object) -> SafetyState:
    return msgspec.structs.replace(READY, **change)


Changes = dict[str, object]
DRIVEN: Changes = {"state": ArbiterState.ENGAGED, "lease_holder": "ann", "blocked_by": []}
HIT: Changes = {"latched": [Reason.FRONT_BUMPER], "blocked_by": [Reason.FRONT_BUMPER, Reason.NO_LEASE]}
WORST: list[tuple[Changes | None, Changes | None, str, list[str]]] = [
    ({}, {}, "ready", []),
    ({}, {"lease_holder": "ann"}, "in_control", []),
    ({}, DRIVEN, "in_control", []),
    ({"speed_mps": -0.4}, DRIVEN, "driving", []),
    ({}, {"state": ArbiterState.STOPPING, "stop_reason": Reason.DEADMAN}, "stopping", ["deadman"]),
    ({}, {"blocked_by": [Reason.NO_LEASE, Reason.FEEDBACK_MISSING]}, "blocked", ["feedback_missing"]),
    ({"mode": Mode.REMOTE}, {}, "remote_control", ["hand_transmitter"]),
    ({}, HIT, "needs_reset", ["front_bumper"]),
    ({"mode": Mode.REMOTE}, {**HIT, "state": ArbiterState.STOPPING}, "needs_reset", ["front_bumper"]),
    ({"bus_up": False}, {"latched": [Reason.GUARD]}, "bus_down", ["bus_down"]),
    (None, {}, "offline", []),
    ({}, None, "telemetry", []),
]


@pytest.mark.parametrize(("state", "arbiter", "word", "reasons"), WORST)
def test_the_worst_of_a_robot_is_its_word(
    state: Changes | None, arbiter: Changes | None, word: str, reasons: list[str]
) -> None:
    said = None if state is None else msgspec.structs.replace(AUTO, **state)
    row = row_of(report(said, None if arbiter is None else safety(**arbiter)), None)
    assert (row.word, row.level, row.reasons) == (word, WORDS[word], reasons)
    assert row.text


def test_a_robot_without_health_is_looked_at() -> None:
    healthy = report(AUTO, READY)
    assert row_of(healthy, None).level == FINE
    assert row_of(msgspec.structs.replace(healthy, health=None), None).level == LOOK


@pytest.mark.parametrize(("travel_mps", "limit_mps"), [(None, 1.0), (0.4, 0.4), (2.7, 1.0)])
def test_the_limit_is_the_one_in_force(travel_mps: float | None, limit_mps: float) -> None:
    row = row_of(report(AUTO, safety(speed_limit_mps=1.0, travel_speed_limit_mps=travel_mps)), None)
    assert row.limit_mps == limit_mps


def test_why_it_does_not_move_is_said_with_the_buttons_that_cure_it() -> None:
    reasons, _ = why_not(safety(blocked_by=[Reason.REMOTE_STOP, Reason.NOT_ENGAGED]), HEALTH, "cruiser-7")
    assert [reason for reason, _, _ in reasons] == ["remote_stop", "not_engaged"]
    assert [cure for _, _, cure in reasons] == ["press Reset, then Take control", "Take control"]
    every = [reason for reason in Reason if reason is not Reason.NONE]
    cures = [cure for _, _, cure in why_not(safety(blocked_by=every), HEALTH, "cruiser-7")[0]]
    assert [cure for cure in cures if "(driving: key" in cure or "cruiser reset" in cure] == []


def test_what_a_robot_says_cannot_command_a_terminal_or_a_page() -> None:
    row = row_of(report(AUTO, safety(lease_holder="\x1b[2Jann")), None)
    assert "\x1b" not in row.driver + row.text

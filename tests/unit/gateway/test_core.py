"""The gateway without its surroundings."""

from dataclasses import dataclass
from typing import TypeVar

import msgspec
import pytest
from hypothesis import given

from gateway.chassis import port
from gateway.chassis.cruiser.frames import SCALED_BY_VARIANT, load
from gateway.chassis.frame import ERROR, EXTENDED, Frame
from gateway.chassis.layout import Encoder
from gateway.choice import CHASSIS
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.telemetry.health import Links
from schemas import codec
from schemas.codec import Sample
from schemas.messages import (
    CanFrames,
    ControllerState,
    Drive,
    GatewayHealth,
    Gear,
    GearPosition,
    Message,
    Mode,
    ParkingStatus,
    RobotState,
    Variant,
)
from schemas.reasons import Reason
from schemas.settings import REST_TIMEOUT_NS, CanSettings, ChassisSettings, GatewaySettings, Settings
from schemas.subjects import BY_NAME
from tests.support.frames import CHALLENGE, MS, STANDING, WALL_NS, Feedback
from tests.support.rigs.gateway import GatewayRig, Operator, ready
from tests.support.strategies import VARIANTS, frames

UP = Links(bus_up=True)
Kind = TypeVar("Kind", bound=Message)


def core(variant: str = "auto") -> Core:
    """A core whose bus is up."""
    made = Core(CHASSIS, Settings(chassis=ChassisSettings(variant=variant)), "1.2.3", 0)  # type: ignore[arg-type]
    made.update_links(UP, 0)
    return made


def read(sample: Sample | None, kind: type[Kind]) -> Kind:
    assert sample is not None
    message = codec.decode(BY_NAME[sample.subject], sample.payload)
    assert isinstance(message, kind), message
    return message


def ticks(made: Core, until_ms: int, from_ms: int = 0) -> dict[str, list[Message]]:
    """What the ticks of this time publish, by subject."""
    published: dict[str, list[Message]] = {}
    for at_ms in range(from_ms, until_ms + 1, 10):
        for sample in made.tick(at_ms * MS, WALL_NS + at_ms * MS, 0, CHALLENGE).samples:
            published.setdefault(sample.subject, []).append(read(sample, Message))
    return published


def health_after(made: Core, at_ms: int = 1000, from_ms: int | None = None) -> GatewayHealth:
    """The health at this time; the ticks begin then, or before."""
    (health,) = ticks(made, at_ms, at_ms if from_ms is None else from_ms)["gateway/health"]
    assert isinstance(health, GatewayHealth)
    return health


def state_after(made: Core, at_ms: int = 0) -> RobotState:
    (state,) = ticks(made, at_ms, at_ms)["state"]
    assert isinstance(state, RobotState)
    return state


def confirm(made: Core, feedback: Feedback) -> None:
    """Show the standstill evidence."""
    for _ in range(5):
        made.receive_frame(feedback.frame("Auto_WheelSpdFeedback"), 0)


def test_only_speeds_depend_on_the_variant() -> None:
    """The frames that wait for the variant are exactly those whose layouts differ between the two DBCs."""
    coarse, fine = load(Variant.COARSE), load(Variant.FINE)
    differing = {layout.name for layout in coarse.feedback if layout != fine.messages[layout.name]}
    assert differing == set(SCALED_BY_VARIANT)


@pytest.mark.parametrize("variant", VARIANTS)
def test_each_feedback_frame_becomes_its_sample(variant: Variant) -> None:
    """All ten frames are published under their subjects, each with the frame's own time and a running sequence."""
    made, feedback = core(variant.value), Feedback(variant)
    for sequence in range(3):
        for frame in feedback.all():
            message = read(made.receive_frame(frame, 0), Message)
            assert (message.time_ns, message.sequence) == (WALL_NS, sequence)
    subjects = [made.receive_frame(frame, 0) for frame in feedback.all()]
    assert [sample.subject for sample in subjects if sample] == [
        subject.name for subject in BY_NAME.values() if subject.dbc_message
    ]


def test_a_value_arrives_as_it_was_sent() -> None:
    """Gear and speed of the frame are gear and speed of the message."""
    made, feedback = core("fine"), Feedback(Variant.FINE)
    gear = read(made.receive_frame(feedback.frame("Auto_GearFeedBack", {"GearPosition": "drive"}), 0), Gear)
    drive = read(made.receive_frame(feedback.frame("Auto_DriveFeedBack", {"Speed": 1.234}), 0), Drive)
    assert gear.gear_position is GearPosition.DRIVE
    assert drive.speed_mps == pytest.approx(1.234)


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_speed_is_published_before_its_scale_is_known(variant: Variant) -> None:
    """Speeds wait for the evidence; everything else does not. The raw frames keep what was withheld."""
    made, feedback = core(), Feedback(variant)
    for name in SCALED_BY_VARIANT:
        assert made.receive_frame(feedback.frame(name), 0) is None
    health = health_after(made)
    assert {row.name for row in health.feedback if row.withheld} == set(SCALED_BY_VARIANT)
    assert health.faults.get("variant_contradicted") is None
    assert made.receive_frame(feedback.frame("Auto_GearFeedBack"), 0) is not None
    confirm(made, feedback)
    assert made.variant is variant
    speed = read(made.receive_frame(feedback.frame("Auto_DriveFeedBack", {"Speed": 2.0}), 0), Drive)
    assert speed.speed_mps == pytest.approx(2.0)


def test_a_wheel_frame_with_a_wrong_checksum_is_no_evidence() -> None:
    """Nothing may be concluded from a malformed frame, least of all the scale of every speed."""
    made, feedback = core(), Feedback(Variant.COARSE)
    for _ in range(10):
        good = feedback.frame("Auto_WheelSpdFeedback")
        made.receive_frame(Frame(good.can_id, good.data[:7] + bytes([good.data[7] ^ 1])), 0)
    assert made.variant is Variant.UNKNOWN


def test_evidence_against_the_variant_withholds_the_speeds() -> None:
    """A fine chassis under a coarse configuration shows no speed at all, rather than one 40 times too high."""
    made, feedback = core("coarse"), Feedback(Variant.FINE)
    confirm(made, feedback)
    assert made.variant is Variant.UNKNOWN
    assert made.receive_frame(feedback.frame("Auto_DriveFeedBack"), 0) is None
    health = health_after(made)
    assert health.faults["variant_contradicted"] == 5


def test_a_bus_that_returns_has_to_prove_its_variant_again() -> None:
    """Another chassis may be on it now."""
    made, feedback = core(), Feedback(Variant.COARSE)
    confirm(made, feedback)
    made.update_links(Links(bus_up=True, bus_losses=1), 0)
    assert made.variant is Variant.UNKNOWN
    assert made.receive_frame(feedback.frame("Auto_DriveFeedBack"), 0) is None


@dataclass
class Zeros:
    """What becomes of a frame of eight zero bytes."""

    fault: str
    says: dict[str, object]


ALL_ZERO = {
    "Auto_GearFeedBack": Zeros("implausible", {}),  # gear 0
    "Auto_SteeringFeedBack": Zeros("implausible", {}),  # -90 deg
    "Auto_DriveFeedBack": Zeros(
        "", {"active": False, "speed_mps": 0}
    ),  # as of any robot that stands, switched off
    "Auto_BrakingFeedBack": Zeros("", {"active": False, "braking_status": "released"}),
    "Auto_ParkingFeedBack": Zeros("undefined_value", {"active": False, "parking_status": "undefined"}),
    "Auto_WheelSpdFeedback": Zeros("implausible", {}),  # -8 m/s coarse, -32.768 m/s fine
    "Auto_WheelPulseFeedback": Zeros("", {"valid": False, "rear_left_pulses": 0, "rear_right_pulses": 0}),
    "Auto_MileageAndBodyFeedback": Zeros("implausible", {}),  # mode auto of a frame that is not valid
    "Auto_LightFeedback": Zeros("", {"headlamp": False, "right_indicator": False, "left_indicator": False}),
    "Auto_SpeakerFeedback": Zeros("", {"horn": False}),
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", STANDING)
def test_eight_zero_bytes_do_not_pass_for_a_driving_robot(variant: Variant, name: str) -> None:
    """They have a right checksum. What no robot can be is a fault; what remains says that nothing is on."""
    made, zeros = core(variant.value), ALL_ZERO[name]
    sample = made.receive_frame(Frame(load(variant).messages[name].can_id, bytes(8), WALL_NS), 0)
    health = health_after(made)
    row = next(row for row in health.feedback if row.name == name)
    assert health.faults.get("implausible", 0) == row.implausible == (zeros.fault == "implausible")
    if zeros.fault == "implausible":
        assert sample is None
        assert (row.valid, row.silent) == (0, True)
        return
    assert health.faults.get("undefined_value", 0) == (zeros.fault == "undefined_value")
    fields = msgspec.to_builtins(read(sample, Message))
    assert {key: value for key, value in fields.items() if key in zeros.says} == zeros.says
    assert fields.keys() == zeros.says.keys() | {"time_ns", "sequence", "alive_counter"}


@pytest.mark.parametrize("name", STANDING)
def test_zero_bytes_without_end_are_silence(name: str) -> None:
    """Implausible or not, they repeat their counter: soon none of them is current any more."""
    made = core("coarse")
    for at_ms in range(0, 1001, 10):
        made.receive_frame(Frame(load(Variant.COARSE).messages[name].can_id, bytes(8), WALL_NS), at_ms * MS)
        published = made.tick(at_ms * MS, WALL_NS, 0, CHALLENGE).samples
    state = next(read(sample, RobotState) for sample in published if sample.subject == "state")
    assert name in state.silent


def test_implausible_frames_are_lost_and_a_failure_of_their_own() -> None:
    """The third within a second is a failure; the value shown is the last plausible one, until that is too old."""
    made, feedback = core("coarse"), Feedback(Variant.COARSE)
    made.receive_frame(feedback.frame("Auto_SteeringFeedBack", {"Angle": 10.0}), 0)
    for number in range(1, 4):
        frame = feedback.frame("Auto_SteeringFeedBack", {"Angle": -26.0})
        assert made.receive_frame(frame, number * 10 * MS) is None
    state = state_after(made, 50)
    assert state.angle_deg == pytest.approx(10, abs=0.05)
    made.receive_frame(feedback.frame("Auto_SteeringFeedBack", {"Angle": 10.0}), 50 * MS)
    row = next(row for row in health_after(made).feedback if row.name == "Auto_SteeringFeedBack")
    assert (row.valid, row.lost, row.implausible) == (2, 3, 3)
    assert "implausible" in row.failures
    assert row.checksum_faults == 0


def test_what_is_withheld_is_not_judged() -> None:
    """A speed whose scale is not known cannot be too high; a standing fine chassis is not -8 m/s."""
    made, feedback = core(), Feedback(Variant.FINE)
    made.receive_frame(feedback.frame("Auto_WheelSpdFeedback"), 0)
    made.receive_frame(feedback.frame("Auto_DriveFeedBack", {"Speed": 2.2}), 0)
    health = health_after(made)
    assert "implausible" not in health.faults
    assert [row.withheld for row in health.feedback if row.name in SCALED_BY_VARIANT] == [1, 1]


def test_a_speed_in_the_other_scale_is_implausible() -> None:
    """0.5 m/s fine would be 20 m/s coarse."""
    made, feedback = core("coarse"), Feedback(Variant.FINE)
    assert made.receive_frame(feedback.frame("Auto_DriveFeedBack", {"Speed": 0.5}), 0) is None
    assert health_after(made).faults == {"implausible": 1}


def test_no_decoder_is_compiled_in_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """To compile one takes a millisecond: both variants' are made at the start, and changed for one another."""
    made, fine, coarse = core(), Feedback(Variant.FINE), Feedback(Variant.COARSE)
    monkeypatch.setattr(port, "compile_message", None)
    for feedback, variant in ((fine, Variant.FINE), (coarse, Variant.COARSE)):
        confirm(made, feedback)
        assert made.variant is variant
        drive = read(made.receive_frame(feedback.frame("Auto_DriveFeedBack", {"Speed": 2.0}), 0), Drive)
        assert drive.speed_mps == pytest.approx(2.0)
    made.update_links(Links(bus_up=True, bus_losses=1), 0)
    assert made.variant is Variant.UNKNOWN


def test_a_speed_of_the_former_scale_is_not_shown() -> None:
    """When the evidence turns, what was decoded in the other scale is forgotten."""
    made, fine = core(), Feedback(Variant.FINE)
    confirm(made, Feedback(Variant.COARSE))
    made.receive_frame(fine.frame("Auto_GearFeedBack", {"GearPosition": "drive"}), 0)
    made.receive_frame(fine.frame("Auto_DriveFeedBack", {"Speed": 0.05}), 0)
    confirm(made, fine)
    state = state_after(made)
    assert state.variant is Variant.FINE
    assert state.speed_mps is None


@given(frame=frames)
def test_no_frame_raises_and_a_malformed_one_is_never_data(frame: Frame) -> None:
    """Whatever comes is counted; a sample comes out only of a valid feedback frame; the raw frame is kept."""
    made = core("coarse")
    sample = made.receive_frame(frame, 0)
    health = health_after(made)
    assert health.frames == 1
    commands = {layout.can_id for layout in load(Variant.COARSE).commands}
    counted = sum(health.faults.values())
    if sample is None and frame.can_id not in commands:
        assert counted == 1
    malformed = {
        "checksum",
        "length",
        "fd_frame",
        "remote_frame",
        "error_frame",
        "unknown_identifier",
        "implausible",
    }
    assert sample is None or not malformed & health.faults.keys()


def test_raw_frames_come_in_batches_of_50_ms_in_their_order() -> None:
    """Every frame is in exactly one batch, whatever it is, with its time and flags."""
    made = core()
    sent = [Frame(EXTENDED | number, bytes([number]), WALL_NS + number, 0, 0) for number in range(100)]
    received: list[tuple[int, bytes, int]] = []
    for number, frame in enumerate(sent):
        made.receive_frame(frame, number * MS)
        for sample in made.tick(number * MS, WALL_NS, 0, CHALLENGE).samples:
            if sample.subject == "can/{bus}/rx":
                batch = read(sample, CanFrames)
                assert batch.sequence * 50 <= number
                received += zip(batch.can_id, batch.data, batch.frame_time_ns, strict=True)
    batch = next(
        read(s, CanFrames)
        for s in made.tick(150 * MS, WALL_NS, 0, CHALLENGE).samples
        if s.subject == "can/{bus}/rx"
    )
    received += zip(batch.can_id, batch.data, batch.frame_time_ns, strict=True)
    assert received == [(frame.can_id, frame.data, frame.wall_ns) for frame in sent]


def test_state_says_nothing_that_was_not_seen() -> None:
    """Before the first frame every field is null or undefined, and every frame is named as silent."""
    state = state_after(core())
    assert set(state.silent) == set(STANDING)
    assert state.mode is Mode.UNDEFINED
    assert (state.speed_mps, state.angle_deg, state.front_bumper) == (None, None, None)


def test_state_goes_out_20_times_a_second_and_health_once() -> None:
    """The rates of the subject table, from ticks of 10 ms."""
    published = ticks(core(), 1990)
    assert len(published["state"]) == 40
    assert len(published["gateway/health"]) == 1
    sequences = [message.sequence for message in published["state"]]
    assert sequences == list(range(40))


def test_a_silent_frame_leaves_the_state() -> None:
    """A value older than its frame's silence limit is not shown as current."""
    made, feedback = core("coarse"), Feedback(Variant.COARSE)
    for frame in feedback.all():
        made.receive_frame(frame, 0)
    states = ticks(made, 600)["state"]
    assert all(isinstance(state, RobotState) for state in states)
    by_time = {index * 50: state for index, state in enumerate(states) if isinstance(state, RobotState)}
    assert by_time[100].parking_status is ParkingStatus.APPLIED
    assert by_time[150].parking_status is ParkingStatus.UNDEFINED
    assert by_time[200].mode is Mode.STOP
    assert by_time[250].mode is Mode.UNDEFINED
    assert by_time[500].rear_left_speed_mps == pytest.approx(0)
    assert by_time[550].rear_left_speed_mps is None


@pytest.mark.parametrize(
    ("gear", "wheels_mps", "speed_mps"),
    [
        ("drive", 1.0, 1.0),
        ("reverse", -1.0, -1.0),
        ("neutral", -1.0, -1.0),
        ("reverse", 0.0, -1.0),
        ("neutral", 0.0, None),
    ],
)
def test_speed_is_signed_by_the_wheels_then_by_the_gear(
    gear: str, wheels_mps: float, speed_mps: float | None
) -> None:
    """The drive feedback is a magnitude; in neutral the wheels alone tell the direction, or nobody does."""
    made, feedback = core("coarse"), Feedback(Variant.COARSE)
    made.receive_frame(feedback.frame("Auto_GearFeedBack", {"GearPosition": gear}), 0)
    made.receive_frame(feedback.frame("Auto_DriveFeedBack", {"Speed": 1.0}), 0)
    wheels = {"RearLeftSpeed": wheels_mps, "RearRightSpeed": wheels_mps}
    made.receive_frame(feedback.frame("Auto_WheelSpdFeedback", wheels), 0)
    state = state_after(made)
    assert state.speed_mps == pytest.approx(speed_mps)


def test_yaw_rate_is_that_of_the_bicycle_model() -> None:
    """1 m/s at 24 degrees left with a wheelbase of 0.660 m turns at 0.6746 rad/s, left positive."""
    made, feedback = core("fine"), Feedback(Variant.FINE)
    made.receive_frame(feedback.frame("Auto_GearFeedBack", {"GearPosition": "drive"}), 0)
    made.receive_frame(feedback.frame("Auto_SteeringFeedBack", {"Angle": 24.0}), 0)
    made.receive_frame(feedback.frame("Auto_DriveFeedBack", {"Speed": 1.0}), 0)
    state = state_after(made)
    assert state.yaw_rate_radps == pytest.approx(0.6746, abs=0.001)


def test_health_counts_a_second_of_a_whole_bus() -> None:
    """630 frames, each at its nominal rate, none lost, no fault."""
    made, feedback = core("coarse"), Feedback(Variant.COARSE)
    for at_ns, frame in feedback.second():
        made.receive_frame(frame, at_ns)
    health = health_after(made)
    assert (health.frames, health.frames_per_s) == (630, 630)
    assert health.faults == {}
    layout = load(Variant.COARSE)
    for row in health.feedback:
        assert row.rate_hz == pytest.approx(1e9 / layout.messages[row.name].period_ns)
        assert (row.lost, row.silent) == (0, False)


def test_each_failure_is_told_of_its_own_frame() -> None:
    """Three checksum faults within a second, a stuck counter and a silence are named where they are."""
    made, feedback = core("coarse"), Feedback(Variant.COARSE)
    for number in range(100):
        good = feedback.frame("Auto_GearFeedBack")
        made.receive_frame(good, number * 10 * MS)
        made.receive_frame(Frame(good.can_id, good.data[:7] + bytes([good.data[7] ^ 1])), number * 10 * MS)
        stuck = Feedback(Variant.COARSE).frame("Auto_SteeringFeedBack")
        made.receive_frame(stuck, number * 10 * MS)
    health = health_after(made)
    rows = {row.name: row for row in health.feedback}
    assert rows["Auto_GearFeedBack"].failures == ["checksum"]
    assert rows["Auto_GearFeedBack"].checksum_faults == 100
    assert rows["Auto_SteeringFeedBack"].failures == ["alive_counter", "silence"]
    assert rows["Auto_DriveFeedBack"].failures == ["silence"]


def test_a_listening_gateway_has_no_command_flow() -> None:
    """It judges nothing, offers no frame, publishes neither decisions nor a journal, and is always at rest."""
    made = Core(CHASSIS, Settings(gateway=GatewaySettings(listen_only=True)), "1.2.3", 0)
    made.update_links(UP, 0)
    assert made.command is None
    made.receive_request(RawRequest(1, "acquire", "first", b"", 0), 0)
    subjects: set[str] = set()
    for at_ms in range(0, 2001, 10):
        for frame in Feedback(Variant.COARSE).all():
            made.receive_frame(frame, at_ms * MS)
        due = made.tick(at_ms * MS, WALL_NS, 0, CHALLENGE)
        assert (due.frames, due.replies, made.sent(0, at_ms * MS, WALL_NS)) == ([], [], [])
        subjects |= {sample.subject for sample in due.samples}
    assert subjects == {"can/{bus}/rx", "state", "gateway/health", "chassis/odometry"}
    assert made.lease_holder == ""
    made.shut_down(0)
    assert made.is_at_rest


def test_raw_frames_may_be_left_out() -> None:
    """With can.raw_frames off they are counted and journalled, and not published as they are."""
    settings = Settings(can=CanSettings(raw_frames=False), chassis=ChassisSettings(variant="coarse"))
    made = Core(CHASSIS, settings, "1.2.3", 0)
    made.update_links(UP, 0)
    confirm(made, Feedback(Variant.COARSE))
    published = ticks(made, 1000)
    assert not [subject for subject in published if subject.startswith("can/")]
    assert published["journal"]
    (health,) = published["gateway/health"]
    assert isinstance(health, GatewayHealth)
    assert health.frames == 5


def test_error_frames_tell_the_state_of_the_controller_until_the_bus_is_lost() -> None:
    """What is dropped before it is read is told as well."""
    made = core()
    states = []
    for number, kinds in enumerate((0x00, 0x40, 0x08, 0x100)):
        made.receive_frame(Frame(ERROR | kinds, bytes(8)), 0)
        made.update_links(Links(bus_up=True, bus_drops=number), 0)
        health = health_after(made, 1000 * number + 1000, 1000 * number + 10)
        states.append((health.controller.value, health.bus_drops))
    assert states == [("unknown", 0), ("bus_off", 1), ("bus_off", 2), ("active", 3)]
    made.update_links(Links(bus_up=True, bus_losses=1), 0)
    assert health_after(made, 5000, 4010).controller is ControllerState.UNKNOWN


@pytest.mark.parametrize(
    ("guard_sends", "spoilt", "is_other"), [(False, False, True), (True, False, False), (False, True, False)]
)
def test_whose_command_frames_are_another_computers(*, guard_sends: bool, spoilt: bool, is_other: bool) -> None:
    """Valid ones, while the guard does not send: its frames are ours."""
    made = Core(CHASSIS, Settings(), "1.2.3", 0)
    made.update_links(Links(bus_up=True, guard_sends=guard_sends), 0)
    frame = Encoder(load(Variant.COARSE)).encode("Auto_DriveCmd", {}, 0)
    made.receive_frame(Frame(frame.can_id, b"\1" + frame.data[1:]) if spoilt else frame, 7)
    made.tick(10 * MS, WALL_NS, 0, CHALLENGE)
    assert made.command is not None
    assert made.command.arbiter.monitor.chassis.commander_ns == (7 if is_other else None)


@pytest.mark.parametrize("takes", [0, 3, 5])
def test_a_decision_says_how_many_frames_the_bus_took(takes: int) -> None:
    """What was asked for is one thing, what went out is another."""
    rig, operator = ready()
    operator.engage()
    rig.takes = takes
    operator.reason("renew")
    assert (rig.decided[-1].request, rig.decided[-1].frames_sent) == ("renew", takes)


class Wire(GatewayRig):
    """Notes what went out and when, and what is published of it."""

    def __init__(self) -> None:
        super().__init__()
        self.went_out: list[tuple[int, bytes, int]] = []
        self.published_frames: list[tuple[int, bytes, int]] = []

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            sent = len(self.out)
            super().tick()
            self.went_out += [(frame.can_id, frame.data, self.wall_ns) for frame in self.out[sent:]]
            for sample in self.samples:
                if sample.subject == "can/{bus}/tx":
                    batch = read(sample, CanFrames)
                    self.published_frames += zip(batch.can_id, batch.data, batch.frame_time_ns, strict=True)


def test_what_was_sent_is_published_and_what_was_not_is_not() -> None:
    """Every frame that the bus took, in its order and with the time at which it did; none that it did not take."""
    rig = Wire()
    rig.run(0.6)
    assert rig.published_frames == [], "nothing is sent while it stands by"
    operator = Operator(rig)
    operator.engage()
    for number in range(60):
        rig.takes = (None, 2, None, 0, 4)[number % 5]
        operator.reason("renew")
    rig.takes = None
    rig.tick(10)
    assert len(rig.published_frames) > 200
    assert rig.published_frames == rig.went_out[: len(rig.published_frames)]
    assert len(rig.went_out) - len(rig.published_frames) <= 25, "the rest is in the batch to come"


def test_an_end_brings_the_robot_to_rest_first() -> None:
    """It stops, it holds, it disables, and then it is at rest; it cannot be engaged again."""
    rig, operator = ready()
    operator.engage()
    assert not rig.core.is_at_rest
    rig.core.shut_down(rig.now_ns)
    rig.until(lambda: rig.core.is_at_rest, REST_TIMEOUT_NS / 1e9)
    assert not rig.told
    assert rig.chassis.state.mode is Mode.STOP
    operator.take_lease()
    assert operator.reason("engage") is Reason.SHUTDOWN
    assert rig.core.is_at_rest

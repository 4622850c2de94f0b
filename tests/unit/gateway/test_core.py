"""The gateway without its surroundings."""

from itertools import product
from typing import Any

import msgspec
import pytest
from hypothesis import given

from gateway.chassis import port
from gateway.chassis.cruiser.frames import MOTION_FRAMES, SCALED_BY_VARIANT, load
from gateway.chassis.frame import ERROR, EXTENDED, Frame
from gateway.chassis.layout import Encoder, MessageLayout
from gateway.choice.chassis import CHASSIS
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.telemetry.health import Links
from schemas import codec
from schemas.codec import Sample
from schemas.messages import CanFrames, GatewayHealth, Message, Mode, ParkingStatus, RobotState, Variant
from schemas.settings import CanSettings, ChassisSettings, GatewaySettings, Settings
from schemas.subjects import BY_NAME
from tests.support.frames import CHALLENGE, MS, STANDING, WALL_NS, Feedback
from tests.support.rigs.gateway import GatewayRig, Operator
from tests.support.strategies import VARIANTS, frames

COARSE, FINE, UNKNOWN = Variant.COARSE, Variant.FINE, Variant.UNKNOWN


def core(variant: str = "auto", **settings: Any) -> Core:  # noqa: ANN401 - any section
    """A core whose bus is up."""
    chosen = Settings(chassis=ChassisSettings(variant=variant), **settings)  # type: ignore[arg-type]
    made = Core(CHASSIS, chosen, "1.2.3", 0)
    made.update_links(Links(bus_up=True), 0)
    return made


def read(sample: Sample | None) -> Any:  # noqa: ANN401 - of any subject
    assert sample is not None
    message = codec.decode(BY_NAME[sample.subject], sample.payload)
    assert isinstance(message, Message), message
    return message


def ticks(made: Core, until_ms: int, from_ms: int = 0) -> dict[str, list[Any]]:
    """The samples of the ticks of this time, by subject."""
    published: dict[str, list[Any]] = {}
    for at_ms in range(from_ms, until_ms + 1, 10):
        for sample in made.tick(at_ms * MS, WALL_NS + at_ms * MS, 0, CHALLENGE).samples:
            published.setdefault(sample.subject, []).append(read(sample))
    return published


def health_after(made: Core, at_ms: int = 1000, from_ms: int | None = None) -> GatewayHealth:
    (health,) = ticks(made, at_ms, at_ms if from_ms is None else from_ms)["gateway/health"]
    assert isinstance(health, GatewayHealth)
    return health


def state_after(made: Core, at_ms: int = 0) -> RobotState:
    (state,) = ticks(made, at_ms, at_ms)["state"]
    assert isinstance(state, RobotState)
    return state


def confirm(made: Core, feedback: Feedback) -> None:
    for _ in range(5):
        made.receive_frame(feedback.frame("Auto_WheelSpdFeedback"), 0)


def give(made: Core, feedback: Feedback, at_ns: int = 0, **values: float | str) -> Sample | None:
    """A feedback frame with this value, by the short name of its frame. Returns the sample."""
    sample = None
    for short, value in values.items():
        name, signal = {
            "gear": ("Auto_GearFeedBack", "GearPosition"),
            "angle_deg": ("Auto_SteeringFeedBack", "Angle"),
            "speed_mps": ("Auto_DriveFeedBack", "Speed"),
        }[short]
        sample = made.receive_frame(feedback.frame(name, {signal: value}), at_ns)
    return sample


def spoilt(frame: Frame) -> Frame:
    return Frame(frame.can_id, frame.data[:7] + bytes([frame.data[7] ^ 1]))


# What is decoded.


@pytest.mark.parametrize("variant", VARIANTS)
def test_each_feedback_frame_becomes_its_sample(variant: Variant) -> None:
    """All ten frames are published under their subjects, each with the frame's own time and a running sequence."""
    made, feedback = core(variant.value), Feedback(variant)
    for sequence in range(3):
        samples = [made.receive_frame(frame, 0) for frame in feedback.all()]
        assert {(one.time_ns, one.sequence) for one in map(read, samples)} == {(WALL_NS, sequence)}
        assert [sample.subject for sample in samples if sample] == [
            subject.name for subject in BY_NAME.values() if subject.dbc_message
        ]
    assert read(give(made, feedback, gear="drive")).gear_position.value == "drive"
    assert read(give(made, feedback, speed_mps=1.2)).speed_mps == pytest.approx(1.2)


@pytest.mark.parametrize("variant", VARIANTS)
def test_no_speed_is_published_before_its_scale_is_known(variant: Variant) -> None:
    """Only the frames whose layouts differ between the DBCs wait for the evidence, and are not judged."""
    coarse, fine = load(COARSE), load(FINE)
    differing = {layout.name for layout in coarse.feedback if layout != fine.messages[layout.name]}
    assert differing == set(SCALED_BY_VARIANT)
    made, feedback = core(), Feedback(variant)
    for name in SCALED_BY_VARIANT:
        assert made.receive_frame(feedback.frame(name), 0) is None
    health = health_after(made)
    assert {row.name for row in health.feedback if row.withheld} == set(SCALED_BY_VARIANT)
    assert not {"variant_contradicted", "implausible"} & health.faults.keys()
    assert give(made, feedback, gear="drive") is not None
    # A malformed frame is no evidence, least of all of the scale of every speed.
    for _ in range(10):
        made.receive_frame(spoilt(feedback.frame("Auto_WheelSpdFeedback")), 0)
    assert made.variant is UNKNOWN
    confirm(made, feedback)
    assert made.variant is variant
    assert read(give(made, feedback, speed_mps=2.0)).speed_mps == pytest.approx(2.0)


def test_evidence_against_the_variant_withholds_the_speeds() -> None:
    """A fine chassis under a coarse configuration shows no speed at all, rather than one 40 times too high."""
    made, feedback = core("coarse"), Feedback(FINE)
    assert give(made, feedback, speed_mps=0.5) is None, "20 m/s coarse"
    assert health_after(made).faults == {"implausible": 1}
    confirm(made, feedback)
    assert made.variant is UNKNOWN
    assert give(made, feedback, speed_mps=0.1) is None
    assert health_after(made, 2000).faults["variant_contradicted"] == 5


def test_the_variant_may_change_and_no_decoder_is_compiled_in_the_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values of the other scale are forgotten; a bus that returns has to prove its variant again."""
    made = core()
    monkeypatch.setattr(port, "compile_message", None)
    for variant in (FINE, COARSE, FINE):
        feedback = Feedback(variant)
        confirm(made, feedback)
        assert made.variant is variant
        give(made, feedback, gear="drive")
        assert state_after(made).speed_mps is None
        assert read(give(made, feedback, speed_mps=2.0)).speed_mps == pytest.approx(2.0)
        made._state_due_ns = 0
    made.update_links(Links(bus_up=True, bus_losses=1), 0)
    assert made.variant is UNKNOWN
    assert give(made, Feedback(FINE), speed_mps=1.0) is None


FAULT = "fault"
ALL_ZERO: dict[str, dict[str, object] | str] = {
    # What eight zero bytes say, or the fault that they are.
    "Auto_GearFeedBack": FAULT,  # gear 0
    "Auto_SteeringFeedBack": FAULT,  # -90 deg
    "Auto_DriveFeedBack": {"active": False, "speed_mps": 0},  # as of any robot that stands, switched off
    "Auto_BrakingFeedBack": {"active": False, "braking_status": "released"},
    "Auto_ParkingFeedBack": {"active": False, "parking_status": "undefined"},
    "Auto_WheelSpdFeedback": FAULT,  # -8 m/s coarse, -32.768 m/s fine
    "Auto_WheelPulseFeedback": {"valid": False, "rear_left_pulses": 0, "rear_right_pulses": 0},
    "Auto_MileageAndBodyFeedback": FAULT,  # mode auto of a frame that is not valid
    "Auto_LightFeedback": {"headlamp": False, "right_indicator": False, "left_indicator": False},
    "Auto_SpeakerFeedback": {"horn": False},
}


@pytest.mark.parametrize(("variant", "name"), [*product(VARIANTS, STANDING)])
def test_eight_zero_bytes_do_not_pass_for_a_driving_robot(variant: Variant, name: str) -> None:
    """Their checksum is right: they are implausible, or show that nothing is on, and soon they are stale."""
    made, says = core(variant.value), ALL_ZERO[name]
    zeros = Frame(load(variant).messages[name].can_id, bytes(8), WALL_NS)
    sample = made.receive_frame(zeros, 0)
    health = health_after(made)
    row = next(row for row in health.feedback if row.name == name)
    assert health.faults.get("implausible", 0) == row.implausible == (says == FAULT)
    if isinstance(says, str):
        assert (sample, row.valid, row.silent) == (None, 0, True)
    else:
        assert health.faults.get("undefined_value", 0) == ("undefined" in says.values())
        fields = msgspec.to_builtins(read(sample))
        assert {key: value for key, value in fields.items() if key in says} == says
        assert fields.keys() == says.keys() | {"time_ns", "sequence", "alive_counter"}
    for at_ms in range(1010, 2010, 10):
        made.receive_frame(zeros, at_ms * MS)
        published = ticks(made, at_ms, at_ms)
    assert name in published["state"][0].silent


@given(frame=frames)
def test_no_frame_raises_and_a_malformed_one_is_never_data(frame: Frame) -> None:
    """Every frame is counted; only a valid feedback frame makes a sample."""
    made = core("coarse")
    sample = made.receive_frame(frame, 0)
    health = health_after(made)
    assert health.frames == 1
    commands = {layout.can_id for layout in load(COARSE).commands}
    if sample is None and frame.can_id not in commands:
        assert sum(health.faults.values()) == 1
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


# What is published by time.


def test_raw_frames_come_in_batches_of_50_ms_in_their_order() -> None:
    """Every frame is in exactly one batch, with its time and flags; unless batches are switched off."""
    for is_on in (True, False):
        made = core("coarse", can=CanSettings(raw_frames=is_on))
        sent = [Frame(EXTENDED | number, bytes([number]), WALL_NS + number, 0, 0) for number in range(100)]
        received: list[tuple[int, bytes, int]] = []
        for number in range(160):
            if number < 100:
                made.receive_frame(sent[number], number * MS)
            for sample in made.tick(number * MS, WALL_NS, 0, CHALLENGE).samples:
                if sample.subject == "can/{bus}/rx":
                    batch = read(sample)
                    assert batch.sequence * 50 <= number
                    received += zip(batch.can_id, batch.data, batch.frame_time_ns, strict=True)
        assert received == [(frame.can_id, frame.data, frame.wall_ns) for frame in sent] * is_on
        published = ticks(made, 1000, 1000)
        assert published["journal"]
        assert published["gateway/health"][0].frames == 100


def test_state_goes_out_20_times_a_second_and_health_once() -> None:
    """The rates of the subject table. Without feedback values are unknown, and every frame is silent."""
    published = ticks(core(), 1990)
    assert [state.sequence for state in published["state"]] == list(range(40))
    assert len(published["gateway/health"]) == 1
    state = published["state"][0]
    assert (set(state.silent), state.mode) == (set(STANDING), Mode.UNDEFINED)
    assert (state.speed_mps, state.angle_deg, state.front_bumper) == (None, None, None)


def test_a_silent_frame_leaves_the_state() -> None:
    """A value older than its frame's silence limit is not shown as current."""
    made, feedback = core("coarse"), Feedback(COARSE)
    for frame in feedback.all():
        made.receive_frame(frame, 0)
    states = ticks(made, 600)["state"]
    for at_ms, field, value in (
        (100, "parking_status", ParkingStatus.APPLIED),
        (150, "parking_status", ParkingStatus.UNDEFINED),
        (200, "mode", Mode.STOP),
        (250, "mode", Mode.UNDEFINED),
        (500, "rear_left_speed_mps", 0),
        (550, "rear_left_speed_mps", None),
    ):
        assert getattr(states[at_ms // 50], field) == value, at_ms


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
    """1 m/s at 24 degrees left with a wheelbase of 0.660 m turns at 0.6746 rad/s, left positive."""
    made, feedback = core("coarse"), Feedback(COARSE)
    give(made, feedback, gear=gear, speed_mps=1.0, angle_deg=24.0)
    wheels = {"RearLeftSpeed": wheels_mps, "RearRightSpeed": wheels_mps}
    made.receive_frame(feedback.frame("Auto_WheelSpdFeedback", wheels), 0)
    state = state_after(made)
    assert state.speed_mps == pytest.approx(speed_mps)
    yaw_rate_radps = None if speed_mps is None else pytest.approx(0.6746 * speed_mps, abs=0.001)
    assert state.yaw_rate_radps == yaw_rate_radps


def test_health_counts_a_second_of_a_whole_bus() -> None:
    made, feedback = core("coarse"), Feedback(COARSE)
    for at_ns, frame in feedback.second():
        made.receive_frame(frame, at_ns)
    health = health_after(made)
    assert (health.frames, health.frames_per_s, health.faults) == (630, 630, {})
    for row in health.feedback:
        assert row.rate_hz == pytest.approx(1e9 / load(COARSE).messages[row.name].period_ns)
        assert (row.lost, row.silent) == (0, False)


def test_error_frames_tell_the_state_of_the_controller_until_the_bus_is_lost() -> None:
    made = core()
    states = []
    for number, kinds in enumerate((0x00, 0x40, 0x08, 0x100)):
        made.receive_frame(Frame(ERROR | kinds, bytes(8)), 0)
        made.update_links(Links(bus_up=True, bus_drops=number), 0)
        health = health_after(made, 1000 * number + 1000, 1000 * number + 10)
        states.append((health.controller.value, health.bus_drops))
    assert states == [("unknown", 0), ("bus_off", 1), ("bus_off", 2), ("active", 3)]
    made.update_links(Links(bus_up=True, bus_losses=1), 0)
    assert health_after(made, 5000, 4010).controller.value == "unknown"


# Commands.


def test_a_listening_gateway_has_no_command_flow() -> None:
    """It judges nothing, offers no frame, publishes neither decisions nor a journal, and is always at rest."""
    made = core(gateway=GatewaySettings(listen_only=True))
    made.receive_request(RawRequest(1, "acquire", "first", b"", 0), 0)
    subjects: set[str] = set()
    for at_ms in range(0, 2001, 10):
        for frame in Feedback(COARSE).all():
            made.receive_frame(frame, at_ms * MS)
        due = made.tick(at_ms * MS, WALL_NS, 0, CHALLENGE)
        assert (due.frames, due.replies, made.sent(0, at_ms * MS, WALL_NS)) == ([], [], [])
        subjects |= {sample.subject for sample in due.samples}
    assert subjects == {"can/{bus}/rx", "state", "gateway/health", "chassis/odometry"}
    made.shut_down(0)
    assert (made.command, made.lease_holder, made.is_at_rest) == (None, "", True)


@pytest.mark.parametrize("layout", load(COARSE).commands, ids=lambda one: one.name)
def test_another_computer_is_noticed_by_its_motion_commands(layout: MessageLayout) -> None:
    """By valid ones, unless the guard sends; lamps, feedback and standard frames do not count."""
    frame = Encoder(load(COARSE)).encode(layout.name, {}, 0)
    others = (spoilt(frame), Frame(frame.can_id & ~EXTENDED, frame.data), *Feedback(COARSE).all())
    is_motion = layout.name in MOTION_FRAMES
    for guard_sends, received, is_other in (
        (False, [frame], is_motion),
        (True, [frame], False),
        (False, others, False),
    ):
        made = core()
        made.update_links(Links(bus_up=True, guard_sends=guard_sends), 0)
        for one in received:
            made.receive_frame(one, 7)
        made.tick(10 * MS, WALL_NS, 0, CHALLENGE)
        assert made.command is not None
        assert made.command.arbiter.monitor.chassis.commander_ns == (7 if is_other else None)


def test_what_was_sent_is_published_and_what_was_not_is_not() -> None:
    """Frames in order with the time at which the bus accepted them; a decision has their number."""
    rig = GatewayRig()
    operator, out, published = Operator(rig), list[tuple[int, bytes, int]](), list[tuple[int, bytes, int]]()

    tick = rig.tick

    def followed(count: int = 1) -> None:
        for _ in range(count):
            sent = len(rig.out)
            tick()
            out.extend((frame.can_id, frame.data, rig.wall_ns) for frame in rig.out[sent:])
            for batch in (read(sample) for sample in rig.samples if sample.subject == "can/{bus}/tx"):
                assert isinstance(batch, CanFrames)
                published.extend(zip(batch.can_id, batch.data, batch.frame_time_ns, strict=True))

    rig.tick = followed  # type: ignore[method-assign]
    rig.tick(60)
    assert published == [], "nothing is sent while it stands by"
    operator.engage()
    for number in range(60):
        rig.takes = (None, 2, None, 0, 4)[number % 5]
        operator.reason("renew")
        assert rig.decided[-1].frames_sent == (5 if rig.takes is None else rig.takes)
    rig.takes = None
    rig.tick(10)
    assert len(published) > 200
    assert published == out[: len(published)]
    assert len(out) - len(published) <= 25, "the rest is in the batch to come"

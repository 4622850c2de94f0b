"""How the chassis behaves: the protocol notes, sentence by sentence."""

import json
import math
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import EXTENDED, REMOTE, Frame
from gateway.chassis.layout import Decoded, FrameDecoder
from gateway.sim.body import Conditions, StopMode
from gateway.sim.model import VirtualChassis
from schemas.messages import BrakingStatus, GearPosition, Mode, ParkingStatus, Variant
from tests.support import SUPPORT
from tests.support.rigs.chassis import ENABLES, MS, ChassisRig, S
from tests.support.strategies import frames as any_frames

EXAMPLES = SUPPORT / "manual_examples.json"
VARIANTS = pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])


@VARIANTS
def test_a_second_has_630_valid_frames(variant: Variant) -> None:
    """Every feedback message comes at its period, with its counter running and its checksum right."""
    rig = ChassisRig(variant)
    frames = rig.run(1)
    assert len(frames) == 630
    decoded = [rig.decoder.decode(frame) for frame in frames]
    assert all(isinstance(one, Decoded) for one in decoded)
    rates = Counter(one.layout.name for one in decoded if isinstance(one, Decoded))
    assert rates == {message.name: S // message.period_ns for message in load(variant).feedback}
    for name in rates:
        counters = rig.counters(name, frames)
        assert counters == [number % 16 for number in range(len(counters))]


@given(cuts=st.lists(st.integers(0, 300 * MS), max_size=20))
def test_frames_do_not_depend_on_how_often_they_are_asked_for(cuts: list[int]) -> None:
    """Asked in one go or in slices, the chassis sends the same."""
    whole, sliced = ChassisRig(), ChassisRig()
    for rig in (whole, sliced):
        rig.command("drive", 1.0, 10.0)
        rig.fault("drop all every 3 for 20 frames")
        rig.fault("foreign 200 every 70ms")
    frames = [frame for cut in sorted(cuts) for frame in sliced.chassis.advance(cut)]
    frames += sliced.chassis.advance(300 * MS)
    assert frames == whole.chassis.advance(300 * MS)


def test_the_next_due_time_is_when_frames_come() -> None:
    """Nothing comes before the time it names, and something at that time."""
    chassis = VirtualChassis(load(Variant.COARSE), 5)
    assert chassis.next_due_ns == 10 * MS + 5
    assert chassis.advance(chassis.next_due_ns - 1) == []
    assert len(chassis.advance(chassis.next_due_ns)) == 5


def test_frames_carry_the_wall_time_they_are_given() -> None:
    """The caller's clock is the only clock."""
    chassis = VirtualChassis(load(Variant.COARSE), 0)
    assert {frame.wall_ns for frame in chassis.advance(50 * MS, 77)} == {77}


def test_the_rate_can_be_raised_to_a_saturated_bus() -> None:
    """With a multiplier the frames come that many times as often, and the chassis moves no faster for it."""
    nominal, fast = ChassisRig(), ChassisRig(rate_multiplier=11.905)
    for rig in (nominal, fast):
        rig.command("drive", 1.0)
    assert len(nominal.run(2)) == 1260
    assert len(fast.run(2)) == pytest.approx(15_000, abs=5)
    assert fast.speed_mps == pytest.approx(nominal.speed_mps, abs=0.01)


def test_it_starts_standing_parked_and_stopped() -> None:
    """At power-up nobody has commanded anything."""
    rig = ChassisRig()
    rig.run(0.1)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "stop"
    assert rig.seen["Auto_GearFeedBack"]["GearPosition"] == "park"
    assert rig.seen["Auto_ParkingFeedBack"]["ParkingStatus"] == "applied"
    assert rig.seen["Auto_WheelSpdFeedback"]["RearLeftSpeed"] == 0
    assert rig.seen["Auto_GearFeedBack"]["Active"] is False


@pytest.mark.parametrize("missing", ENABLES)
def test_auto_needs_all_five_enables(missing: str) -> None:
    """Any enable missing is stop mode, and a moving chassis stops."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    rig.run(2)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "auto"
    assert rig.speed_mps == 1.0
    rig.send(missing, Enable=False)
    rig.run(2)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "stop"
    assert rig.speed_mps == 0


@VARIANTS
def test_it_reports_what_it_does(variant: Variant) -> None:
    """In auto mode the feedback shows gear, angle, speed, wheels and pulses."""
    rig = ChassisRig(variant)
    rig.command("reverse", 1.0, -10.0)
    rig.run(3)
    assert rig.seen["Auto_GearFeedBack"] | {"AliveCounter": 0, "Checksum": 0} == {
        "Active": True,
        "GearPosition": "reverse",
        "AliveCounter": 0,
        "Checksum": 0,
    }
    assert rig.seen["Auto_SteeringFeedBack"]["Angle"] == pytest.approx(-10, abs=0.05)
    assert rig.seen["Auto_DriveFeedBack"]["Speed"] == pytest.approx(1.0)
    left, right = (rig.seen["Auto_WheelSpdFeedback"][name] for name in ("RearLeftSpeed", "RearRightSpeed"))
    assert isinstance(left, float)
    assert isinstance(right, float)
    assert (left + right) / 2 == pytest.approx(-1.0, abs=0.04)
    assert right > left, "reversing with the wheels to the right, the nose goes left"
    pulses = rig.seen["Auto_WheelPulseFeedback"]["RearLeftPulses"]
    assert isinstance(pulses, int)
    assert pulses < -1000


@pytest.mark.parametrize("example", ["gear D", "steering +24 deg", "parking apply"])
def test_it_answers_the_manuals_examples_as_the_manual_does(example: str) -> None:
    """The printed commands get the printed feedback; the counter, which the manual leaves at 0, aside."""
    rows = json.loads(EXAMPLES.read_text(encoding="utf-8"))
    frames = {
        role: [
            Frame(int(row["id"], 16) | EXTENDED, bytes.fromhex(row["data"]))
            for row in rows
            if row["example"] == example and (row["role"] == "feedback") == (role == "feedback")
        ]
        for role in ("command", "feedback")
    }
    rig = ChassisRig()
    for frame in frames["command"]:
        rig.chassis.receive(frame, 0)
    sent = {frame.can_id: frame.data for frame in rig.run(1)}
    assert frames["feedback"]
    for frame in frames["feedback"]:
        assert sent[frame.can_id][:6] == frame.data[:6]


def test_it_keeps_obeying_when_commands_cease() -> None:
    """The last command holds for ever: nobody else will stop the robot."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    rig.run(120)
    assert rig.speed_mps == 1.0
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "auto"


def test_it_limits_itself() -> None:
    """It turns no further than 24 degrees and drives no faster than 8 km/h, whatever the frame says."""
    rig = ChassisRig()
    rig.command("drive", 40.0, 60.0)
    rig.run(5)
    assert rig.chassis.state.angle_deg == 24
    assert rig.speed_mps == pytest.approx(2.222, abs=0.001)


@pytest.mark.parametrize("gear", ["neutral", "park"])
def test_without_a_driving_gear_it_stands(gear: str) -> None:
    """Direction comes from the gear alone; park is reserved and counts as neutral."""
    rig = ChassisRig()
    rig.command(gear, 1.0)
    rig.run(1)
    assert rig.speed_mps == 0
    assert rig.seen["Auto_GearFeedBack"]["GearPosition"] == "neutral"


def test_parked_reads_park_and_does_not_move() -> None:
    """The electromagnetic brake wins, the gear feedback shows P, and releasing it lets it go."""
    rig = ChassisRig()
    rig.command("drive", 1.0, park=True)
    rig.run(1)
    assert rig.seen["Auto_GearFeedBack"]["GearPosition"] == "park"
    assert rig.seen["Auto_ParkingFeedBack"]["ParkingStatus"] == "applied"
    assert rig.speed_mps == 0
    rig.command("drive", 1.0)
    rig.run(1)
    assert rig.seen["Auto_GearFeedBack"]["GearPosition"] == "drive"
    assert rig.seen["Auto_ParkingFeedBack"]["ParkingStatus"] == "released"
    assert rig.speed_mps > 0.5


@pytest.mark.parametrize(
    ("pedal_percent", "status"), [(0.0, "released"), (30.0, "braking"), (99.6, "fully_braked")]
)
def test_the_brake_is_reported(pedal_percent: float, status: str) -> None:
    """Released, braking, fully braked, by the pedal."""
    rig = ChassisRig()
    rig.command("drive", 0.0, pedal_percent=pedal_percent)
    rig.run(0.1)
    assert rig.seen["Auto_BrakingFeedBack"]["BrakingStatus"] == status


def test_in_remote_the_hand_transmitter_drives() -> None:
    """Whatever CAN says; given back, the last command on CAN holds again."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    rig.run(2)
    rig.fault("transmitter remote")
    rig.fault("sticks -0.5 8")
    rig.run(3)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "remote"
    assert rig.seen["Auto_GearFeedBack"] | {"AliveCounter": 0, "Checksum": 0} == {
        "Active": False,
        "GearPosition": "reverse",
        "AliveCounter": 0,
        "Checksum": 0,
    }
    assert rig.speed_mps == pytest.approx(-0.5)
    assert rig.chassis.state.angle_deg == pytest.approx(8)
    rig.fault("transmitter command")
    rig.run(3)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "auto"
    assert rig.speed_mps == pytest.approx(1.0)


def test_sticks_let_go_stop_it() -> None:
    """A takeover with the sticks at rest brings it to a stand."""
    rig = ChassisRig()
    rig.command("drive", 2.0)
    rig.run(3)
    rig.fault("transmitter remote")
    rig.run(2)
    assert rig.speed_mps == 0


def test_a_bumper_does_not_stop_it() -> None:
    """A hit is reported and nothing more."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    rig.run(2)
    rig.fault("bumper front on")
    rig.run(2)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["FrontBumper"] is True
    assert rig.seen["Auto_MileageAndBodyFeedback"]["RearBumper"] is False
    assert rig.speed_mps == 1.0
    rig.fault("bumper front off")
    rig.fault("bumper rear on")
    rig.run(0.1)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["FrontBumper"] is False
    assert rig.seen["Auto_MileageAndBodyFeedback"]["RearBumper"] is True


def test_mileage_is_cleared_by_bit_16_with_enable() -> None:
    """Neither the flag nor the enable alone clears it; once cleared it counts from zero."""
    rig = ChassisRig()
    rig.run(0.1)
    start_km = rig.seen["Auto_MileageAndBodyFeedback"]["TotalMileage"]
    rig.send("Auto_OdometerCmd", Enable=False, ClearMileage=True)
    rig.run(0.1)
    rig.send("Auto_OdometerCmd", Enable=True, ClearMileage=False)
    rig.run(0.1)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["TotalMileage"] == start_km != 0
    rig.send("Auto_OdometerCmd", Enable=True, ClearMileage=True)
    rig.run(0.1)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["TotalMileage"] == 0
    rig.send("Auto_OdometerCmd")
    rig.command("drive", 1.0)
    rig.run(5)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["TotalMileage"] == pytest.approx(0.004)


def test_lamps_and_horn_are_the_upper_layers() -> None:
    """They follow their commands in any mode."""
    rig = ChassisRig()
    rig.send("Auto_LightCmd", Headlamp=True, LeftIndicator=True)
    rig.send("Auto_SpeakerCmd", Horn=True)
    rig.run(0.1)
    light = rig.seen["Auto_LightFeedback"]
    assert (light["Headlamp"], light["RightIndicator"], light["LeftIndicator"]) == (True, False, True)
    assert rig.seen["Auto_SpeakerFeedback"]["Horn"] is True


def test_a_bad_command_frame_is_ignored() -> None:
    """Wrong checksum, wrong length, remote and feedback frames change nothing, and are counted."""
    rig = ChassisRig()
    good = rig.encoder.encode("Auto_SpeakerCmd", {"Horn": True}, 0)
    for bad in (
        Frame(good.can_id, good.data[:7] + bytes([good.data[7] ^ 1])),
        Frame(good.can_id, good.data[:7]),
        Frame(good.can_id & ~EXTENDED, good.data),
        Frame(good.can_id | REMOTE, b"", remote_length=8),
        rig.encoder.encode("Auto_SpeakerFeedback", {"Horn": True}, 0),
    ):
        rig.chassis.receive(bad, rig.now_ns)
    rig.run(0.1)
    assert rig.seen["Auto_SpeakerFeedback"]["Horn"] is False
    assert rig.chassis.state.ignored_frames == 5


@given(script=st.lists(any_frames, max_size=30))
def test_no_frame_upsets_it(script: list[Frame]) -> None:
    """Whatever is on the bus, it goes on sending valid feedback."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    for frame in script:
        rig.chassis.receive(frame, rig.now_ns)
        assert all(isinstance(rig.decoder.decode(sent), Decoded) for sent in rig.run(0.02))


def test_the_true_state_is_at_hand() -> None:
    """Tests and demonstrations can see the pose, and what no frame says."""
    rig = ChassisRig(Variant.FINE)
    rig.command("drive", 1.0, pedal_percent=0.0)
    rig.run(5)
    state = rig.chassis.state
    assert (state.mode, state.variant, state.gear_position) == (Mode.AUTO, Variant.FINE, GearPosition.DRIVE)
    assert (state.braking_status, state.parking_status) == (BrakingStatus.RELEASED, ParkingStatus.RELEASED)
    assert 4 < state.x_m < 5
    assert state.y_m == pytest.approx(0, abs=0.01)
    assert state.mileage_m == pytest.approx(12_345 + state.x_m)


@VARIANTS
def test_the_wrong_scale_shows_in_drive_and_not_in_the_wheels(variant: Variant) -> None:
    """Drive command and feedback have the other variant's scale; the wheels tell the truth."""
    rig = ChassisRig(variant)
    rig.command("drive", 1.0)
    rig.run(3)
    rig.fault("scale wrong")
    rig.run(3)
    other = FrameDecoder(load(Variant.FINE if variant is Variant.COARSE else Variant.COARSE))
    drive = other.decode(rig.named("Auto_DriveFeedBack", rig.run(0.05))[-1])
    assert isinstance(drive, Decoded)
    assert drive.signals["Speed"] == pytest.approx(abs(rig.speed_mps), abs=0.04)
    assert rig.seen["Auto_WheelSpdFeedback"]["RearLeftSpeed"] == pytest.approx(rig.speed_mps, abs=0.04)
    assert rig.speed_mps == pytest.approx(0.025 if variant is Variant.COARSE else 2.222, abs=0.001)
    rig.fault("scale right")
    rig.run(3)
    assert rig.seen["Auto_DriveFeedBack"]["Speed"] == pytest.approx(1.0)


def test_the_firmware_can_change() -> None:
    """A standing chassis of the other variant shows raw 32768 where the coarse one showed 200."""
    rig = ChassisRig()
    assert rig.named("Auto_WheelSpdFeedback", rig.run(0.1))[-1].data[1:5] == bytes.fromhex("c800c800")
    rig.fault("variant fine for 1s")
    assert rig.named("Auto_WheelSpdFeedback", rig.run(0.1))[-1].data[1:5] == bytes.fromhex("00800080")
    rig.run(1)
    assert rig.chassis.state.variant is Variant.COARSE


@pytest.mark.parametrize("slope_deg", [-20.0, 0.0, 20.0])
@pytest.mark.parametrize(
    ("stop_mode", "gear"), [(StopMode.BRAKES, GearPosition.DRIVE), (StopMode.PARKS, GearPosition.PARK)]
)
def test_mode_stop_brakes_or_parks(stop_mode: StopMode, gear: GearPosition, slope_deg: float) -> None:
    """By the motor or by the parking brake the robot comes to a stand, and is held."""
    rig = in_mode_stop(stop_mode, slope_deg)
    begin_m = rig.chassis.state.x_m
    rig.run(2)
    state = rig.chassis.state
    assert (state.mode, state.speed_mps, state.gear_position) == (Mode.STOP, 0, gear)
    assert 0.05 < state.x_m - begin_m < 0.5
    rig.run(10)
    assert rig.chassis.state.x_m == state.x_m


@pytest.mark.parametrize(
    ("slope_deg", "speed_mps"),
    [
        pytest.param(-20.0, 1.0 + 2 * (3.355 - 0.3), id="faster and faster"),
        pytest.param(0.0, 1.0 - 2 * 0.3, id="slower"),
        pytest.param(20.0, -(2 - 1.0 / (3.355 + 0.3)) * (3.355 - 0.3), id="back down"),
    ],
)
def test_mode_stop_may_coast(slope_deg: float, speed_mps: float) -> None:
    """In neutral, by gravity and rolling resistance alone."""
    rig = in_mode_stop(StopMode.COASTS, slope_deg)
    rig.run(2)
    assert rig.chassis.state.gear_position is GearPosition.NEUTRAL
    assert rig.speed_mps == pytest.approx(speed_mps, abs=0.01)


def in_mode_stop(stop_mode: StopMode, slope_deg: float) -> ChassisRig:
    """A robot that loses an enable at 1 m/s."""
    rig = ChassisRig(conditions=Conditions(slope_deg=slope_deg, stop_mode=stop_mode))
    rig.command("drive", 1.0)
    rig.run(2)
    rig.send("Auto_GearCmd", Enable=False)
    return rig


def test_mode_stop_keeps_the_parking_brake() -> None:
    """A request of just before goes on to take effect, however the chassis stops."""
    rig = ChassisRig(conditions=Conditions(stop_mode=StopMode.COASTS))
    rig.command("drive", 1.0)
    rig.run(2)
    rig.command("drive", 1.0, park=True)
    rig.run(0.01)
    rig.send("Auto_GearCmd", Enable=False)
    rig.run(0.1)
    assert rig.chassis.state.parking_status is ParkingStatus.APPLIED
    rig.run(1)
    assert rig.speed_mps == 0


def test_the_parking_feedback_says_when_it_is_so() -> None:
    """Asked for, the brake applies and releases 50 ms later, and so do its status and the gear's P."""
    rig = ChassisRig()
    for park, status, gear in ((False, "released", "drive"), (True, "applied", "park")):
        before = "applied" if status == "released" else "released"
        rig.run(0.2)
        rig.command("drive", 0.0, park=park)
        rig.run(0.04)
        assert rig.seen["Auto_ParkingFeedBack"]["ParkingStatus"] == before
        rig.run(0.01)
        assert rig.seen["Auto_ParkingFeedBack"]["ParkingStatus"] == status
        assert rig.seen["Auto_GearFeedBack"]["GearPosition"] == gear


def test_the_ground_may_change_while_it_drives() -> None:
    """Slope, payload and strengths by fault; without them it is as it was at the start."""
    rig = ChassisRig(conditions=Conditions(slope_deg=3.0))
    rig.command("neutral")
    rig.fault("slope 0 for 1995ms")
    rig.run(1.99)
    assert rig.speed_mps == 0
    rig.run(1)
    assert rig.speed_mps == pytest.approx(0.3 - 9.81 * math.sin(math.radians(3)), abs=0.01)
    rig.command("drive")
    rig.run(2)
    for weaker in ("payload 100", "motor 0.5"):
        rig.fault("slope 20")
        rig.run(1)
        assert rig.speed_mps == 0
        rig.fault(weaker)
        rig.run(1)
        assert rig.speed_mps < 0
        rig.fault("clear")
        rig.run(3)
        assert rig.speed_mps == 0
    rig.fault("slope 10")
    rig.fault("pedal 1")
    rig.command("neutral", pedal_percent=60.0)
    rig.run(1)
    assert rig.speed_mps == 0
    rig.fault("pedal 0.3")
    rig.run(1)
    assert rig.speed_mps < -0.5


@VARIANTS
def test_it_may_roll_faster_than_its_frames_can_say(variant: Variant) -> None:
    """They show the most they have room for."""
    rig = ChassisRig(variant, conditions=Conditions(slope_deg=30.0))
    rig.command("neutral")
    rig.run(30)
    layout = load(variant)
    assert rig.speed_mps < -100
    wheels = layout.messages["Auto_WheelSpdFeedback"].signal("RearLeftSpeed")
    rig.fault("scale wrong")
    frames = rig.run(2)
    assert len(frames) == 1260
    shown = [int.from_bytes(frame.data[1:3], "little") for frame in rig.named("Auto_WheelSpdFeedback", frames)]
    assert {raw & (2**wheels.length - 1) for raw in shown} == {0}


def test_sticks_at_rest_hold_it_on_a_slope() -> None:
    """Also where the takeover finds it in neutral: it rolls no further than the next instant."""
    rig = ChassisRig(conditions=Conditions(slope_deg=20.0))
    rig.fault("transmitter remote")
    rig.run(5)
    assert rig.speed_mps == 0
    assert abs(rig.chassis.state.x_m) < 0.005


def test_a_reboot_forgets_everything() -> None:
    """Two seconds without feedback and drive; then mode stop, and counters from 0."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    rig.send("Auto_SpeakerCmd", Horn=True)
    rig.run(2.005)
    rig.fault("reboot")
    assert rig.run(2) == []
    assert rig.speed_mps == pytest.approx(1.0 - 0.3 * 2, abs=0.01)
    frames = rig.run(0.1)
    assert rig.counters("Auto_GearFeedBack", frames) == list(range(10))
    assert rig.chassis.state.mode is Mode.STOP
    rig.run(1)
    assert rig.speed_mps == 0
    assert rig.seen["Auto_SpeakerFeedback"]["Horn"] is False


@pytest.mark.parametrize("missing", ENABLES)
def test_after_a_reboot_all_five_enables_must_come_again(missing: str) -> None:
    """Those from before, and those that came meanwhile, count for nothing."""
    rig = ChassisRig()
    rig.command("drive", 1.0)
    rig.run(2)
    rig.fault("reboot for 500ms")
    rig.run(0.2)
    rig.command("drive", 1.0)
    rig.run(1)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "stop"
    rig.command("drive", 1.0)
    rig.chassis._commands.pop(missing)
    rig.run(0.1)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "stop"
    rig.command("drive", 1.0)
    rig.run(0.1)
    assert rig.seen["Auto_MileageAndBodyFeedback"]["Mode"] == "auto"


def test_a_reboot_leaves_the_parking_brake_as_it_is() -> None:
    """Applied it stays applied, and released it lets the robot roll."""
    for park in (True, False):
        rig = ChassisRig(conditions=Conditions(slope_deg=10.0))
        rig.command("drive", park=park)
        rig.run(1)
        rig.fault("reboot for 1s")
        rig.run(0.9)
        assert (rig.speed_mps == 0) is park

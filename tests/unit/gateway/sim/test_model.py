"""Motion and behaviour of the chassis, by the protocol notes."""

import json
import math
from collections import Counter
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import EXTENDED, REMOTE, Frame
from gateway.chassis.layout import Decoded, FrameDecoder
from gateway.choice.chassis import CHASSIS
from gateway.sim.body import (
    ACCELERATION_MPS2,
    BRAKING_DECELERATION_MPS2,
    DECELERATION_MPS2,
    PARKING_DECELERATION_MPS2,
    STEERING_RATE_DEGPS,
    TOP_SPEED_MPS,
    Conditions,
    Demand,
    Motion,
    StopMode,
)
from schemas.messages import GearPosition, Mode, Variant
from tests.support import SUPPORT
from tests.support.rigs.chassis import ENABLES, MS, ChassisRig, S

EXAMPLES = SUPPORT / "manual_examples.json"
VARIANTS = pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])


@VARIANTS
def test_a_second_has_630_valid_frames(variant: Variant) -> None:
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
    whole, sliced = ChassisRig(), ChassisRig()
    for rig in (whole, sliced):
        rig.command("drive", 1.0, 10.0)
        rig.fault("drop all every 3 for 20 frames")
        rig.fault("foreign 200 every 70ms")
    frames = [frame for cut in sorted(cuts) for frame in sliced.chassis.advance(cut)]
    frames += sliced.chassis.advance(300 * MS)
    assert frames == whole.chassis.advance(300 * MS)


def test_the_rate_can_be_raised_to_a_saturated_bus() -> None:
    nominal, fast = ChassisRig(), ChassisRig(rate_multiplier=11.905)
    for rig in (nominal, fast):
        rig.command("drive", 1.0)
    assert len(nominal.run(2)) == 1260
    assert len(fast.run(2)) == pytest.approx(15_000, abs=5)
    assert fast.speed_mps == pytest.approx(nominal.speed_mps, abs=0.01)


# Scripts, a step a line: what is done (a drive command, a frame, a fault), for how long, what is shown then.

SHOWN = {
    "mode": ("Auto_MileageAndBodyFeedback", "Mode"),
    "front": ("Auto_MileageAndBodyFeedback", "FrontBumper"),
    "rear": ("Auto_MileageAndBodyFeedback", "RearBumper"),
    "km": ("Auto_MileageAndBodyFeedback", "TotalMileage"),
    "gear": ("Auto_GearFeedBack", "GearPosition"),
    "active": ("Auto_GearFeedBack", "Active"),
    "parking": ("Auto_ParkingFeedBack", "ParkingStatus"),
    "brake": ("Auto_BrakingFeedBack", "BrakingStatus"),
    "wheel": ("Auto_WheelSpdFeedback", "RearLeftSpeed"),
    "headlamp": ("Auto_LightFeedback", "Headlamp"),
    "right": ("Auto_LightFeedback", "RightIndicator"),
    "left": ("Auto_LightFeedback", "LeftIndicator"),
    "horn": ("Auto_SpeakerFeedback", "Horn"),
}
DRIVES = "drive 1 | 2 | mode=auto speed_mps=1.0"
SCRIPTS: dict[str, list[str]] = {
    "at power-up it stands, parked and in mode stop": [
        " | 0.1 | mode=stop gear=park parking=applied wheel=0.0 active=False"
    ],
    **{
        f"without the enable of {missing} it is in mode stop, and stops": [
            DRIVES,
            f"{missing} Enable=0 | 2 | mode=stop speed_mps=0.0",
        ]
        for missing in ENABLES
    },
    "the last command holds for ever": ["drive 1 | 120 | mode=auto speed_mps=1.0"],
    "it limits angle and speed to 24 deg and 8 km/h": ["drive 40 60 | 5 | angle_deg=24.0 speed_mps=2.221..2.223"],
    "in neutral it stands": ["neutral 1 | 1 | speed_mps=0.0 gear=neutral"],
    "park is reserved and counts as neutral": ["park 1 | 1 | speed_mps=0.0 gear=neutral"],
    "the parking brake wins, and lets it go": [
        "drive 1 0 1 | 1 | gear=park parking=applied speed_mps=0.0",
        "drive 1 | 1 | gear=drive parking=released speed_mps=0.5..1",
    ],
    **{
        f"a pedal at {percent} % is {status}": [f"drive 0 0 0 {percent} | 0.1 | brake={status}"]
        for percent, status in ((0.0, "released"), (30.0, "braking"), (99.6, "fully_braked"))
    },
    "in remote the sticks drive; given back, the last command on CAN holds again": [
        DRIVES,
        "transmitter remote | 0",
        "sticks -0.5 8 | 3 | mode=remote active=False gear=reverse speed_mps=-0.5..-0.499 angle_deg=7.999..8.001",
        "transmitter command | 3 | mode=auto speed_mps=1.0",
    ],
    "a takeover with the sticks at rest stops it": [
        "drive 2 | 3 | speed_mps=2.0",
        "transmitter remote | 2 | speed_mps=0.0",
    ],
    "sticks at rest hold it on a slope, also where it was in neutral": [
        "slope 20 | 0",
        "transmitter remote | 5 | speed_mps=0.0 x_m=-0.005..0.005",
    ],
    "a hit is shown, and does not stop it": [
        DRIVES,
        "bumper front on | 2 | front=True rear=False speed_mps=1.0",
        "bumper front off | 0",
        "bumper rear on | 0.1 | front=False rear=True",
    ],
    "mileage is cleared by bit 16 with the enable, by neither alone, and counts from zero": [
        " | 0.1 | km=12.345",
        "Auto_OdometerCmd Enable=0 ClearMileage=1 | 0.1 | km=12.345",
        "Auto_OdometerCmd Enable=1 ClearMileage=0 | 0.1 | km=12.345",
        "Auto_OdometerCmd Enable=1 ClearMileage=1 | 0.1 | km=0.0",
        "Auto_OdometerCmd | 0",
        "drive 1 | 5 | km=0.004",
    ],
    "lamps and horn follow in any mode": [
        "Auto_LightCmd Headlamp=1 LeftIndicator=1 | 0",
        "Auto_SpeakerCmd Horn=1 | 0.1 | mode=stop headlamp=True right=False left=True horn=True",
    ],
    "a request to park of just before a mode stop that coasts takes effect": [
        DRIVES,
        "drive 1 0 1 | 0.01",
        "Auto_GearCmd Enable=0 | 0.1 | parking_status=ParkingStatus.APPLIED",
        " | 1 | speed_mps=0.0",
    ],
    "the parking brake applies and releases 50 ms later, and so do its status and the gear's P": [
        " | 0.2",
        "drive | 0.04 | parking=applied",
        " | 0.01 | parking=released gear=drive",
        " | 0.2",
        "drive 0 0 1 | 0.04 | parking=released",
        " | 0.01 | parking=applied gear=park",
    ],
    **{
        f"with {weaker} it rolls on 20 deg, and without it the motor holds": [
            "drive | 2",
            "slope 20 | 1 | speed_mps=0.0",
            f"{weaker} | 1 | speed_mps=-9..-0.001",
            "clear | 3 | speed_mps=0.0",
        ]
        for weaker in ("payload 100", "motor 0.5")
    },
    # 20 deg empty and 15 deg with full payload (manual V2.0, 2.2); 20 deg with full payload is too much.
    "it climbs 20 deg empty": ["slope 20 | 0", "drive 0.5 | 20 | speed_mps=0.47..0.5"],
    "it climbs 15 deg with full payload": [
        "slope 15 | 0",
        "payload 100 | 0",
        "drive 0.5 | 20 | speed_mps=0.47..0.5",
    ],
    "it does not climb 20 deg with full payload": [
        "slope 20 | 0",
        "payload 100 | 0",
        "drive 0.5 | 5 | speed_mps=-9..-0.001",
    ],
    "another firmware for a while": [
        "variant fine for 1s | 0.1 | variant=Variant.FINE",
        " | 1 | variant=Variant.COARSE",
    ],
    "the pedal holds by its gain": [
        "slope 10 | 0",
        "pedal 1 | 0",
        "neutral 0 0 0 60 | 1 | speed_mps=0.0",
        "pedal 0.3 | 1 | speed_mps=-9..-0.5",
    ],
    **{
        f"after a reboot all five enables must come again, also {missing}": [
            DRIVES,
            "reboot for 500ms | 0.2",
            "drive 1 | 1 | mode=stop",
            "drive 1 | 0",
            f"without {missing} | 0.1 | mode=stop",
            "drive 1 | 0.1 | mode=auto",
        ]
        for missing in ENABLES
    },
    **{
        f"mode stop, {stop_mode}, on {slope_deg} deg": [
            f"slope {slope_deg} | 0",
            "drive 1 | 2",
            f"Auto_GearCmd Enable=0 | 2 | {shows}",
        ]
        for stop_mode, slope_deg, shows in (
            *(("brakes", slope_deg, "mode=stop gear=drive speed_mps=0.0") for slope_deg in (-20, 0, 20)),
            *(("parks", slope_deg, "mode=stop gear=park speed_mps=0.0") for slope_deg in (-20, 0, 20)),
            # In neutral, by gravity and rolling resistance alone.
            ("coasts", -20, "gear=neutral speed_mps=7.10..7.12"),
            ("coasts", 0, "gear=neutral speed_mps=0.39..0.41"),
            ("coasts", 20, "gear=neutral speed_mps=-5.29..-5.26"),
        )
    },
    "a reboot leaves the parking brake applied": [
        "slope 10 | 0",
        "drive 0 0 1 | 1",
        "reboot | 0.9 | speed_mps=0.0",
    ],
    "a reboot leaves the parking brake released": [
        "slope 10 | 0",
        "drive | 1",
        "reboot | 0.9 | speed_mps=-9..-0.1",
    ],
}


def act(rig: ChassisRig, text: str) -> None:
    name, *words = text.split() or [""]
    if name in {"drive", "neutral", "park"}:
        speed_mps, angle_deg, park, pedal_percent = [*map(float, words), 0.0, 0.0, 0.0, 0.0][:4]
        rig.command(name, speed_mps, angle_deg, park=bool(park), pedal_percent=pedal_percent)
    elif name.startswith("Auto_"):
        rig.send(name, **{word.partition("=")[0]: word.endswith("=1") for word in words})
    elif name == "without":
        rig.chassis._commands.pop(words[0])
    elif name:
        rig.fault(text)


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_shows(name: str) -> None:
    """A value as text, to three places, or a range."""
    stop_mode = next((mode for mode in StopMode if mode.value in name), StopMode.BRAKES)
    rig = ChassisRig(conditions=Conditions(stop_mode=stop_mode))
    for step in SCRIPTS[name]:
        action, seconds, *rulings = step.split(" | ")
        act(rig, action.strip())
        rig.run(float(seconds))
        for one, expected in (ruling.split("=") for ruling in " ".join(rulings).split()):
            found: Any = (
                rig.seen[SHOWN[one][0]][SHOWN[one][1]] if one in SHOWN else getattr(rig.chassis.state, one)
            )
            low, is_between, high = expected.partition("..")
            if is_between:
                assert float(low) <= found <= float(high), (step, one)
            elif expected[-1].isdigit():
                assert found == pytest.approx(float(expected), abs=1e-6), (step, one)
            else:
                assert str(found) == expected, (step, one)


@pytest.mark.parametrize("example", ["gear D", "steering +24 deg", "parking apply"])
def test_it_answers_the_manuals_examples_as_the_manual_does(example: str) -> None:
    """Except for the counter, which the manual leaves at 0."""
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


def test_a_bad_command_frame_is_ignored() -> None:
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


@VARIANTS
def test_the_wrong_scale_shows_in_drive_and_not_in_the_wheels(variant: Variant) -> None:
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


def test_a_reboot_forgets_everything() -> None:
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


DT_S = 0.01
FORWARD, BACKWARD, PARKED = (
    Demand(gear, speed_mps, 0.0, 0.0, parked=gear is GearPosition.NEUTRAL)
    for gear, speed_mps in ((GearPosition.DRIVE, 2.0), (GearPosition.REVERSE, 2.0), (GearPosition.NEUTRAL, 0.0))
)
DEMANDS = st.builds(
    Demand,
    gear=st.sampled_from([GearPosition.DRIVE, GearPosition.REVERSE, GearPosition.NEUTRAL]),
    speed_mps=st.floats(0, 100),
    angle_deg=st.none() | st.floats(-90, 90),
    pedal_percent=st.sampled_from([0.0, 0.0, 0.0, 30.0, 100.0]),
    parked=st.sampled_from([False, False, False, True]),
)


@given(st.lists(st.tuples(DEMANDS, st.integers(1, 40)), max_size=30), st.sampled_from([0.0, 0.3, 1.0]))
def test_no_demand_makes_it_jump(script: list[tuple[Demand, int]], pedal_gain: float) -> None:
    motion = Motion(CHASSIS.wheelbase_m, Conditions(pedal_gain=pedal_gain))
    most_mps2 = max(
        ACCELERATION_MPS2, DECELERATION_MPS2, BRAKING_DECELERATION_MPS2 + 0.3, PARKING_DECELERATION_MPS2
    )
    for what, steps in script:
        for _ in range(steps):
            speed_mps, angle_deg, gear = motion.speed_mps, motion.angle_deg, motion.gear
            motion.step(what, DT_S)
            assert abs(motion.speed_mps) <= TOP_SPEED_MPS
            assert abs(motion.angle_deg) <= 24
            assert abs(motion.speed_mps - speed_mps) <= most_mps2 * DT_S + 1e-9
            assert abs(motion.angle_deg - angle_deg) <= STEERING_RATE_DEGPS * DT_S + 1e-9
            assert -math.pi <= motion.yaw_rad <= math.pi
            if motion.gear is not gear and motion.gear is not GearPosition.NEUTRAL:
                direction = 1 if motion.gear is GearPosition.DRIVE else -1
                assert speed_mps * direction > -0.011, "the gear of the other direction engaged at speed"


def test_pulses_wrap_as_signed_16_bit() -> None:
    motion = Motion(CHASSIS.wheelbase_m)
    forward = []
    for _ in range(3000):
        motion.step(FORWARD, DT_S)
        forward.append(motion.wheel_pulses[0])
    steps = [after - before for before, after in pairwise(forward)]
    assert any(step < -65000 for step in steps)
    assert all(step >= 0 or step < -65000 for step in steps)
    while motion.x_m > 0:
        motion.step(BACKWARD, DT_S)
    assert abs(motion.wheel_pulses[0]) < 40


@pytest.mark.parametrize("slope_deg", [-20, 0, 20])
def test_the_parking_brake_stops_a_rolling_robot(slope_deg: float) -> None:
    """Within v^2 / 2a, where a is the grip corrected by gravity."""
    motion = Motion(CHASSIS.wheelbase_m, Conditions(slope_deg=slope_deg, parking_delay_s=0.0))
    motion.adopt(speed_mps=2.0, angle_deg=0.0, gear=GearPosition.NEUTRAL, parked=False)
    for _ in range(300):
        motion.step(PARKED, DT_S)
    grip_mps2 = PARKING_DECELERATION_MPS2 + 9.81 * math.sin(math.radians(slope_deg))
    assert motion.speed_mps == 0
    assert motion.x_m == pytest.approx(2.0**2 / (2 * grip_mps2), abs=2.0 * DT_S)
    rest_m = motion.x_m
    for _ in range(6000):
        motion.step(PARKED, DT_S)
    assert motion.x_m == rest_m

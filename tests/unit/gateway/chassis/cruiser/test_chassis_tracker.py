"""The chassis as the arbiter sees it."""

from collections import Counter
from collections.abc import Iterable, Mapping

import msgspec
import pytest

from gateway.chassis.cruiser.frames import (
    BODY,
    DRIVE,
    WHEEL_SPEED,
    StandstillEvidence,
    load,
)
from gateway.chassis.cruiser.tracker import ChassisTracker
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Value
from gateway.chassis.port import ChassisState
from gateway.chassis.supervision import VariantDetector, silence_ns
from gateway.choice.chassis import CHASSIS
from gateway.core import Core, as_linked
from gateway.telemetry.feedback import FeedbackStream
from gateway.telemetry.health import Links
from schemas.messages import ControllerState, GearPosition, Mode, ParkingStatus, Variant
from schemas.settings import (
    CHECKSUM_FAULTS,
    PULSES_MOVING_FRAMES,
    ChassisSettings,
    Settings,
)
from tests.support.frames import CHALLENGE, MS, STANDING, Feedback
from tests.support.rigs.arbiter import STANDING as OBEDIENT

UP = Links(bus_up=True, bus_losses=2, guarded=True)
PULSES = "Auto_WheelPulseFeedback"
FRAMES = PULSES_MOVING_FRAMES
REQUIRED = ChassisSettings().required_feedback
RESERVED = sorted(set(STANDING) - set(REQUIRED))
PATIENCE_MS = {
    name: silence_ns(load(Variant.COARSE).messages[name].period_ns) // MS for name in (WHEEL_SPEED, BODY)
}


class Eye:
    """A tracker with its streams and detector, and frames to show them."""

    def __init__(self, variant: Variant = Variant.COARSE, required: Iterable[str] = REQUIRED) -> None:
        faults: Counter[object] = Counter()
        self.streams = {
            layout.name: FeedbackStream(CHASSIS.decoder(layout), faults)  # type: ignore[arg-type]
            for layout in load(variant).feedback
        }
        self.detector = VariantDetector(variant, StandstillEvidence())
        self.tracker = ChassisTracker(self.streams.values(), self.detector, required)
        self.feedback = Feedback(variant)
        self.links = UP
        self.controller = ControllerState.ACTIVE
        self.variant = variant
        self.commander_ns: int | None = None

    def show(self, name: str, values: Mapping[str, Value] | None = None, at_ms: int = 0) -> None:
        """A frame comes; what is not named is as of a standing chassis."""
        self.streams[name].receive(self.feedback.frame(name, values), at_ms * MS)

    def show_all(self, at_ms: int = 0, but: tuple[str, ...] = ()) -> None:
        """One frame of each name comes, but for these."""
        for name in STANDING:
            if name not in but:
                self.show(name, at_ms=at_ms)

    def look(self, at_ms: int = 0) -> ChassisState:
        for stream in self.streams.values():
            stream.tick(at_ms * MS)
        return as_linked(
            self.tracker.state(self.controller, self.variant, self.commander_ns, at_ms * MS), self.links
        )


STANDS = msgspec.structs.replace(
    OBEDIENT,
    bus_losses=2,
    controller=ControllerState.ACTIVE,
    confirmed=ChassisState().confirmed,
    realtime=ChassisState().realtime,
    total_mileage_km=1.5,
)


WHEELS = {"wheel_speed_mps": -1.5, "fastest_wheel_mps": 2.0}
"""Direction by the mean; standing only if the faster one does: wheels that turn against each other move."""


NOT_VALID_BODY = {"rear_bumper": None, "total_mileage_km": None}


def rounded(chassis: ChassisState) -> dict[str, object]:
    """Its fields, with numbers as coarse as the wire."""
    fields = msgspec.structs.asdict(chassis)
    return {name: round(value, 1) if isinstance(value, float) else value for name, value in fields.items()}


@pytest.mark.parametrize(
    ("frame", "values", "changed"),
    [
        (DRIVE, {}, {}),
        ("Auto_GearFeedBack", {"GearPosition": "reverse"}, {"gear": GearPosition.REVERSE}),
        ("Auto_SteeringFeedBack", {"Angle": -12.0}, {"angle_deg": -12.0}),
        (DRIVE, {"Speed": 1.2}, {"speed_mps": 1.2, "turns": True}),
        (WHEEL_SPEED, {"RearLeftSpeed": -1.0, "RearRightSpeed": -2.0}, WHEELS),
        (BODY, {"Mode": "auto"}, {"mode": Mode.AUTO}),
        (BODY, {"Mode": "remote"}, {"mode": Mode.REMOTE}),
        (BODY, {"FrontBumper": True}, {"front_bumper": True}),
        (BODY, {"RearBumper": True}, {"rear_bumper": True}),
        (BODY, {"TotalMileage": 7.0}, {"total_mileage_km": 7.0}),
        ("Auto_BrakingFeedBack", {"BrakingStatus": "braking"}, {}),
        ("Auto_ParkingFeedBack", {"ParkingStatus": "released"}, {"brake": ParkingStatus.RELEASED}),
        ("Auto_WheelPulseFeedback", {"RearLeftPulses": 7}, {}),
        ("Auto_LightFeedback", {"Headlamp": True}, {}),
        ("Auto_SpeakerFeedback", {"Horn": True}, {}),
        # What is not valid is not believed, be it that the robot stands; but for a bumper that was hit.
        (WHEEL_SPEED, {"Valid": False}, {"wheel_speed_mps": None, "fastest_wheel_mps": None}),
        (BODY, {"Valid": False, "FrontBumper": True}, {"front_bumper": True, **NOT_VALID_BODY}),
    ],
)
def test_each_frame_changes_what_it_tells_and_nothing_else(
    frame: str, values: dict[str, Value], changed: dict[str, object]
) -> None:
    """Each field has one source."""
    eye = Eye()
    eye.show_all()
    eye.show(frame, values)
    assert rounded(eye.look()) == rounded(STANDS) | changed


@pytest.mark.parametrize(
    ("name", "required"), [*((name, True) for name in STANDING), *((name, False) for name in RESERVED)]
)
def test_what_is_missed_is_a_setting(name: str, *, required: bool) -> None:
    """Row 'engage: every feedback that chassis.required_feedback names': silence, checksums and values of it."""
    eye = Eye(required=dict.fromkeys([*REQUIRED, name]) if required else REQUIRED)
    eye.show_all(but=(name,))
    assert (eye.look().missing == (name,)) is required
    for number in range(CHECKSUM_FAULTS):
        good = eye.feedback.frame(name)
        eye.streams[name].receive(Frame(good.can_id, good.data[:7] + bytes([good.data[7] ^ 1])), number * MS)
    assert (eye.look(CHECKSUM_FAULTS).faulty == (name,)) is required


@pytest.mark.parametrize("name", REQUIRED)
def test_a_frame_that_falls_silent_is_missing(name: str) -> None:
    """After its ten periods, not before; its values are unknown then."""
    eye = Eye()
    eye.show_all()
    after_ms = silence_ns(load(Variant.COARSE).messages[name].period_ns) // MS
    for at_ms in range(10, after_ms + 1, 10):
        eye.show_all(at_ms, but=(name,))
        assert eye.look(at_ms).missing == ()
    seen = eye.look(after_ms + 1)
    assert seen.missing == (name,)
    unknown = {
        "Auto_GearFeedBack": seen.gear is GearPosition.UNDEFINED,
        "Auto_SteeringFeedBack": seen.angle_deg is None,
        # The wheels tell in its place that nothing turns.
        DRIVE: seen.speed_mps is None and seen.turns is False,
        WHEEL_SPEED: seen.wheel_speed_mps is None,
        "Auto_ParkingFeedBack": seen.brake is ParkingStatus.UNDEFINED,
        BODY: (seen.mode, seen.front_bumper, seen.rear_bumper) == (Mode.UNDEFINED, None, None),
    }
    assert unknown.get(name, True)


@pytest.mark.parametrize(
    ("wheels", "turns"),
    [
        ({}, False),
        ({"RearLeftSpeed": 0.2, "RearRightSpeed": 0.2}, True),
        ({"RearLeftSpeed": -0.2, "RearRightSpeed": 0.2}, True),
        ({"Valid": False}, None),
        (None, None),
    ],
)
@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
def test_without_drive_feedback_the_wheels_tell_that_something_turns(
    variant: Variant, wheels: dict[str, Value] | None, *, turns: bool | None
) -> None:
    """In an unknown scale; invalid or missing wheel speeds prove nothing."""
    eye = Eye(variant)
    for stream in eye.streams.values():
        stream.withhold()
    eye.show_all(but=(DRIVE, WHEEL_SPEED))
    if wheels is not None:
        eye.show(WHEEL_SPEED, wheels)
    assert eye.look().turns is turns


@pytest.mark.parametrize("name", [WHEEL_SPEED, BODY])
def test_a_frame_that_says_that_it_is_not_valid_is_waited_for_and_then_missing(name: str) -> None:
    """As long as a missing one: a single one is no cause to stop."""
    eye = Eye()
    eye.show_all()
    eye.look()
    for at_ms in range(10, PATIENCE_MS[name] + 1, 10):
        eye.show_all(at_ms, but=(name,))
        eye.show(name, {"Valid": False}, at_ms)
        assert eye.look(at_ms).missing == ()
    late_ms = PATIENCE_MS[name] + 10
    eye.show_all(late_ms, but=(name,))
    eye.show(name, {"Valid": False}, late_ms)
    assert eye.look(late_ms).missing == (name,)
    eye.show(name, at_ms=late_ms)
    assert eye.look(late_ms).missing == ()
    # A frame that was never valid is missing at once.
    fresh = Eye()
    fresh.show_all(5000, but=(name,))
    fresh.show(name, {"Valid": False}, 5000)
    assert fresh.look(5000).missing == (name,)


def wrapped(pulses: int) -> int:
    return (pulses + 0x8000) % 0x1_0000 - 0x8000


def slower(frame: int) -> int:
    """Pulses of a robot that loses an eighth of its speed with each frame."""
    return round(1_000 * (1 - 0.875**frame))


def counted(*pulses: tuple[int, int], valid: bool = True) -> int:
    """The direction that is seen after these counts of the left and the right wheel, a frame each."""
    eye = Eye()
    eye.show_all()
    seen = eye.look()
    for number, (left, right) in enumerate(pulses):
        eye.show(PULSES, {"RearLeftPulses": left, "RearRightPulses": right, "Valid": valid}, 50 * number)
        seen = eye.look(50 * number)
    return seen.pulses


@pytest.mark.parametrize(
    ("pulses", "direction"),
    [
        ([(0, 0)] * 20, 0),
        ([(number, number) for number in range(FRAMES)], 0),
        ([(number, number) for number in range(FRAMES + 1)], 1),
        ([(-number, -number) for number in range(FRAMES + 1)], -1),
        ([(number, 0) for number in range(FRAMES + 1)], 1),
        ([(5 * number, -5 * number) for number in range(FRAMES + 1)], 0),
        ([(1, 1), (0, 0)] * FRAMES, 0),
        ([(number, number) for number in (0, 1, *range(1, FRAMES))], 0),
        ([(wrapped(8_000 * number), wrapped(8_000 * number)) for number in range(FRAMES + 1)], 1),
        ([(wrapped(-8_000 * number), wrapped(-8_000 * number)) for number in range(FRAMES + 1)], -1),
        ([(slower(number), slower(number)) for number in range(FRAMES + 1)], 0),
    ],
)
def test_pulses_tell_a_direction_when_many_frames_in_a_row_count_that_way_and_no_slower(
    pulses: list[tuple[int, int]], direction: int
) -> None:
    """Row 'rolling: wheels or pulses': both wheels, across the wrap; noise and the end of a ramp are none."""
    assert counted(*pulses) == direction


def test_lost_frames_do_not_make_a_robot_that_slows_down_look_steady() -> None:
    """Counts across a lost frame took two periods, by the alive counter."""
    eye = Eye()
    eye.show_all()
    seen = []
    for number in range(2 * FRAMES):
        pulses = 125 * min(number, FRAMES) + slower(max(0, number - FRAMES))
        frame = eye.feedback.frame(PULSES, {"RearLeftPulses": pulses, "RearRightPulses": pulses})
        if number not in {FRAMES + 3, FRAMES + 5}:
            eye.streams[PULSES].receive(frame, 50 * number * MS)
        seen.append(eye.look(50 * number).pulses)
    assert seen[FRAMES] == 1
    assert seen[FRAMES + 6 :] == [0] * (FRAMES - 6)


def test_pulses_that_are_not_valid_or_not_there_tell_no_direction() -> None:
    moving = [(number, number) for number in range(2 * FRAMES)]
    assert counted(*moving, valid=False) == 0
    eye = Eye()
    eye.show_all()
    for number in range(FRAMES + 1):
        eye.show(PULSES, {"RearLeftPulses": number, "RearRightPulses": number}, 50 * number)
        eye.look(50 * number)
    assert eye.look(50 * FRAMES).pulses == 1
    assert eye.look(50 * FRAMES + 1_100).pulses == 0
    eye.show(PULSES, {"RearLeftPulses": 9, "RearRightPulses": 9}, 50 * FRAMES + 1_110)
    assert eye.look(50 * FRAMES + 1_110).pulses == 0


def test_a_frame_that_says_what_cannot_be_is_absurd() -> None:
    eye = Eye()
    eye.show_all()
    for number in range(3):
        assert eye.look().absurd == ()
        eye.show("Auto_SteeringFeedBack", {"Angle": 60.0}, number)
    assert (eye.look(3).faulty, eye.look(3).absurd) == ((), ("Auto_SteeringFeedBack",))


@pytest.mark.parametrize(
    ("variant", "speed_mps", "turns"),
    [
        (Variant.COARSE, 0.0, False),
        (Variant.COARSE, 0.04, False),
        (Variant.COARSE, 0.08, True),
        (Variant.FINE, 0.0, False),
        (Variant.FINE, 0.001, False),
        (Variant.FINE, 0.002, True),
        (Variant.FINE, 2.0, True),
    ],
)
def test_motion_is_seen_while_the_variant_is_not_known(variant: Variant, speed_mps: float, turns: bool) -> None:  # noqa: FBT001 - a case of the table
    """Beyond one bit, in either scale: a gateway that starts beside a moving robot must see that it moves."""
    made = Core(CHASSIS, Settings(chassis=ChassisSettings(variant="auto")), "1.2.3", 0)
    made.update_links(UP, 0)
    feedback = Feedback(variant)
    for name in STANDING:
        moves = {"Speed": speed_mps} if name == DRIVE else None
        made.receive_frame(feedback.frame(name, moves), 0)
    made.tick(10 * MS, 0, 0, CHALLENGE)
    assert made.command is not None
    seen = made.command.arbiter.monitor.chassis
    assert (seen.variant, seen.speed_mps, seen.wheel_speed_mps) == (Variant.UNKNOWN, None, None)
    assert seen.turns is turns


def test_a_bumper_contact_between_two_ticks_is_seen() -> None:
    """Row 'bumper': also where the loop is late and the contact has opened again."""
    eye = Eye()
    eye.show_all()
    eye.show(BODY, {"FrontBumper": True})
    eye.tracker.note_hits()
    eye.show(BODY, {"FrontBumper": False})
    eye.tracker.note_hits()
    assert (eye.look().front_bumper, eye.look().front_bumper) == (True, False)

"""The guard's view of the bus."""

import pytest

from gateway.chassis.cruiser.frames import load
from gateway.chassis.cruiser.guard_view import ChassisView
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Encoder
from schemas.messages import GearPosition, Mode, Variant
from schemas.settings import GUARD_SILENT_NS
from tests.support.frames import MS, Feedback

BODY = "Auto_MileageAndBodyFeedback"
DRIVE = "Auto_DriveFeedBack"
WHEELS = "Auto_WheelSpdFeedback"


def feed(view: ChassisView, variant: Variant = Variant.COARSE, wheels_in: Variant | None = None) -> None:
    """A second of a standing chassis."""
    feedback = Feedback(variant)
    other = Feedback(wheels_in or variant)
    for at_ns, frame in feedback.second():
        is_wheels = frame.can_id == load(Variant.COARSE).messages[WHEELS].can_id
        view.receive(other.frame(WHEELS) if is_wheels else frame, at_ns)
        view.stands(variant, at_ns)


def body(feedback: Feedback, mode: str) -> Frame:
    return feedback.frame(BODY, {"Mode": mode})


def test_remote_is_believed_from_the_second_frame() -> None:
    """One frame may be two flipped bits that the checksum passes, and the guard would let go of the robot."""
    view, feedback = ChassisView(), Feedback(Variant.COARSE)
    view.receive(body(feedback, "auto"), 0)
    assert view.mode(0) is Mode.AUTO
    view.receive(body(feedback, "remote"), 20 * MS)
    assert view.mode(20 * MS) is Mode.UNDEFINED
    view.receive(body(feedback, "auto"), 40 * MS)
    view.receive(body(feedback, "remote"), 60 * MS)
    assert view.mode(60 * MS) is Mode.UNDEFINED
    view.receive(body(feedback, "remote"), 80 * MS)
    assert view.mode(80 * MS) is Mode.REMOTE


def test_a_frame_that_is_not_valid_says_nothing() -> None:
    """Neither of the mode nor of a counter; eight zero bytes have a right checksum, and would read auto."""
    view, feedback = ChassisView(), Feedback(Variant.COARSE)
    for frame in (body(feedback, "auto"), Encoder(load(Variant.COARSE)).encode("Auto_GearCmd", {}, 3)):
        view.receive(Frame(frame.can_id, frame.data[:7] + bytes([frame.data[7] ^ 1])), 0)
    view.receive(Frame(load(Variant.COARSE).messages[BODY].can_id, bytes(8)), 0)
    assert view.mode(0) is Mode.UNDEFINED
    assert view.next_counters == {}
    assert view.commander_ns is None


def test_a_stuck_counter_is_silence() -> None:
    """A chassis that repeats itself tells nothing new: what it says becomes stale."""
    view, frame = ChassisView(), body(Feedback(Variant.COARSE), "auto")
    for at_ms in range(0, 1000, 20):
        view.receive(frame, at_ms * MS)
    assert view.mode(980 * MS) is Mode.UNDEFINED
    assert not view.has_feedback(980 * MS)


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.FINE])
def test_standstill_is_seen_in_either_variant_known_or_not(variant: Variant) -> None:
    """And only after 50 ms of it."""
    view = ChassisView()
    assert not view.stands(variant, 0)
    feed(view, variant)
    assert view.stands(variant, 990 * MS)
    assert not view.stands(Variant.UNKNOWN, 2000 * MS)
    for frame in Feedback(variant).all():
        view.receive(frame, 3000 * MS)
    assert not view.stands(variant, 3000 * MS)
    assert not view.stands(variant, 3049 * MS)
    assert view.stands(variant, 3050 * MS)
    fresh = ChassisView()
    feed(fresh, variant)
    assert fresh.stands(Variant.UNKNOWN, 990 * MS)


@pytest.mark.parametrize("variant", [Variant.COARSE, Variant.UNKNOWN])
@pytest.mark.parametrize(
    ("name", "values"),
    [
        (DRIVE, {"Speed": 0.2}),
        (WHEELS, {"RearLeftSpeed": 0.2, "RearRightSpeed": 0.2}),
        # Their mean is zero, and the robot turns on the spot or slips.
        (WHEELS, {"RearLeftSpeed": 0.4, "RearRightSpeed": -0.4}),
    ],
)
def test_drive_feedback_and_each_wheel_must_stand(name: str, values: dict[str, float], variant: Variant) -> None:
    """Either alone keeps the robot from standing."""
    view, feedback = ChassisView(), Feedback(Variant.COARSE)
    feed(view)
    for at_ms in range(1000, 1100, 10):
        for each in (DRIVE, WHEELS, BODY):
            view.receive(feedback.frame(each, values if each == name else {}), at_ms * MS)
        assert not view.stands(variant, at_ms * MS)


@pytest.mark.parametrize(
    ("name", "values", "moves"),
    [
        (DRIVE, {"Speed": 0.0}, (False, False)),
        (DRIVE, {"Speed": 0.04}, (False, False)),
        (DRIVE, {"Speed": 0.08}, (True, True)),
        (WHEELS, {"RearLeftSpeed": 0.2, "RearRightSpeed": -0.2}, (True, True)),
        (WHEELS, {"RearLeftSpeed": 0.2, "RearRightSpeed": 0.2, "Valid": False}, (False, False)),
    ],
)
def test_motion_is_seen_by_either_speed(
    name: str, values: dict[str, float | bool], moves: tuple[bool, bool]
) -> None:
    """Row 'stop: a robot that is seen to move'; in an unknown scale by what stands in neither."""
    view = ChassisView()
    view.receive(Feedback(Variant.COARSE).frame(name, values), 0)
    assert (view.moves(Variant.COARSE, 0), view.moves(Variant.UNKNOWN, 0)) == moves
    assert not view.moves(Variant.COARSE, 2000 * MS)


def test_what_a_stop_looks_at() -> None:
    """Row 'stop: moves against the ramp, does not slow, applied parking brake': unknown without feedback."""
    view, feedback = ChassisView(), Feedback(Variant.COARSE)
    assert view.is_braked(0) is view.fastest_mps(Variant.COARSE, 0) is None
    assert view.wheel_speed_mps(Variant.COARSE, 0) is None
    view.receive(feedback.frame(DRIVE, {"Speed": 0.4}), 0)
    view.receive(feedback.frame(WHEELS, {"RearLeftSpeed": -0.4, "RearRightSpeed": -0.8}), 0)
    assert view.fastest_mps(Variant.COARSE, 0) == pytest.approx(0.8)
    assert view.wheel_speed_mps(Variant.COARSE, 0) == pytest.approx(-0.6)
    assert view.wheel_speed_mps(Variant.UNKNOWN, 0) is view.fastest_mps(Variant.UNKNOWN, 0) is None
    for status, is_braked in (("applied", True), ("released", False)):
        view.receive(feedback.frame("Auto_ParkingFeedBack", {"ParkingStatus": status}), 0)
        assert view.is_braked(0) is is_braked


def test_silence_is_not_standstill() -> None:
    view = ChassisView()
    feed(view)
    assert view.has_feedback(990 * MS)
    assert view.gear(990 * MS) is GearPosition.PARK
    later_ns = 990 * MS + GUARD_SILENT_NS
    assert not view.has_feedback(later_ns)
    assert not view.stands(Variant.COARSE, later_ns)
    assert view.gear(later_ns) is GearPosition.UNDEFINED
    assert view.slowest_mps(Variant.COARSE, later_ns) is None
    assert view.angle_deg(later_ns) == 0


def test_the_next_counter_of_each_command_is_known() -> None:
    """From any sender: 15 wraps to 0."""
    view, encoder = ChassisView(), Encoder(load(Variant.COARSE))
    view.receive(encoder.encode("Auto_GearCmd", {}, 15), 7)
    view.receive(encoder.encode("Auto_LightCmd", {}, 3), 9)
    assert view.next_counters == {"Auto_GearCmd": 0, "Auto_LightCmd": 4}
    assert view.commander_ns == 7, "lamps move nobody"

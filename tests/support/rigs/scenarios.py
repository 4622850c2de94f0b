"""What can stop a robot, acted out in the rig: one function a scenario, each returns the rig."""

from collections.abc import Callable
from functools import cache

import msgspec

from gateway.telemetry.health import Links
from schemas.reasons import Reason
from schemas.settings import CommandSettings
from tests.support.messages import SECOND
from tests.support.rigs.gateway import GUARDED, MS, Operator
from tests.support.rigs.recorded import RecordedRig

BACK = msgspec.structs.replace(GUARDED, bus_losses=1)


def _faulted(words: str, seconds: float = 0.3) -> RecordedRig:
    """A driven robot with a fault of its chassis."""
    rig, operator = RecordedRig.driving()
    rig.fault(words)
    operator.drive(0.6, 0.0, seconds)
    rig.rest()
    return rig


def _linked(links: Links, seconds: float = 0.3) -> RecordedRig:
    """A driven robot whose gateway sees this of its bus and guard for a while."""
    rig, operator = RecordedRig.driving()
    rig.links = links
    operator.drive(0.6, 0.0, seconds)
    rig.links = GUARDED
    rig.rest()
    return rig


def front_bumper() -> RecordedRig:
    return _faulted("bumper front on for 700ms")


def rear_bumper() -> RecordedRig:
    return _faulted("bumper rear on for 700ms")


def deadman() -> RecordedRig:
    """The stream of drive commands ends."""
    rig, _ = RecordedRig.driving()
    rig.rest_after(1.0)
    return rig


def longer_deadman() -> RecordedRig:
    """The same over a link that stalls, for which a longer deadman was asked for."""
    rig, operator = RecordedRig.ready()
    operator.engage(deadman_s=0.8)
    operator.drive(0.6, 0.0, 1.5)
    rig.rest_after(1.5)
    return rig


def stale_commands() -> RecordedRig:
    """The stream goes on, but its commands grow old."""
    rig, operator = RecordedRig.driving()
    challenge = rig.says.challenge
    for _ in range(80):
        rig.put(operator.name, "drive", operator.drive_payload(0.6, challenge=challenge))
        rig.tick(2)
    rig.rest()
    return rig


def repeated_sequence() -> RecordedRig:
    """The stream repeats a sequence number."""
    rig, operator = RecordedRig.driving()
    for _ in range(20):
        operator.sequence = 5
        rig.put(operator.name, "drive", operator.drive_payload(0.6))
        rig.tick(2)
    rig.rest()
    return rig


def lease_expired() -> RecordedRig:
    """The lease runs out before the deadman does."""
    rig, _ = RecordedRig.driving(command=CommandSettings(lease_s=0.5, deadman_s=0.5))
    rig.rest_after(1.0)
    return rig


def lease_taken() -> RecordedRig:
    """Somebody of a higher role takes the lease."""
    rig, _ = RecordedRig.driving()
    Operator(rig, "operator-2").take_lease("take", role="supervisor", override=True)
    rig.rest()
    return rig


def lease_released() -> RecordedRig:
    """The holder gives the lease back at speed."""
    rig, operator = RecordedRig.driving()
    operator.reason("release")
    rig.rest()
    return rig


def disengaged() -> RecordedRig:
    rig, operator = RecordedRig.driving()
    operator.reason("disengage")
    rig.rest()
    return rig


def remote_stop() -> RecordedRig:
    """Somebody without a lease stops the robot."""
    rig, _ = RecordedRig.driving()
    rig.put("desk", "stop", b"")
    rig.tick()
    rig.rest()
    return rig


def stepped_clock(*, steps_recorder: bool) -> RecordedRig:
    """In mid-drive the robot's wall clock is set an hour forward, and the recorder's, if it is the same."""
    rig, operator = RecordedRig.driving()
    operator.drive(0.6, 0.0, 2.0)
    rig.wall_ns += 3600 * SECOND
    rig.recorder_ns += 3600 * SECOND if steps_recorder else 0
    operator.drive(0.6, 0.0, 2.0)
    return rig


def hand_transmitter() -> RecordedRig:
    """The remote control takes over."""
    rig, operator = RecordedRig.driving()
    rig.fault("transmitter remote for 9s")
    operator.drive(0.6, 0.0, 0.3)
    rig.run(1.0)
    return rig


def one_silent_frame() -> RecordedRig:
    return _faulted("silence Auto_GearFeedBack for 500ms", 0.4)


def slow_silent_frame() -> RecordedRig:
    """One that comes every 50 ms stays away."""
    return _faulted("silence Auto_WheelSpdFeedback for 900ms", 0.8)


def checksums() -> RecordedRig:
    return _faulted("checksum Auto_DriveFeedBack for 5 frames")


def stuck_counter() -> RecordedRig:
    return _faulted("stuck Auto_SteeringFeedBack for 8 frames")


def wrong_scale() -> RecordedRig:
    """The drive feedback comes in the other scale."""
    return _faulted("scale wrong for 800ms", 0.5)


def other_commander() -> RecordedRig:
    return _faulted("foreign 18C4D3D0 every 10ms for 200ms")


def bus_lost() -> RecordedRig:
    """The bus goes away, and stays away."""
    rig, operator = RecordedRig.driving()
    rig.links = Links(bus_up=False, bus_losses=1, guarded=True, realtime=True)
    rig.corrupt = lambda _: None
    operator.drive(0.6, 0.0, 1.2)
    return rig


def guard_lost() -> RecordedRig:
    return _linked(Links(bus_up=True, guarded=False, realtime=True))


def guard_acts() -> RecordedRig:
    """The guard stops the robot."""
    rig, operator = RecordedRig.driving()
    rig.links = Links(bus_up=True, guarded=True, guard_sends=True, guard_stops=1, realtime=True)
    operator.drive(0.6, 0.0, 0.3)
    return rig


def late_loop() -> RecordedRig:
    """A tick begins 150 ms late."""
    rig, operator = RecordedRig.driving()
    rig.late_ns = 150 * MS
    rig.tick()
    rig.late_ns = 0
    operator.drive(0.6, 0.0, 0.1)
    rig.rest()
    return rig


def flooded() -> RecordedRig:
    """Frames come faster than they can be read."""
    return _linked(Links(bus_up=True, guarded=True, is_behind=True, realtime=True), 0.1)


def full_bus() -> RecordedRig:
    """The bus takes two frames of five."""
    rig, operator = RecordedRig.driving()
    rig.takes = 2
    operator.drive(0.6, 0.0, 0.2)
    rig.takes = None
    rig.rest()
    return rig


def not_confirmed() -> RecordedRig:
    """The chassis does not hear the enables."""
    rig, operator = RecordedRig.ready()
    rig.chassis_hears = False
    operator.take_lease()
    operator.ask("engage")
    for _ in range(60):
        operator.drive(0.0)
    rig.rest()
    return rig


def found_moving() -> RecordedRig:
    """The bus comes back to a robot that obeys its last command."""
    rig, _ = RecordedRig.driving()
    rig.links = Links(bus_up=False, bus_losses=1, guarded=True, realtime=True)
    rig.run(0.1)
    rig.links = BACK
    rig.run(0.3)
    rig.rest()
    return rig


def shut_down() -> RecordedRig:
    """The gateway is told to end."""
    rig, operator = RecordedRig.driving()
    rig.core.shut_down(rig.now_ns)
    operator.drive(0.6, 0.0, 0.1)
    rig.rest()
    return rig


def rolling() -> RecordedRig:
    """The motor dies uphill."""
    return _on_the_way("motor 0", "slope 8", speed_mps=0.5)


def not_moving() -> RecordedRig:
    """The motor dies on the level."""
    return _on_the_way("motor 0", speed_mps=0.5)


def frozen_mileage() -> RecordedRig:
    """The mileage stands still while the robot drives."""
    return _on_the_way("freeze Auto_MileageAndBodyFeedback")


def stuck_steering() -> RecordedRig:
    """The steering angle stands still while another one is commanded."""
    return _on_the_way("freeze Auto_SteeringFeedBack", angle_deg=15.0)


def _on_the_way(fault: str, before: str = "", speed_mps: float = 0.6, angle_deg: float = 0.0) -> RecordedRig:
    """A robot that is driven on, for as long as it lets itself be, with a fault of its chassis."""
    rig, operator = RecordedRig.ready()
    if before:
        rig.fault(before)
    operator.engage()
    operator.drive(speed_mps, 0.0, 1.3)
    rig.fault(fault)
    for _ in range(70):
        if rig.says.engaged:
            operator.drive(speed_mps, angle_deg, 0.1)
    rig.rest()
    return rig


Scenario = Callable[[], RecordedRig]

SCENARIOS: dict[Scenario, tuple[Reason, tuple[str, ...]]] = {
    front_bumper: (
        Reason.FRONT_BUMPER,
        ("0x18C4D9EF Auto_MileageAndBodyFeedback, 01 39 30 00 01", "FrontBumper = 1", "said 0"),
    ),
    rear_bumper: (Reason.REAR_BUMPER, ("01 39 30 00 10", "RearBumper = 1")),
    longer_deadman: (Reason.DEADMAN, ("810 ms before", "the limit is 800 ms (as engage asked for)")),
    deadman: (
        Reason.DEADMAN,
        ("of operator-1", "310 ms before", "the limit is 300 ms", "No drive command at all"),
    ),
    stale_commands: (Reason.DEADMAN, ("15 drive requests", "1290 ms, at most 1000 ms", "seq 134, 1290 ms old")),
    repeated_sequence: (Reason.DEADMAN, ("15 drive requests", "does not rise, or by too much; 6 after 69")),
    lease_expired: (Reason.LEASE_EXPIRED, ("drive of operator-1, 500 ms before the stop", "a lease lasts 500 ms")),
    lease_taken: (Reason.LEASE_TAKEN, ("take, of operator-2",)),
    lease_released: (Reason.LEASE_RELEASED, ("release, of operator-1",)),
    disengaged: (Reason.DISENGAGED, ("disengage, of operator-1",)),
    remote_stop: (Reason.REMOTE_STOP, ("stop, of desk",)),
    hand_transmitter: (Reason.HAND_TRANSMITTER, ("Mode = remote", "the last one that did not, 20.0 ms")),
    one_silent_frame: (
        Reason.FEEDBACK_MISSING,
        ("last good Auto_GearFeedBack came 110 ms before the stop", "the limit is 100 ms (its period is 10 ms)"),
    ),
    slow_silent_frame: (
        Reason.FEEDBACK_MISSING,
        ("last good Auto_WheelSpdFeedback came 510 ms", "the limit is 500 ms"),
    ),
    checksums: (
        Reason.FEEDBACK_FAULTY,
        ("last good Auto_DriveFeedBack", "5 of", "had a wrong checksum", "which should end with"),
    ),
    stuck_counter: (
        Reason.FEEDBACK_FAULTY,
        ("last good Auto_SteeringFeedBack", "the last alive counters: "),
    ),
    wrong_scale: (
        Reason.IMPLAUSIBLE_SPEED,
        ("Auto_DriveFeedBack said Speed = 21", "beyond 3"),
    ),
    other_commander: (Reason.OTHER_COMMANDER, ("1 command frame that this gateway did not send", "0x18C4D3D0")),
    bus_lost: (Reason.BUS_DOWN, ("last frame was received 10.0 ms before the stop", "bus can0, bus up no")),
    guard_lost: (Reason.UNGUARDED, ("no guard watches, first at the stop",)),
    guard_acts: (Reason.GUARD, ()),
    late_loop: (
        Reason.LOOP_LATE,
        ("tick lateness max ms 150", "the limit is 100 ms", "160 ms apart there, and 1 tick"),
    ),
    flooded: (Reason.FEEDBACK_LATE, ("frames per s 630",)),
    full_bus: (Reason.SEND_FAILED, ("5 ticks in a row", "2 to 2 of five frames went out")),
    not_confirmed: (
        Reason.NOT_CONFIRMED,
        ("engage, of operator-1", "1.00 s before the stop", "Mode = stop"),
    ),
    found_moving: (Reason.FOUND_MOVING, ("the CAN bus is not there", "said 0.60 m/s")),
    shut_down: (Reason.SHUTDOWN, ()),
    rolling: (
        Reason.ROLLING,
        (
            "rear wheels turned at -0.",
            "commanded was 0.50 m/s",
        ),
    ),
    not_moving: (Reason.NOT_MOVING, ("drive feedback said 0.00 m/s, commanded was 0.50 m/s",)),
    frozen_mileage: (Reason.FEEDBACK_FROZEN, ("mileage read 12.345 km, and did not change over 3 m",)),
    stuck_steering: (Reason.STEERING, ("read 0.0 deg, commanded was 1", "to 15.0 deg; over 5 deg beside")),
}
"""The reason that is to be named, and what the evidence has to say."""


@cache
def acted(scenario: Scenario) -> RecordedRig:
    """A scenario, acted out once for all tests."""
    return scenario()


@cache
def recorded(scenario: Scenario, *without: str) -> bytes:
    """Its log, made once for all tests, but for some subjects."""
    return acted(scenario).log(without=without)

"""Row 'stop: ramp to zero in gear, parking brake, neutral behind it, hold 1 s, disable 0.5 s, silence'."""

from collections.abc import Callable
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.chassis.port import Actuation
from gateway.command.stop import StopFeedback, StopSequence
from schemas.decisions import StopPhase
from schemas.messages import GearPosition

MS = 1_000_000
DRIVE, REVERSE, NEUTRAL = GearPosition.DRIVE, GearPosition.REVERSE, GearPosition.NEUTRAL
DRIVING = Actuation(True, DRIVE, 1.0, 10.0, parking=False)  # noqa: FBT003
BLIND = StopFeedback()
STANDS = StopFeedback(stands=True, speed_mps=0.0, wheel_speed_mps=0.0, is_braked=False)
HELD = StopFeedback(stands=True, speed_mps=0.0, wheel_speed_mps=0.0, is_braked=True)

Told = list[tuple[StopPhase, Actuation]]
See = Callable[[Actuation], StopFeedback]


def moving(speed_mps: float, *, is_braked: bool | None = False, backward: bool = False) -> StopFeedback:
    """A robot that is seen to move."""
    wheels_mps = -speed_mps if backward else speed_mps
    return StopFeedback(moves=True, speed_mps=speed_mps, wheel_speed_mps=wheels_mps, is_braked=is_braked)


def obedient(told: Actuation) -> StopFeedback:
    """A robot that follows at once, brake and all."""
    if told.speed_mps == 0:
        return HELD if told.parking else STANDS
    return moving(told.speed_mps, backward=told.gear is REVERSE)


class Run:
    """A stop, tick by tick.

    Attributes:
        told: the output of every tick so far, with its phase.
    """

    def __init__(self, last: Actuation = DRIVING, deceleration_mps2: float = 2.0) -> None:
        self.sequence = StopSequence(last, deceleration_mps2, 0)
        self.now_ms = 0
        self.told: Told = []
        self._last = last

    @property
    def last(self) -> Actuation:
        return self.told[-1][1] if self.told else self._last

    def run(self, see: See | StopFeedback = obedient, ms: int = 10) -> Actuation:
        """Time passes; what is seen follows from what was told, or stays as it is."""
        for _ in range(ms // 10):
            seen = see if isinstance(see, StopFeedback) else see(self.last)
            actuation = self.sequence.tick(self.now_ms * MS, seen)
            self.now_ms += 10
            if actuation is None:
                assert self.sequence.phase is StopPhase.IDLE
                break
            self.told.append((self.sequence.phase, actuation))
        return self.last

    def lasted_ms(self) -> dict[StopPhase, int]:
        """How long each phase took, in their order."""
        phases = [phase for phase, _ in self.told]
        return {phase: 10 * phases.count(phase) for phase in dict.fromkeys(phases)}


def test_the_whole_sequence() -> None:
    """Row 'stop': in gear until the parking brake reads applied, then neutral; nothing but the brake holds it."""
    stop = Run()
    stop.run(ms=10_000)
    assert stop.lasted_ms() == {
        StopPhase.RAMP: 490,
        StopPhase.BRAKE: 10,
        StopPhase.PARK: 10,
        StopPhase.HOLD: 1000,
        StopPhase.DISABLE: 500,
    }
    outputs = {phase: actuation for phase, actuation in stop.told if phase is not StopPhase.RAMP}
    assert outputs == {
        StopPhase.BRAKE: Actuation(True, DRIVE, 0.0, 10.0, parking=False),  # noqa: FBT003
        StopPhase.PARK: Actuation(True, DRIVE, 0.0, 10.0, parking=True),  # noqa: FBT003
        StopPhase.HOLD: Actuation(True, DRIVE, 0.0, 10.0, parking=True),  # noqa: FBT003
        StopPhase.DISABLE: Actuation(False, NEUTRAL, 0.0, 10.0, parking=True),  # noqa: FBT003
    }
    assert stop.sequence.tick(99_999 * MS, HELD) is None, "it has ended"


@pytest.mark.parametrize("deceleration_mps2", [1.2, 2.0])
@pytest.mark.parametrize("gear", [DRIVE, REVERSE])
def test_the_ramp_keeps_its_deceleration_and_its_gear(deceleration_mps2: float, gear: GearPosition) -> None:
    """Rows 'normal / emergency deceleration' and 'stop: ramp in gear': from the first tick on, exactly."""
    stop = Run(Actuation(True, gear, 1.0, 10.0, parking=False), deceleration_mps2)  # noqa: FBT003
    stop.run(ms=10_000)
    ramp = [actuation for phase, actuation in stop.told if phase is StopPhase.RAMP]
    assert len(ramp) == pytest.approx(100 / deceleration_mps2, abs=1)
    for tick, actuation in enumerate(ramp, 1):
        assert actuation.speed_mps == pytest.approx(1.0 - deceleration_mps2 * tick * 0.01)
        assert (actuation.gear, actuation.parking) == (gear, False)


def test_what_cannot_ramp_is_zero_at_once() -> None:
    """Where the scale is in doubt."""
    stop = Run(deceleration_mps2=inf)
    assert stop.run().speed_mps == 0
    assert stop.sequence.phase is StopPhase.BRAKE


def test_a_graver_cause_hastens_and_a_lesser_one_does_not_slow_it() -> None:
    """Row 'emergency deceleration'."""
    stop = Run(deceleration_mps2=1.2)
    stop.sequence.hasten(2.0)
    stop.sequence.hasten(1.2)
    assert (stop.run().speed_mps, stop.run().speed_mps) == pytest.approx((0.98, 0.96))


def test_a_pause_makes_one_step_of_a_tenth_of_a_second_at_most() -> None:
    """A late loop is no jump to zero."""
    actuation = StopSequence(DRIVING, 2.0, 0).tick(5_000 * MS, moving(0.9))
    assert actuation is not None
    assert actuation.speed_mps == pytest.approx(0.8)


def test_a_ramp_may_be_cut_lower_and_never_higher() -> None:
    """From the lower speed it goes on in the same steps."""
    stop = Run()
    stop.sequence.not_above(5.0)
    assert stop.run().speed_mps == pytest.approx(0.98)
    stop.sequence.not_above(0.5)
    assert stop.run().speed_mps == pytest.approx(0.48)
    assert stop.sequence.phase is StopPhase.RAMP


# The parking brake.


def test_the_parking_brake_waits_for_standstill_while_the_robot_slows_down() -> None:
    """Row 'stop: parking brake as soon as the robot stands': not while it only lags behind the ramp."""
    stop = Run()
    for at_ms in range(0, 1200, 10):
        stop.run(moving(1.0 - at_ms / 1200))
    assert not stop.last.parking
    assert stop.run(STANDS).parking
    assert stop.last.gear is DRIVE


@pytest.mark.parametrize(("gear", "backward"), [(DRIVE, True), (REVERSE, False)])
@pytest.mark.parametrize("ramps", [True, False])
def test_the_parking_brake_is_told_at_once_when_it_moves_against_the_ramp(
    gear: GearPosition,
    *,
    backward: bool,
    ramps: bool,
) -> None:
    """Row 'stop: or is seen to move against the ramp': by more than the standstill bound, at any told speed."""
    stop = Run(Actuation(True, gear, 1.0 if ramps else 0.0, 0.0, parking=False))  # noqa: FBT003
    assert not stop.run(moving(0.05, backward=backward)).parking
    told = stop.run(moving(0.051, backward=backward))
    assert (told.parking, told.speed_mps, told.gear) == (True, 0.0, gear)


@pytest.mark.parametrize("told_mps", [1.0, 0.0])
@pytest.mark.parametrize("seen", [moving(1.0), moving(0.06), BLIND], ids=["fast", "slow", "blind"])
def test_a_robot_that_is_not_seen_to_slow_gets_its_parking_brake(told_mps: float, seen: StopFeedback) -> None:
    """Row 'stop: or not to slow for 300 ms', also when nothing can be seen; in gear meanwhile."""
    stop = Run(Actuation(True, DRIVE, told_mps, 0.0, parking=False), 1.2)  # noqa: FBT003
    if told_mps or seen is not BLIND:
        assert not stop.run(seen, 300).parking
    # At zero speed it should stand: what cannot be seen at all is not waited for.
    told = stop.run(seen)
    assert (told.parking, told.speed_mps, told.gear) == (True, 0.0, DRIVE)


def test_a_robot_that_stops_slowing_gets_its_parking_brake_300_ms_later() -> None:
    """Row 'stop: not to slow for 300 ms': from when it was last slower; noise is not slower."""
    stop = Run(deceleration_mps2=1.2)
    for at_ms in range(0, 200, 10):
        stop.run(moving(1.0 - 1.2 * at_ms / 1000))
    for tick in range(28):
        assert not stop.run(moving(0.772 + 0.015 * (tick % 2))).parking
    stop.run(moving(0.772), 30)
    assert stop.last.parking


def test_a_robot_that_slows_and_does_not_stand_gets_its_parking_brake_a_second_after_zero_was_told() -> None:
    """Row 'stop: parking brake': one that loses a little speed all the time would coast for metres."""
    stop = Run(deceleration_mps2=inf)
    stop.run(lambda _: moving(2.0 - 0.3 * stop.now_ms / 1000), 1_000)
    assert stop.lasted_ms() == {StopPhase.BRAKE: 1_000}
    stop.run(moving(1.7))
    assert stop.sequence.phase is StopPhase.PARK


@pytest.mark.parametrize("seen", [STANDS, moving(0.5), BLIND], ids=["stands", "moves", "blind"])
@pytest.mark.parametrize(
    "last",
    [
        Actuation(True, NEUTRAL, 0.0, parking=False),  # noqa: FBT003
        Actuation(True, GearPosition.UNDEFINED, 0.0, parking=False),  # noqa: FBT003
        Actuation(True, DRIVE, 0.0, parking=True),  # noqa: FBT003
        Actuation(True, NEUTRAL, 0.0, parking=True),  # noqa: FBT003
    ],
    ids=["neutral", "unknown", "parked in gear", "parked"],
)
def test_what_began_in_neutral_or_parked_is_parked_from_the_first_tick_on(
    last: Actuation, seen: StopFeedback
) -> None:
    """Row 'stop: or the stop began in neutral'; what was parked is never released in a stop."""
    stop = Run(last)
    stop.run(seen, 8_000)
    assert all(actuation.parking and not actuation.speed_mps for _, actuation in stop.told)


def test_a_stop_that_parks_does_so_at_any_speed_and_once_only() -> None:
    """Rows 'rolling' and 'gate': zero speed and the parking brake in one tick; later nothing begins again."""
    stop = Run()
    stop.run(ms=50)
    stop.sequence.park(stop.now_ms * MS)
    told = stop.run(moving(0.9))
    assert (told.parking, told.speed_mps, told.gear) == (True, 0.0, DRIVE)
    stop.run(HELD, 500)
    stop.sequence.park(stop.now_ms * MS)
    assert stop.sequence.phase is StopPhase.HOLD


# Neutral.


def test_the_gear_stays_in_until_the_enables_go() -> None:
    """Row 'neutral only behind an applied parking brake': one that reads applied may close late, or not at all."""
    stop = Run()
    stop.run(ms=20_000)
    gears = {actuation.gear for phase, actuation in stop.told if phase is not StopPhase.DISABLE}
    assert gears == {DRIVE}


def test_a_robot_that_its_brake_does_not_hold_without_enables_is_held_by_them() -> None:
    """Row 'stop': disabled frames may release the brake of some firmware; then it is told to hold again."""
    stop = Run()
    while stop.sequence.phase is not StopPhase.DISABLE:
        stop.run(HELD)
    told = stop.run(moving(0.1))
    assert (stop.sequence.phase, told.enabled, told.parking) == (StopPhase.PARK, True, True)


def test_after_the_second_return_the_enables_stay_until_a_reset() -> None:
    """Row 'a parking brake that does not hold': in gear, where the motor holds it, until a reset."""
    stop = Run()
    for returns in (1, 2):
        while stop.sequence.phase is not StopPhase.DISABLE:
            assert not stop.sequence.stays
            stop.run(HELD)
        stop.run(moving(0.1))
        assert stop.sequence.returns == returns
    assert stop.sequence.stays
    stop.run(HELD, 4_990)
    assert not stop.sequence.is_braked(stop.now_ms * MS)
    stop.run(HELD, 60_000)
    assert (stop.sequence.phase, stop.last.enabled, stop.last.gear) == (StopPhase.HOLD, True, DRIVE)
    assert stop.sequence.is_braked(stop.now_ms * MS)
    stop.sequence.finish(stop.now_ms * MS)
    stop.run(HELD, 1_000)
    assert stop.sequence.phase is StopPhase.IDLE


@pytest.mark.parametrize(("later_mps", "is_braked"), [(0.3, True), (0.1, False), (0.0, False)])
def test_a_robot_that_is_given_back_to_its_motor_is_braked_again_if_it_becomes_faster(
    later_mps: float,
    is_braked: bool,  # noqa: FBT001 - a case of the table
) -> None:
    """Row 'a parking brake that does not hold: faster 300 ms later: brake again, for good'."""
    parked = Actuation(enabled=True, gear=DRIVE, parking=True)
    stop = Run(parked)
    stop.sequence.release(0)
    told = stop.run(moving(0.2), 300)
    assert (told.enabled, told.gear, told.speed_mps, told.parking) == (True, DRIVE, 0.0, False)
    seen = moving(later_mps, is_braked=True) if later_mps else HELD
    assert stop.run(seen, 10_000).parking is is_braked
    assert stop.sequence.stays
    assert stop.run(moving(0.4, is_braked=True), 10_000).parking
    assert stop.run(HELD, 60_000).enabled


@pytest.mark.parametrize(("unread", "is_braked"), [(StopFeedback(moves=True), True), (StopFeedback(), False)])
def test_a_robot_that_moves_beyond_what_can_be_read_is_held_by_no_motor(
    unread: StopFeedback,
    is_braked: bool,  # noqa: FBT001 - a case of the table
) -> None:
    """The same row: seen by the pulses alone it is faster. A robot of which nothing is received is not."""
    stop = Run(Actuation(enabled=True, gear=DRIVE, parking=True))
    stop.sequence.release(0)
    stop.run(moving(0.2), 310)
    assert stop.run(unread, 50).parking is is_braked


def test_a_motor_that_is_given_a_robot_beyond_what_can_be_read_gives_it_back() -> None:
    """The same: no speed is ever received, so none is seen to rise."""
    stop = Run(Actuation(enabled=True, gear=DRIVE, parking=True))
    stop.sequence.release(0)
    stop.run(StopFeedback(moves=True), 310)
    assert stop.run(StopFeedback(moves=True), 50).parking


def test_a_brake_that_slows_a_robot_beyond_what_can_be_read_does_not_slip() -> None:
    """The same: its controller restarted on a hill, and its brake catches it at 5 m/s, which is no valid speed."""
    sequence = StopSequence(
        Actuation(enabled=True, gear=DRIVE, parking=True), 2.0, 0, may_release=True, stood_by_motor=True
    )
    speed_mps = 5.0
    for now_ms in range(10, 3000, 10):
        is_braked = now_ms > 500
        speed_mps = max(0.0, speed_mps - 0.037 * is_braked)
        shown_mps = speed_mps if speed_mps < 2.5 else None
        seen = StopFeedback(
            moves=speed_mps > 0,
            speed_mps=shown_mps,
            wheel_speed_mps=shown_mps,
            is_braked=is_braked,
            stands=not speed_mps,
        )
        told = sequence.tick(now_ms * MS, seen)
        assert told is not None
        assert told.parking, now_ms


def test_noise_is_not_faster_for_a_robot_that_its_motor_holds() -> None:
    """The same: a robot at rest whose coarse speeds flicker by a bit each way is not given to its brake again."""
    stop = Run(Actuation(enabled=True, gear=DRIVE, parking=True))
    stop.sequence.release(0)
    stop.run(moving(0.0), 310)
    for tick in range(200):
        assert not stop.run(moving(0.08 * (tick % 2))).parking
    assert stop.run(moving(0.081)).parking


@pytest.mark.parametrize(("backward", "gear"), [(True, REVERSE), (False, DRIVE)])
def test_a_robot_that_rolls_in_neutral_behind_its_brake_gets_the_gear_of_its_motion(
    *, backward: bool, gear: GearPosition
) -> None:
    """The same in the midst of a change of direction: behind the brake, and a tick later its motor has it."""
    stop = Run()
    parked = Actuation(enabled=True, gear=NEUTRAL, parking=True)
    stop.sequence = StopSequence(parked, 2.0, 0, may_release=True, stood_by_motor=True)
    stop.run(HELD, 30)
    begun = len(stop.told)
    stop.run(moving(0.2, backward=backward, is_braked=True), 200)
    steps = [(told.gear, told.parking) for _, told in stop.told[begun:]]
    assert list(dict.fromkeys(steps)) == [(NEUTRAL, True), (gear, True), (gear, False)]
    assert steps.count((gear, True)) == 1


@pytest.mark.parametrize("may_release", [True, False])
def test_a_stop_gives_a_robot_that_rolls_behind_its_brake_back_to_the_motor_that_stopped_it(
    *, may_release: bool
) -> None:
    """Row 'a parking brake that reads applied and does not hold': once, if the motor brought it to rest."""
    stop = Run()
    stop.sequence = StopSequence(DRIVING, 2.0, 0, may_release=may_release)
    stop.run(ms=1_000)
    assert stop.sequence.phase is StopPhase.HOLD
    assert stop.run(moving(0.3, is_braked=True), 50).parking
    assert stop.run(moving(0.1, is_braked=True), 60).parking, "it slows down: the brake holds"
    stop.run(HELD, 200)
    assert stop.run(moving(0.1, is_braked=True), 100).parking
    assert stop.run(moving(0.1, is_braked=True), 20).parking is not may_release
    assert stop.sequence.stays is may_release
    unseen = Run()
    unseen.sequence = StopSequence(DRIVING, 2.0, 0, may_release=may_release)
    unseen.run(BLIND, 1_000)
    assert unseen.run(moving(0.1, is_braked=True), 1_000).parking


def test_a_parking_brake_that_never_reads_applied_keeps_the_robot_in_gear() -> None:
    """Row 'neutral only behind an applied parking brake': the motor holds it, for ever; said after 3 s."""
    stop = Run()
    stop.run(lambda told: STANDS if told.speed_mps == 0 else obedient(told), 510)
    begun_ms = stop.now_ms - 10
    assert stop.sequence.phase is StopPhase.PARK
    while stop.now_ms < begun_ms + 3_000:
        assert not stop.sequence.lacks_brake((stop.now_ms - 1) * MS)
        stop.run(STANDS)
    assert stop.sequence.lacks_brake(stop.now_ms * MS)
    told = stop.run(STANDS, 60_000)
    assert (stop.sequence.phase, told.gear, told.parking, told.enabled) == (StopPhase.PARK, DRIVE, True, True)
    stop.run(HELD)
    assert not stop.sequence.lacks_brake(stop.now_ms * MS)


def test_a_parking_brake_of_which_nothing_is_known_is_waited_for_and_the_gear_stays() -> None:
    """Row 'neutral only behind an applied parking brake': 3 s, then the rest comes all the same, in gear."""
    stop = Run()
    stop.run(BLIND, 10_000)
    assert stop.lasted_ms() == {
        StopPhase.RAMP: 300,
        StopPhase.PARK: 3_000,
        StopPhase.HOLD: 1_000,
        StopPhase.DISABLE: 500,
    }
    assert {actuation.gear for phase, actuation in stop.told if phase is not StopPhase.DISABLE} == {DRIVE}


# The end.


def test_a_robot_that_is_seen_to_move_is_not_left() -> None:
    """Row 'stop: hold 1 s': the second begins anew as long as it moves, brake or no brake."""
    stop = Run()
    stop.run(ms=1_000)
    assert stop.sequence.phase is StopPhase.HOLD
    stop.run(moving(0.1, is_braked=True), 60_000)
    assert stop.sequence.phase is StopPhase.HOLD
    stop.run(HELD, 990)
    assert stop.last.enabled
    assert not stop.run(HELD).enabled


def test_each_phase_is_told_also_after_a_pause() -> None:
    """Zero speed before the parking brake, and that before neutral: one phase a tick, however late it is."""
    sequence = StopSequence(DRIVING, inf, 0)
    told = [sequence.tick(at_ms * MS, HELD) for at_ms in range(0, 20_000, 5_000)][:4]
    outputs = [(one.speed_mps, one.parking, one.gear) for one in told if one is not None]
    assert outputs == [(0.0, False, DRIVE), (0.0, True, DRIVE), (0.0, True, DRIVE), (0.0, True, NEUTRAL)]


@given(
    speed_mps=st.floats(0, 2.222),
    gear=st.sampled_from([DRIVE, REVERSE, NEUTRAL]),
    parking=st.booleans(),
    seen=st.lists(
        st.builds(
            StopFeedback,
            stands=st.booleans(),
            moves=st.booleans(),
            speed_mps=st.none() | st.floats(0, 3),
            wheel_speed_mps=st.none() | st.floats(-3, 3),
            is_braked=st.none() | st.booleans(),
        ),
        min_size=1,
        max_size=30,
    ),
    steps_ms=st.lists(st.integers(1, 400), min_size=1, max_size=30),
)
def test_nothing_is_ever_taken_back_in_a_stop(
    speed_mps: float, gear: GearPosition, *, parking: bool, seen: list[StopFeedback], steps_ms: list[int]
) -> None:
    """Whatever is seen, however the ticks come: the speed falls, the brake stays, neutral only behind it."""
    is_driven = gear is not NEUTRAL and not parking
    last = before = Actuation(True, gear, speed_mps if is_driven else 0.0, 0.0, parking=parking)  # noqa: FBT003
    sequence = StopSequence(last, 1.2, 0)
    now_ms = 0
    for tick in range(400):
        now_ms += steps_ms[tick % len(steps_ms)]
        one = seen[tick % len(seen)]
        told = sequence.tick(now_ms * MS, one)
        if told is None:
            break
        assert told.speed_mps <= before.speed_mps
        assert not (told.parking and told.speed_mps)
        assert told.parking or not before.parking
        assert told.enabled or (told.gear is NEUTRAL and told.parking)
        if told.gear is not before.gear:
            assert (before.parking, before.speed_mps) == (True, 0.0)
            assert told.gear in {NEUTRAL, last.gear}
        before = told
    assert before.parking, "within 300 ms of any robot that does not slow down"

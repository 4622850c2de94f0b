"""The oracle finds what it is there to find: each case breaks one rule, and the first does not."""

from collections.abc import Callable
from functools import partial
from random import Random
from typing import Any

import pytest
from msgspec.structs import replace

from schemas.settings import CommandSettings
from tests.system.scenarios.oracle import Oracle
from tests.system.scenarios.plant import (
    AUTO,
    BODY,
    BRAKING_CMD,
    DRIVE,
    DRIVE_CMD,
    GEAR_CMD,
    GEAR_D,
    GEAR_N,
    GEAR_R,
    LIGHT_CMD,
    MOTOR_N,
    PARKING_CMD,
    PERIOD_STEPS,
    PULSES,
    REMOTE,
    ROLLING_MPS2,
    STEERING_CMD,
    STEP_S,
    STOP,
    WHEELS,
    Build,
    Plant,
    checksum,
    orders,
)


class Stage:
    """An oracle, a plant that it may believe, and whoever commands it."""

    def __init__(self, slope_deg: float = 0.0) -> None:
        self.oracle = Oracle(CommandSettings(speed_limit_mps=1.0), fine=True, is_undisturbed=True, lag_s=0.1)
        self.plant = Plant(Build(fine=True, drive_lag_s=0.1), Random(1), slope_deg)  # noqa: S311
        self.now_s = 1.0
        self.state: dict[str, Any] = {"latched": [], "engaged": True, "stop_reason": "none"}
        self._counter = 0
        self.order = (DRIVE_CMD, GEAR_CMD, STEERING_CMD, BRAKING_CMD, PARKING_CMD)
        self.asked_mps = 0.0
        self.asks = True
        self.burst(GEAR_D, parking=1)
        self.run(0.5, lambda: self.burst(GEAR_D, parking=1))
        self.oracle.reply("engage", {"ok": True, "reason": "none"}, self.now_s)

    def burst(
        self,
        gear: int,
        speed_mps: float = 0.0,
        *,
        parking: int = 0,
        raw_angle: int = 2048,
        taken: int = 5,
        enabled: int = 1,
    ) -> None:
        """The five go out, or the first of them."""
        frames = orders(gear, speed_mps, fine=True)
        bodies = {PARKING_CMD: bytes([1, parking, 0]), STEERING_CMD: b"\x01" + raw_angle.to_bytes(2, "little")}
        on = bytes([enabled])
        sent = []
        for identifier in self.order:
            data = frames[identifier]
            head = on + bodies.get(identifier, data[:3])[1:] + bytes([0, 0, 0, self._counter << 4])
            sent.append((identifier, head + bytes([checksum(head)])))
        self._counter = (self._counter + 1) % 16
        self.oracle.frames(sent, self.now_s, taken=taken, by_guard=False)
        for identifier, data in sent[:taken]:
            self.plant.receive(identifier, data)

    def run(self, seconds: float, each: Callable[[], None]) -> None:
        """Time passes, and each tick this is done."""
        for _ in range(round(seconds * 100)):
            self.now_s += 0.01
            for _ in range(round(0.01 / STEP_S)):
                self.oracle.hears(self.plant.step(), self.now_s)
            self.oracle.motion(self.plant, self.now_s, gateway_lives=True)
            if self.asks:
                self.oracle.requests("drive", {"speed_mps": self.asked_mps}, self.now_s)
            self.oracle.state(self.state, self.now_s)
            each()

    def slow_down(self, ticks: int) -> None:
        """The ramp from 0.5 m/s to zero, and on at zero."""
        for step in range(ticks):
            told_mps = max(0.0, 0.49 - 0.012 * step)
            self.run(0.01, partial(self.burst, GEAR_D, told_mps))

    def silence(self) -> None:
        """Nothing goes out in this tick."""
        self.oracle.frames([], self.now_s, taken=0, by_guard=False)

    def accelerate(self, to_mps: float = 0.5) -> None:
        """Drive as the rules want it, from the parking brake on."""
        self.run(0.2, lambda: self.burst(GEAR_D))
        self.asked_mps = to_mps
        speed_mps = 0.0
        while speed_mps < to_mps:
            speed_mps = min(to_mps, speed_mps + 0.008)
            self.run(0.01, partial(self.burst, GEAR_D, speed_mps))
        self.run(0.5, lambda: self.burst(GEAR_D, to_mps))


def as_it_should_be(stage: Stage) -> None:
    """Up, along and down again, and the parking brake."""
    stage.accelerate()
    stage.asked_mps = 0.0
    stage.slow_down(50)
    stage.run(1.0, lambda: stage.burst(GEAR_D, parking=1))


def yields_twice(stage: Stage) -> None:
    """A stop that is owed begins where no body frame came for 0.2 s, and yields to the remote control again."""
    stage.run(0.2, lambda: stage.burst(GEAR_D, parking=1))
    stage.plant.sticks = (0.0, 0.0)
    stage.run(0.11, lambda: stage.burst(GEAR_D, parking=1))
    stage.run(0.3, stage.silence)
    stage.plant.silent = frozenset({BODY})
    stage.run(0.21, stage.silence)
    stage.run(0.3, lambda: stage.burst(GEAR_D, parking=1))
    stage.plant.silent = frozenset()
    stage.run(0.1, lambda: stage.burst(GEAR_D, parking=1))
    stage.run(0.5, stage.silence)


def found_after_a_crash(stage: Stage) -> None:
    """Another gateway ramps from what it sees: it cannot know the zero on which an earlier stop had ended."""
    stop_latched(stage)
    stage.oracle.all_fail(stage.now_s, stage.now_s)
    stage.plant.found_driving(GEAR_D, 0.3)
    stage.run(0.5, lambda: None)
    stage.oracle.gateway_returns()
    stage.state = {**stage.state, "latched": []}
    stage.burst(GEAR_D, 0.29)


def a_damaged_speed(stage: Stage) -> None:
    """A frame that passes for whole says that the robot moves: it has to stand for a second from there on."""
    stage.run(0.8, lambda: stage.burst(GEAR_D))
    payload = b"\x01" + (280).to_bytes(2, "little") + bytes(4)
    stage.oracle.hears([(DRIVE, payload + bytes([checksum(payload)]))], stage.now_s)
    stage.oracle.motion(stage.plant, stage.now_s, gateway_lives=True)
    stage.run(1.1, lambda: stage.burst(GEAR_D))
    stage.run(0.3, lambda: stage.burst(GEAR_D, parking=1))


def a_damaged_mode(stage: Stage) -> None:
    """A frame that passes for whole says that nobody commands: the stop begins anew, at the angle that is seen."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    for tick in range(40):
        stage.run(0.01, partial(stage.burst, GEAR_D, raw_angle=2048 + 4 * tick))
    payload = bytes([0, 0, 0, 0, 0, STOP, 0])
    stage.oracle.hears([(BODY, payload + bytes([checksum(payload)]))], stage.now_s)
    stage.burst(GEAR_D, parking=1)


def too_fast_unseen(stage: Stage) -> None:
    """Drive and wheels are frozen: no speed is measured that could be over the limit."""
    stage.accelerate()
    stage.plant.frozen = frozenset({DRIVE, WHEELS})
    stage.plant.speed_gain = 3.0
    stage.run(1.6, lambda: stage.burst(GEAR_D, 0.5))


def fails_parked(stage: Stage, slope_deg: float = 5.0) -> None:
    """The parking brake fails before it was released: the rule on rolling applies it, and that is all."""
    stage.plant.brake_grip = 0.0
    stage.plant.slope_deg = stage.plant.slope_target_deg = slope_deg
    stage.run(0.3, lambda: stage.burst(GEAR_N, parking=1))
    stage.state = {**stage.state, "engaged": False, "stop_reason": "rolling", "latched": ["rolling"]}
    stage.oracle.disturb(stage.now_s, 9.0)
    stage.run(3.0, lambda: stage.burst(GEAR_N, parking=1))


def lost_until_it_rests(stage: Stage) -> None:
    """The same, and the hill ends: nothing but rolling resistance is left to bring it to rest."""
    fails_parked(stage)
    stage.plant.slope_deg = stage.plant.slope_target_deg = 0.0
    stage.run(12.0, lambda: stage.burst(GEAR_N, parking=1))


def reset_after_it_rolled(stage: Stage) -> None:
    """The same, and it was chocked and reset: what it rolled before was noticed."""
    fails_parked(stage)
    stage.plant.blocked = True
    stage.run(1.0, lambda: stage.burst(GEAR_N, parking=1))
    stage.state = {**stage.state, "latched": []}
    stage.run(0.5, lambda: stage.burst(GEAR_N, parking=1))


def caught_by_its_brake(stage: Stage) -> None:
    """It is parked while it moves, and then its brake fails: its motor has not brought it to rest."""
    stage.plant.build = replace(stage.plant.build, parks_motor=True)
    stage.accelerate()
    stage.asked_mps = 0.0
    stage.run(0.4, lambda: stage.burst(GEAR_D, parking=1))
    fails_parked(stage)


def bus_away(stage: Stage) -> None:
    """The bus is away, and the robot obeys what it was told last: nobody can tell it to stop before it is back."""
    stage.accelerate()
    stage.oracle.blind(stage.now_s, 2.0)
    stage.oracle.disturb(stage.now_s, 9.0)
    stage.state = {**stage.state, "engaged": False, "stop_reason": "bus_down"}
    stage.run(2.1, stage.silence)
    stage.run(2.0, lambda: stage.burst(GEAR_D, parking=1))


def lamps_are_cut_off(stage: Stage) -> None:
    """For half a second the bus takes a part of each burst, now of this length, then of that: never the lamps."""
    stage.oracle._bytes[LIGHT_CMD] = bytes(8)
    stage.oracle.blind(stage.now_s, 0.5)
    stage.oracle.requests("stop", {}, stage.now_s)
    stage.state = {**stage.state, "engaged": False, "stop_reason": "remote_stop", "latched": ["remote_stop"]}
    stage.run(0.1, lambda: stage.burst(GEAR_D, parking=1))
    stage.oracle.blind(stage.now_s, 0.0)
    stage.run(0.4, lambda: stage.burst(GEAR_D, parking=1))


def slips(stage: Stage) -> None:
    """A brake that slips gives the robot back to its motor."""
    stage.plant.build = replace(stage.plant.build, parks_motor=True)
    stage.run(0.5, lambda: stage.burst(GEAR_D))
    stage.plant.brake_grip = 0.0
    stage.plant.slope_deg = stage.plant.slope_target_deg = 5.0
    stage.oracle.disturb(stage.now_s, 9.0)
    stage.run(0.2, lambda: stage.burst(GEAR_D, parking=1))
    stage.state = {**stage.state, "engaged": False, "stop_reason": "brake_slips", "latched": ["brake_slips"]}


def yields_held_by_its_motor(stage: Stage) -> None:
    """The remote control takes it, and it is reset: the brake would let it roll once it is given back."""
    slips(stage)
    stage.run(1.0, lambda: stage.burst(GEAR_D))
    stage.plant.sticks = (0.0, 0.0)
    stage.run(0.11, lambda: stage.burst(GEAR_D))
    stage.state = {**stage.state, "latched": []}
    stage.run(0.3, stage.silence)


def given_back(stage: Stage, after_s: float, hand: tuple[float, float] | None) -> None:
    """A brake that slips gives the robot back to its motor; after this time it is braked again."""
    slips(stage)
    stage.run(after_s, lambda: stage.burst(GEAR_D))
    stage.plant.hand = hand
    stage.run(0.05, lambda: stage.burst(GEAR_D))
    stage.plant.hand = None
    stage.run(3.0, lambda: stage.burst(GEAR_D, parking=1))


def pushed_for_good(stage: Stage) -> None:
    """Somebody pushes it once its motor has held it: it is braked for good."""
    given_back(stage, 1.0, (-0.5, 2000.0))


def gathers_speed(stage: Stage) -> None:
    """A motor that is hardly enough for it sets the robot going, by 0.07 m/s in a second."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    stage.plant.motor_strength = stage.plant.build.mass_kg * (ROLLING_MPS2 + 0.07) / MOTOR_N
    stage.asked_mps = 0.4
    for tick in range(212):
        stage.run(0.01, partial(stage.burst, GEAR_D, min(0.4, 0.008 * tick)))


def frozen_within_its_lag(stage: Stage) -> None:
    """The speeds are frozen while the command changes by 0.3 m/s for a moment: with its lag it did by less."""
    stage.accelerate(0.3)
    stage.plant.frozen = frozenset({DRIVE, WHEELS})
    stage.asked_mps = 0.62
    for step in range(80):
        stage.run(0.01, partial(stage.burst, GEAR_D, 0.3 + 0.008 * min(step, 80 - step)))
    stage.run(1.5, lambda: stage.burst(GEAR_D, 0.3))


def pushed_off_its_brake(stage: Stage) -> None:
    """Somebody pushes it as it is set going: it is given back to its motor, which cannot hold it against them."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    stage.plant.hand = (-0.6, 2000.0)
    stage.run(0.1, lambda: stage.burst(GEAR_D))
    stage.oracle.requests("stop", {}, stage.now_s)
    stage.state = {**stage.state, "engaged": False, "stop_reason": "brake_slips", "latched": ["brake_slips"]}
    stage.run(0.5, lambda: stage.burst(GEAR_D))


def creeps_unseen(stage: Stage) -> None:
    """Behind its brake it creeps, so slowly that not each 50 ms bring a pulse."""
    stage.run(0.2, lambda: stage.burst(GEAR_N, parking=1))
    stage.plant.build = replace(stage.plant.build, pulses_per_m=200.0)
    stage.plant.brake_creep_mps = 0.02
    stage.plant.slope_deg = stage.plant.slope_target_deg = 3
    stage.run(10.0, lambda: stage.burst(GEAR_N, parking=1))


def creeps_slowly(stage: Stage) -> None:
    """A few pulses in each second show it, too late for its motor to get it back: it is said, and creeps on."""
    stage.run(0.8, lambda: stage.burst(GEAR_D))
    stage.run(0.2, lambda: stage.burst(GEAR_D, parking=1))
    stage.plant.build = replace(stage.plant.build, pulses_per_m=400.0, parks_motor=True)
    stage.plant.brake_creep_mps = 0.03
    stage.plant.slope_deg = stage.plant.slope_target_deg = 3
    stage.run(3.0, lambda: stage.burst(GEAR_D, parking=1))
    stage.state = {**stage.state, "latched": ["rolling"]}
    stage.run(15.0, lambda: stage.burst(GEAR_D, parking=1))


def caught_unheard(stage: Stage) -> None:
    """It rolls while its controller restarts, its brake is asked for then and catches it, and fails afterwards."""
    stage.run(0.5, lambda: stage.burst(GEAR_D))
    stage.plant.build = replace(stage.plant.build, parks_motor=True)
    stage.plant.slope_deg = stage.plant.slope_target_deg = 8.0
    stage.oracle.disturb(stage.now_s, 9.0)
    stage.plant.reboot(0.4)
    stage.oracle.blind(stage.now_s, 0.6)
    stage.run(0.25, lambda: stage.burst(GEAR_D))
    stage.run(0.8, lambda: stage.burst(GEAR_D, parking=1))
    fails_parked(stage, 8.0)


def engaged_after_a_long_stop(stage: Stage) -> None:
    """It was asked for while a gentle ramp of 5 s was under way."""
    stage.oracle._limits = replace(stage.oracle._limits, deceleration_mps2=0.2)
    stage.oracle.requests("engage", {}, stage.now_s)
    stage.run(6.5, lambda: stage.burst(GEAR_D, parking=1))


def given_back_in_vain(stage: Stage) -> None:
    """It stands by its motor, and is given to its brake again all the same."""
    given_back(stage, 1.0, None)


def given_back_too_briefly(stage: Stage) -> None:
    """It is given to its brake again before the motor could hold it."""
    given_back(stage, 0.1, None)


def neutral_unbraked(stage: Stage) -> None:
    """Enabled, neutral, and no parking request."""
    stage.run(0.1, lambda: stage.burst(GEAR_N))


def gear_change_unbraked(stage: Stage) -> None:
    """From drive to reverse without the parking brake."""
    stage.run(0.1, lambda: stage.burst(GEAR_D))
    stage.burst(GEAR_R)


def speed_against_brake(stage: Stage) -> None:
    """A speed and the parking request in one burst."""
    stage.burst(GEAR_D, 0.005, parking=1)


def over_limit(stage: Stage) -> None:
    """A tenth over the limit in force."""
    stage.accelerate(1.1)


def acceleration(stage: Stage) -> None:
    """From zero to 0.1 m/s in a tick."""
    stage.asked_mps = 1.0
    stage.run(0.1, lambda: stage.burst(GEAR_D))
    stage.run(0.05, lambda: stage.burst(GEAR_D, 0.1))


def angle(stage: Stage) -> None:
    """24.6 deg."""
    stage.burst(GEAR_D, raw_angle=2048 + 560)


def steering_rate(stage: Stage) -> None:
    """0.9 deg in a tick."""
    stage.run(0.1, lambda: stage.burst(GEAR_D))
    stage.run(0.01, lambda: stage.burst(GEAR_D, raw_angle=2048 + 20))


def lateral_told(stage: Stage) -> None:
    """Full speed at 22 deg."""
    stage.burst(GEAR_D, 2.0, raw_angle=2048 + 500)


def rises_unasked(stage: Stage) -> None:
    """Up, although nobody has asked for anything for half a second."""
    stage.run(0.1, lambda: stage.burst(GEAR_D))
    stage.asks = False
    stage.run(0.5, lambda: stage.burst(GEAR_D))
    stage.run(0.1, lambda: stage.burst(GEAR_D, 0.006))


def not_falling(stage: Stage) -> None:
    """Zero is asked, and the speed stays."""
    stage.accelerate()
    stage.asked_mps = 0.0
    stage.run(0.3, lambda: stage.burst(GEAR_D, 0.5))


def deadman(stage: Stage) -> None:
    """The operator is silent, and the speed stays."""
    stage.accelerate()
    stage.asks = False
    stage.run(0.7, lambda: stage.burst(GEAR_D, 0.5))


def remote_stop(stage: Stage) -> None:
    """A remote stop comes, and the speed stays."""
    stage.accelerate()
    stage.oracle.requests("stop", {}, stage.now_s)
    stage.run(0.3, lambda: stage.burst(GEAR_D, 0.5))


def roll_back_at_release(stage: Stage) -> None:
    """Neutral on a hill."""
    stage.plant.slope_deg = stage.plant.slope_target_deg = 8
    stage.run(1.5, lambda: stage.burst(GEAR_N))


def rolling_unnoticed(stage: Stage) -> None:
    """The motor dies on a hill, and zero is told on and on."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    stage.plant.motor_strength = 0.0
    stage.plant.slope_deg = stage.plant.slope_target_deg = 8
    stage.run(0.5, lambda: stage.burst(GEAR_D))


def rolling_against(stage: Stage) -> None:
    """Pushed back while told to go forward."""
    stage.accelerate()
    stage.plant.hand = (-0.3, 2000.0)
    stage.run(1.5, lambda: stage.burst(GEAR_D, 0.5))


def pushed(stage: Stage) -> None:
    """Pushed at walking pace at zero command."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    stage.plant.hand = (0.25, 2000.0)
    stage.run(1.0, lambda: stage.burst(GEAR_D))


def steering_unnoticed(stage: Stage) -> None:
    """The steering stays while the told angle goes."""
    stage.plant.stuck = True
    for step in range(100):
        stage.run(0.01, partial(stage.burst, GEAR_D, raw_angle=2048 + min(300, 10 * step)))


def overspeed_unnoticed(stage: Stage) -> None:
    """The chassis drives faster than it is told."""
    stage.plant.speed_gain = 1.6
    stage.accelerate(1.0)
    stage.run(0.5, lambda: stage.burst(GEAR_D, 1.0))


def overspeed_half_seen(stage: Stage) -> None:
    """The same while drive feedback is frozen: the wheels show it."""
    stage.accelerate()
    stage.plant.frozen = frozenset({DRIVE})
    stage.plant.speed_gain = 3.0
    stage.run(1.6, lambda: stage.burst(GEAR_D, 0.5))


def frozen_body_unnoticed(stage: Stage) -> None:
    """The body frame says the same for 3 m."""
    stage.accelerate()
    stage.plant.frozen = frozenset({BODY})
    stage.run(7.0, lambda: stage.burst(GEAR_D, 0.5))


def bumper_unnoticed(stage: Stage) -> None:
    """On into the wall."""
    stage.accelerate()
    stage.plant.touch("front")
    stage.run(1.0, lambda: stage.burst(GEAR_D, 0.5))


def talks_to_remote(stage: Stage) -> None:
    """Twice as often as it may, the remote control is told to stand with its parking brake."""
    stage.plant.sticks = (0.5, 0.0)
    stage.run(0.3, lambda: stage.burst(GEAR_D, parking=1))


def yields_on_and_on(stage: Stage) -> None:
    """Where the remote control was found to have the robot again, it is told so for longer than it may."""
    yields_twice(stage)
    stage.run(0.2, lambda: stage.burst(GEAR_D, parking=1))


def commands_remote(stage: Stage) -> None:
    """The ramp goes on when the body frame has said that the remote control drives."""
    stage.accelerate()
    stage.plant.sticks = (0.5, 0.0)
    stage.run(0.05, lambda: stage.burst(GEAR_D, 0.4))


def left_to_remote(stage: Stage) -> None:
    """The remote control takes over, and half a metre a second is the last that the chassis was told."""
    stage.accelerate()
    stage.plant.sticks = (0.5, 0.0)
    stage.run(0.03, lambda: None)
    stage.burst(GEAR_D, 0.4)
    stage.silence()


def speed_from_standby(stage: Stage) -> None:
    """After half a second without a body frame and without a burst, a stop begins as a ramp."""
    stage.accelerate()
    stage.plant.silent = frozenset({BODY})
    stage.run(0.5, stage.silence)
    stage.burst(GEAR_D, 0.4)


def stop_lies(stage: Stage) -> None:
    """A stop is ok, although the remote control has the robot."""
    stage.plant.sticks = (0.5, 0.0)
    stage.run(0.4, lambda: None)
    assert stage.plant.mode == REMOTE
    stage.oracle.reply("stop", {"ok": True, "reason": "none", "detail": ""}, stage.now_s)
    stage.oracle.requests("stop", {}, stage.now_s)
    stage.run(0.3, lambda: None)
    stage.oracle.reply("stop", {"ok": True, "reason": "none", "detail": ""}, stage.now_s)


def silence_unbraked(stage: Stage) -> None:
    """Enabled, not parked, and then nothing more."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    assert stage.plant.mode == AUTO
    stage.run(0.01, stage.silence)


def no_auto_hold(stage: Stage) -> None:
    """Standing for two seconds on the motor alone."""
    stage.run(2.0, lambda: stage.burst(GEAR_D))


def stop_unfinished(stage: Stage) -> None:
    """A ramp to zero that ends without the parking brake."""
    stage.accelerate()
    stage.oracle.requests("disengage", {}, stage.now_s)
    stage.state = {**stage.state, "engaged": False}
    stage.slow_down(300)


def false_stop(stage: Stage) -> None:
    """A stop that nobody asked for and nothing has caused."""
    stage.accelerate()
    stage.state = {**stage.state, "engaged": False, "stop_reason": "implausible_speed"}
    stage.run(0.02, lambda: stage.burst(GEAR_D, 0.49))


def malformed_frame(stage: Stage) -> None:
    """A counter that jumps."""
    stage.run(0.1, lambda: stage.burst(GEAR_D))
    stage._counter = (stage._counter + 3) % 16
    stage.burst(GEAR_D)


def given_back_fast(stage: Stage) -> None:
    """A first burst with a speed that nobody sees."""
    stage.run(0.2, lambda: stage.burst(GEAR_D, parking=1))
    stage.run(0.5, stage.silence)
    stage.burst(GEAR_D, 0.5)


def not_moving_unnoticed(stage: Stage) -> None:
    """The wheels are held, and half a metre a second is told on and on."""
    stage.plant.blocked = True
    stage.accelerate()
    stage.run(1.5, lambda: stage.burst(GEAR_D, 0.5))


def runs_ahead(stage: Stage) -> None:
    """The wheels are held, and the ramp goes on to 0.9 m/s."""
    stage.plant.blocked = True
    stage.accelerate(0.9)


def frozen_unnoticed(stage: Stage) -> None:
    """All feedback says for ever what it said in the midst of the ramp."""
    stage.accelerate(0.3)
    stage.plant.frozen = frozenset(PERIOD_STEPS)
    stage.asked_mps = 0.7
    for step in range(250):
        stage.run(0.01, partial(stage.burst, GEAR_D, min(0.7, 0.3 + 0.008 * step)))


def frozen_pulses_unnoticed(stage: Stage) -> None:
    """Drive and wheels say zero, and the pulses count."""
    stage.run(0.3, lambda: stage.burst(GEAR_D))
    stage.plant.frozen = frozenset({DRIVE, WHEELS})
    stage.accelerate(0.25)
    stage.run(1.0, lambda: stage.burst(GEAR_D, 0.25))


def frozen_mileage_unnoticed(stage: Stage) -> None:
    """Drive, wheels and pulses say the same, and the mileage counts."""
    stage.run(0.3, lambda: stage.burst(GEAR_D))
    stage.plant.frozen = frozenset({DRIVE, WHEELS, PULSES})
    stage.accelerate(0.25)
    stage.run(14.0, lambda: stage.burst(GEAR_D, 0.25))


def reason_untrue(stage: Stage) -> None:
    """A robot that was pushed is stopped, because it is not seen to move, and it is."""
    stage.accelerate()
    stage.oracle.disturb(stage.now_s, 1.0)
    stage.state = {**stage.state, "engaged": False, "latched": ["not_moving"], "stop_reason": "not_moving"}
    stage.run(0.02, lambda: stage.burst(GEAR_D, 0.49))


def runaway_unbraked(stage: Stage) -> None:
    """The motor dies downhill, and the speed is told on."""
    stage.accelerate()
    stage.plant.motor_strength = 0.0
    stage.plant.slope_deg = stage.plant.slope_target_deg = -15
    stage.run(0.6, lambda: stage.burst(GEAR_D, 0.5))


def stop_latched(stage: Stage) -> None:
    """A stop is latched, carried out and ended."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    stage.oracle.requests("stop", {}, stage.now_s)
    stage.state = {**stage.state, "engaged": False, "stop_reason": "remote_stop", "latched": ["remote_stop"]}
    stage.run(1.0, lambda: stage.burst(GEAR_D, parking=1))
    stage.run(0.5, lambda: stage.burst(GEAR_N, parking=1, enabled=0))
    stage.run(0.01, stage.silence)


def latched_unbraked(stage: Stage) -> None:
    """The remote control gives a latched robot back without its parking brake, and nothing is told."""
    stop_latched(stage)
    stage.plant.sticks = (0.0, 0.0)
    stage.run(0.5, stage.silence)
    stage.plant.sticks = None
    stage.run(2.0, stage.silence)


def brake_unnoticed(stage: Stage) -> None:
    """The parking brake reads applied, and the robot slips away."""
    stage.run(0.2, lambda: stage.burst(GEAR_N, parking=1))
    stage.plant.brake_grip = 0.0
    stage.plant.slope_deg = stage.plant.slope_target_deg = 3
    stage.run(1.2, lambda: stage.burst(GEAR_N, parking=1))


def yields_unbraked(stage: Stage) -> None:
    """The remote control takes a robot whose brake is as good as any, and is left without it."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    stage.plant.sticks = (0.0, 0.0)
    stage.run(0.11, lambda: stage.burst(GEAR_D))


def brake_slips(stage: Stage) -> None:
    """It stood by its motor, creeps so fast that each frame has a pulse, is latched, and goes on."""
    stage.run(0.2, lambda: stage.burst(GEAR_D))
    stage.run(0.2, lambda: stage.burst(GEAR_D, parking=1))
    stage.run(0.2, lambda: stage.burst(GEAR_N, parking=1))
    stage.state = {**stage.state, "latched": ["rolling"]}
    stage.plant.brake_creep_mps = 0.03
    stage.plant.slope_deg = stage.plant.slope_target_deg = 3
    stage.oracle.requests("stop", {}, stage.now_s)
    stage.state = {**stage.state, "engaged": False, "stop_reason": "remote_stop", "latched": ["remote_stop"]}
    stage.run(17.0, lambda: stage.burst(GEAR_N, parking=1))


def stands_untrue(stage: Stage) -> None:
    """A stop says that the robot stands, and it does not."""
    stage.accelerate()
    reply = {"ok": True, "reason": "none", "detail": "the robot stands, and its parking brake is applied"}
    stage.oracle.reply("stop", reply, stage.now_s)


def usual_order(stage: Stage) -> None:
    """The bus took a part of a burst, and the brake is the last word of the next one again."""
    stage.run(0.1, lambda: stage.burst(GEAR_D, parking=1))
    stage.run(0.01, lambda: stage.burst(GEAR_D, parking=1, taken=3))
    stage.burst(GEAR_D, parking=1)


def second_order(stage: Stage) -> None:
    """The parking brake comes second for no reason."""
    stage.run(0.1, lambda: stage.burst(GEAR_D, parking=1))
    stage.order = (DRIVE_CMD, PARKING_CMD, GEAR_CMD, STEERING_CMD, BRAKING_CMD)
    stage.burst(GEAR_D, parking=1)


def not_latched(stage: Stage) -> None:
    """Gateway and guard were gone, the robot moved, and that is no matter."""
    stage.oracle.all_fail(stage.now_s, stage.now_s + 1.0)
    stage.oracle.expect_latched(stage.now_s + 2.0, "found_moving_not_latched")


def does_not_move(stage: Stage) -> None:
    """Parked on, whatever is asked."""
    stage.asked_mps = 0.5
    stage.run(4.0, lambda: stage.burst(GEAR_D, parking=1))


def no_hazard(stage: Stage) -> None:
    """A latched stop whose frames leave the lamps alone."""
    stage.accelerate()
    stage.oracle.requests("stop", {}, stage.now_s)
    stage.state = {**stage.state, "engaged": False, "latched": ["remote_stop"]}
    stage.slow_down(50)


def idle_engaged(stage: Stage) -> None:
    """Engaged for longer than it may be without a speed asked for."""
    stage.oracle._limits = replace(stage.oracle._limits, idle_s=1.0)
    stage.run(1.5, lambda: stage.burst(GEAR_D, parking=1))


def unwarned(stage: Stage) -> None:
    """A speed before people were warned for as long as it is set."""
    stage.oracle._limits = replace(stage.oracle._limits, warning_s=2.0)
    stage.accelerate()


BREAKS: dict[Callable[[Stage], None], str] = {
    neutral_unbraked: "neutral_unbraked",
    gear_change_unbraked: "gear_change_unbraked",
    speed_against_brake: "speed_against_brake",
    over_limit: "over_limit",
    acceleration: "acceleration",
    angle: "angle",
    steering_rate: "steering_rate",
    lateral_told: "lateral_told",
    rises_unasked: "rises_unasked",
    not_falling: "not_falling",
    deadman: "not_falling",
    remote_stop: "not_falling",
    roll_back_at_release: "roll_back_at_release",
    rolling_unnoticed: "rolling_unnoticed",
    rolling_against: "rolling_against",
    pushed: "rolling_unnoticed",
    steering_unnoticed: "steering_unnoticed",
    overspeed_unnoticed: "overspeed_unnoticed",
    overspeed_half_seen: "overspeed_unnoticed",
    frozen_body_unnoticed: "frozen_body_unnoticed",
    bumper_unnoticed: "bumper_unnoticed",
    talks_to_remote: "talks_to_remote",
    yields_on_and_on: "talks_to_remote",
    stop_lies: "stop_lies",
    silence_unbraked: "silence_unbraked",
    no_auto_hold: "no_auto_hold",
    stop_unfinished: "stop_unfinished",
    false_stop: "false_stop",
    malformed_frame: "malformed_frame",
    given_back_fast: "given_back_fast",
    does_not_move: "does_not_move",
    no_hazard: "no_hazard",
    idle_engaged: "idle_engaged",
    unwarned: "unwarned",
    commands_remote: "commands_remote",
    yields_unbraked: "commands_remote",
    left_to_remote: "left_to_remote",
    speed_from_standby: "speed_from_standby",
    not_moving_unnoticed: "not_moving_unnoticed",
    runs_ahead: "runs_ahead",
    frozen_unnoticed: "frozen_unnoticed",
    frozen_pulses_unnoticed: "frozen_pulses_unnoticed",
    frozen_mileage_unnoticed: "frozen_mileage_unnoticed",
    reason_untrue: "reason_untrue",
    runaway_unbraked: "runaway_unbraked",
    brake_unnoticed: "brake_unnoticed",
    latched_unbraked: "latched_unbraked",
    brake_slips: "roll_back_at_stop",
    given_back_in_vain: "roll_back_at_stop",
    given_back_too_briefly: "roll_back_at_stop",
    stands_untrue: "stands_untrue",
    usual_order: "burst_order",
    second_order: "burst_order",
    not_latched: "found_moving_not_latched",
}


KEEPS: list[Callable[[Stage], None]] = [
    as_it_should_be,
    yields_twice,
    found_after_a_crash,
    a_damaged_speed,
    a_damaged_mode,
    too_fast_unseen,
    fails_parked,
    pushed_for_good,
    lost_until_it_rests,
    reset_after_it_rolled,
    caught_by_its_brake,
    bus_away,
    lamps_are_cut_off,
    yields_held_by_its_motor,
    gathers_speed,
    frozen_within_its_lag,
    pushed_off_its_brake,
    creeps_unseen,
    creeps_slowly,
    caught_unheard,
    engaged_after_a_long_stop,
]


@pytest.mark.parametrize("keeps", KEEPS, ids=lambda case: case.__name__)
def test_a_drive_by_the_rules_breaks_none(keeps: Callable[[Stage], None]) -> None:
    """Nothing is found where nothing is wrong."""
    stage = Stage()
    stage.oracle._bytes[LIGHT_CMD] = bytes([0, 1, 1, 0, 0, 0, 0, 0])
    keeps(stage)
    assert stage.oracle.violations == {}


@pytest.mark.parametrize(("breaks", "kind"), BREAKS.items(), ids=lambda case: getattr(case, "__name__", ""))
def test_each_broken_rule_is_found(breaks: Callable[[Stage], None], kind: str) -> None:
    """What breaks a rule is found under that rule's name."""
    stage = Stage()
    breaks(stage)
    assert kind in stage.oracle.violations, stage.oracle.violations

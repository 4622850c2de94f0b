"""The table "Command rules" of the design, as a judge of the robot's motion and the bytes on the bus.

Judged are the plant's true motion and the frames; of the gateway's words only replies and latches. A rule's time
counts from the moment at which the cause shows on the bus, with the margin ``SEEING_S``: a 50 ms frame, one of
them lost, and a tick.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf, radians, sqrt, tan
from operator import sub
from typing import Any, Final

import msgspec

from schemas.settings import CREEP_PULSES, CommandSettings
from tests.system.scenarios.heard import NOT_YET_S, Heard
from tests.system.scenarios.plant import (
    AUTO,
    BODY,
    DRIVE,
    DRIVE_CMD,
    GEAR_CMD,
    GEAR_N,
    LIGHT_CMD,
    MOTION_CMDS,
    PARKING,
    PARKING_CMD,
    PARKING_MPS2,
    PULSES,
    REMOTE,
    SIGN,
    STEERING,
    STOP,
    WHEELBASE_M,
    WHEELS,
    CanFrame,
    Plant,
    Told,
    checksum,
    told,
)

TICK_S: Final = 0.01
SEEING_S: Final = 0.15
BELIEVED_MPS: Final = 3.0  # speed feedback above this is not believed
STANDSTILL_MPS: Final = 0.05
MOVES_MPS: Final = 0.1  # certainly seen to move: the standstill bound and a coarse bit
MOTOR_HOLDS_S: Final = 0.3  # a robot given back to its motor that is faster after this time is braked for good
ANGLE_BIT_DEG: Final = 0.044
GUARD_BRAKE_S: Final = 1.0  # the guard waits so long at zero commanded speed for the robot to stand
PULSES_S: Final = 0.85  # delay with which pulses of unknown length show the direction: 17 frames
PAUSE_S: Final = 0.1  # after a silence of this length a burst is not compared with the one before
RETURNS_S: Final = 0.5  # from the robot's return to the gateway until its motion is judged again
GUARD_S: Final = 0.1
RELEASE_M, STOP_M = 0.10, 0.30
UNSTARTED_M: Final = 0.10
UNTRUE_SPEED: Final = frozenset({"not_moving", "feedback_frozen"})
LATCHING: Final = UNTRUE_SPEED | {"rolling", "remote_stop", "front_bumper", "rear_bumper", "implausible_speed"}
# Commanded above the first and seen below the second; seen below the third while pulses or mileage count.
TOLD_MPS, STANDS_MPS, FROZEN_MPS, FROZEN_TOLD_MPS = 0.3, 0.15, 0.05, 0.1
GATHERS_MPS: Final = 0.06  # a robot faster by this than a second before is under way
# Lead of a rising command over the seen speed: the greater of this and of so long a ramp.
LEAD_MPS, LEAD_S = 0.5, 0.6
# The rise is that of 0.2 s, less two frames by which the seen speed may be old at either end.
RUNAWAY_MPS, RUNAWAY_RISE_MPS, RISE_S = 0.3, 0.08, 0.16
ABSURD_MPS: Final = 3.0  # the chassis drives 8 km/h at most: a higher reading is a fault
YIELDS: Final = 10  # bursts that may follow a takeover
# First frames of a burst; the second after one that went out in part.
USUAL, BRAKE_FIRST = (DRIVE_CMD, GEAR_CMD), (DRIVE_CMD, PARKING_CMD)
LOOSE_S: Final = 1.0  # the longest that a latched robot stands without its parking brake and without commands
STUCK_DEG: Final = 6.5  # 5 deg, with noise and a bit
SLOW_STEERING_S: Final = 0.25

LAGGING_S, LAGGING_MPS2 = 0.4, 0.8  # the slowest drive that a gateway has to allow for: its lag and deceleration
# With a smaller margin the motor cannot follow the ramps down this hill, and a stop is justified.
FOLLOWS_MPS2: Final = 0.3
PULSES_EVERY_S: Final = 0.05
# Timers of what is judged only while the robot is commanded.
SUPERVISION: Final = (
    *("roll1.0", "roll-1.0", "dies1.0", "dies-1.0", "stuck", "fast", "lateral", "drive", "brake"),
    *("stands", "frozen", "pulses", "mileage"),
)
Fields = dict[str, Any]


class Violation(msgspec.Struct, frozen=True):
    kind: str
    at_s: float
    detail: str


class Since:
    """How long a condition has held."""

    def __init__(self) -> None:
        self._from_s: float | None = None

    def lasts(self, now_s: float, *, holds: bool) -> float:
        """Seconds for which it has held without a break; 0 if it does not."""
        if not holds:
            self._from_s = None
            return 0.0
        if self._from_s is None:
            self._from_s = now_s
        return now_s - self._from_s


class Trust:
    """Notices that the rules leave a robot to its parking brake, even if that does not hold.

    That is so in four cases: it was parked for as long as it is commanded, its stop began in standby, it moved
    when its brake was requested, or it was given back to its motor and was faster 300 ms later. Otherwise its
    motor gets it.

    Attributes:
        is_left: the last burst has the parking request, in one of these cases.
        is_lost: it is left to a brake that does not hold it, and the motor is off; until it rests.
    """

    def __init__(self) -> None:
        self.is_lost = False
        self.is_left = self._is_stray = self._is_unreleased = self._is_for_good = self._is_caught = False
        self._before: Told | None = None
        self._given_back_s: float | None = None

    def begin(self, *, is_kept: bool) -> None:
        """A command after silence or engagement. A robot that its motor holds for a slipping brake stays so."""
        self._is_stray = self._is_unreleased = not is_kept
        self._before = None

    def believe(self) -> None:
        """A reset gives the robot to its brake again, which may hold no better than before."""
        self._is_for_good, self._given_back_s = True, None

    @property
    def is_given_back(self) -> bool:
        """In this stop the robot was given back to its motor, and to nothing else since."""
        return self._given_back_s is not None

    def tell(self, order: Told, now_s: float, *, is_permitted: bool, is_moving: bool, is_away: bool) -> None:
        """A command. A controller that restarts forgets its brake, and what its motor did."""
        if order.parking and (self._before is None or not self._before.parking):
            self._is_caught = is_moving and not self.is_given_back
        self._is_caught |= order.parking and is_away
        self._is_stray &= not is_permitted
        self._is_unreleased &= order.parking
        if is_permitted:
            self._given_back_s, self._is_for_good = None, False
        elif self._before is not None and self._before.parking and not order.parking:
            self._given_back_s = now_s
        elif order.parking and self._given_back_s is not None:
            self._is_for_good |= is_moving and now_s - self._given_back_s > MOTOR_HOLDS_S - TICK_S
            self._given_back_s = None
        is_untried = self._is_stray or self._is_unreleased or self._is_caught
        self.is_left = order.parking and (is_untried or self._is_for_good)
        self._before = order

    def look(self, plant: Plant) -> None:
        """The robot's state now."""
        is_off = plant.build.parks_motor or plant.gear not in SIGN
        rolls_on = self.is_lost and plant.speed_mps != 0
        self.is_lost = self.is_left and is_off and (rolls_on or not plant.brake_holds)


class Oracle:
    """Judges a scenario.

    Attributes:
        violations: the first of each kind.
        is_damaged: a damaged frame may be a cause to stop now.
        finds_variant: the gateway has to find the scale of the speeds, and forgets it with the bus.
        was_driven_m: metres travelled, to notice a suite in which nothing moves.
    """

    def __init__(self, limits: CommandSettings, *, fine: bool, is_undisturbed: bool, lag_s: float) -> None:
        self.violations: dict[str, Violation] = {}
        self.stops = 0
        self.was_driven_m = 0.0
        self._limits = limits
        self._fine = fine
        self._bit_mps = 0.001 if fine else 0.04
        self._is_undisturbed, self.finds_variant = is_undisturbed, False
        self._lag_s = lag_s
        # What is asked.
        self._asked_mps, self._asked_s = 0.0, -9.0
        self._zero_since_s = self._engaged_s = self._lagging_mps = self._counted_m = self._latched_s = 0.0
        self._is_permitted = self._was_engaged = False
        self._engage_asked_s: float | None = None
        self._cause_s: float | None = None
        self._cause, self._emergency = "", False
        self._latched: list[str] = []
        # What is told.
        self._order: Told | None = None
        self._order_s = self._begun_s = -9.0
        self._is_guards = self._was_auto = False
        self._trust = Trust()
        self._bytes: dict[int, bytes] = {}
        self._counters: dict[int, int] = {}
        self._ceiling_mps = 0.0
        self._excess_s: float | None = None
        self._excess_mps, self._excess_rate = 0.0, self._falls_mps2(at_once=False)
        # What happens.
        self._plant: Plant | None = None
        self._excused_until_s = self._blind_until_s = 0.0
        self.is_damaged: Callable[[], bool] = lambda: False
        self._was_excused = False
        self._heard = Heard(fine=fine)
        self._yields, self._begins_unknown = 0, False
        self._was_cut: bool | None = False
        self._lately: deque[tuple[float, ...]] = deque([(0.0, 0.0, 0.0, 0.0)] * 100, round(1 / TICK_S))
        self._told_range: tuple[tuple[float, ...], ...] = ((0.0, 0.0),) * 2
        self._disturbed_until_s, self._frozen_wheels_s, self._latched_m = -9.0, -9.0, inf
        self._left_mps: float | None = None
        self._remote = Since()
        self._rest_m: float | None = None
        self._rest_sign, self._rest_is_stop = 0.0, False
        self._rest_bound_m = self._start_bound_m = self._seen_mps = 0.0
        self._best_m: float | None = None
        self._asked_sign = 0.0
        self._stop_record: tuple[float, float, float, float] | None = None
        self._left_deg = self._right_deg = 0.0
        self._explained = {1.0: 0.0, -1.0: 0.0}
        self._frozen_m: float | None = None
        self._struck: str | None = None
        self._struck_s = self._clear_s = self._pressed_s = -9.0
        self._acknowledged = self._is_unsure = False
        self._timers: dict[str, Since] = {}
        self._gateway_lives = True

    # What reaches it.

    def requests(self, verb: str, fields: Fields, now_s: float) -> None:
        if verb == "drive":
            speed_mps = fields["speed_mps"]
            if speed_mps and not self._asked_mps:
                self._zero_since_s = now_s
            if not speed_mps and self._asked_mps:
                self._zero_since_s = now_s
            self._asked_mps, self._asked_s = speed_mps, now_s
        elif verb == "engage" and self._engage_asked_s is None:
            self._engage_asked_s = now_s
        elif verb in {"stop", "disengage"}:
            self._cause_stop(verb, now_s, at_once=verb == "stop")

    def reply(self, verb: str, fields: Fields, now_s: float) -> None:
        plant = self._plant
        if verb == "engage" and fields["ok"]:
            self._is_permitted, self._cause_s, self._emergency = True, None, False
            self._engage_asked_s = None
            self._trust.begin(is_kept=False)
            self._asked_s = self._engaged_s = now_s
            self._rest_m, self._rest_sign, self._rest_is_stop, self._rest_bound_m = None, 0.0, False, 0.0
        elif verb == "park" and plant is not None:
            standing = self._was_engaged and self._is_permitted and now_s - self._zero_since_s > 0.1
            if not fields["ok"] and standing and not self._asked_mps and fields["reason"] != "not_engaged":
                self._fail("park_refused", now_s, f"{fields['reason']} at {plant.speed_mps:.2f} m/s")
        elif (
            verb == "stop" and plant is not None and self._claims_rest(fields) and abs(plant.speed_mps) > MOVES_MPS
        ):
            self._fail("stands_untrue", now_s, f"{plant.speed_mps:.2f} m/s, and: {fields['detail']}")
        elif verb == "stop" and self._remote.lasts(now_s, holds=self._is_remote(now_s)) > 0.2:
            if fields["ok"] and not fields["detail"]:
                self._fail("stop_lies", now_s, "ok alone, while the remote control has the robot")
        elif verb == "reset" and fields["ok"]:
            # A hit of the very moment of the reset may have been seen before it, or after.
            self._acknowledged = self._struck is not None
            if "brake_slips" in self._latched:
                # It stood braked for 5 s: its brake is believed again.
                self._trust.believe()
            self._emergency = False
            self._is_unsure = self._is_unsure or now_s - self._struck_s < SEEING_S

    def state(self, state: Fields, now_s: float) -> None:
        latched = state["latched"]
        is_new = self._struck in latched and self._struck not in self._latched
        if self._acknowledged and is_new and not self._is_unsure:
            self._fail("bumper_relatched", now_s, f"{self._struck} again, while acknowledged")
        self._latched = latched
        self._latched_s = self._timer("latched").lasts(now_s, holds=bool(latched))
        if state["engaged"]:
            self._was_engaged = True
        elif self._was_engaged:
            self._was_engaged = False
            self.stops += 1
            if self._cause_s is None:
                self._find_cause(state, now_s)
            self._begin_stop(now_s)

    def hears(self, frames: list[CanFrame], now_s: float) -> None:
        self._heard.receive(frames, now_s)

    def frames(self, burst: list[CanFrame], now_s: float, *, taken: int, by_guard: bool) -> None:
        if not burst:
            self._judge_silence(now_s)
            return
        frames = burst[:taken]
        self._judge_parts(burst, taken, now_s)
        # The guard goes on with the gateway's counters; a gateway that comes back begins with its own.
        comes_back = self._is_guards and not by_guard
        goes_on = now_s - self._order_s < PAUSE_S and not comes_back
        self._is_guards = by_guard
        for identifier, data in frames:
            counter = data[6] >> 4
            expected = self._counters.get(identifier, counter) if goes_on else counter
            self._counters[identifier] = (counter + 1) % 16
            if data[7] != checksum(data) or counter != expected:
                self._fail("malformed_frame", now_s, f"{identifier:08X} {data.hex()}, counter {expected} is due")
            self._bytes[identifier] = data
        if set(MOTION_CMDS) <= {identifier for identifier, _ in frames}:
            self._judge_order(told(self._bytes, fine=self._fine), now_s)
            self._judge_hazard(now_s, is_due=by_guard or (bool(self._latched) and not self._is_permitted))
        elif frames and set(MOTION_CMDS) <= self._bytes.keys():
            self._order, self._order_s = told(self._bytes, fine=self._fine), now_s
        if frames and self._order is not None and not by_guard:
            self._left_mps = self._order.speed_mps

    def motion(self, plant: Plant, now_s: float, *, gateway_lives: bool) -> None:
        self._plant = plant
        self._gateway_lives = gateway_lives
        self.was_driven_m += abs(plant.speed_mps) * TICK_S
        # With the robot in other hands, its controller away or its brakes out of ours, physics sets no bound that
        # the gateway could keep: only what is told is judged, and its motion anew from half a second after.
        if plant.hand or plant.sticks or plant.is_away or plant.button:
            self._excused_until_s = max(self._excused_until_s, now_s + RETURNS_S)
        if not plant.can_hold or not self._follows(plant):
            self.disturb(now_s, 3.0)
        if not plant.can_hold and not plant.brake_holds:
            # Nothing can.
            self._excused_until_s = max(self._excused_until_s, now_s + RETURNS_S)
        self._trust.look(plant)
        self._expect_deadman(now_s)
        if self._is_permitted and self._idle_s(now_s) > SEEING_S:
            self._fail("idle_engaged", now_s, f"engaged, and asked for nothing since {self._zero_since_s:.1f} s")
        is_back = self._was_excused and now_s >= self._excused_until_s
        if is_back and not self._is_permitted and (plant.speed_mps or plant.mode == AUTO):
            # Back in our hands, and maybe moving: from here on it is a stop like any other.
            self._begin_stop(now_s)
        self._was_excused = now_s < self._excused_until_s
        told_mps = 0.0 if self._order is None else self._order.signed_mps
        self._lagging_mps += (told_mps - self._lagging_mps) * TICK_S / LAGGING_S
        self._lately.append((told_mps, plant.speed_mps, self._heard.speed_mps, self._lagging_mps))
        self._judge_remote(plant, now_s)
        self._judge_roll_back(plant, now_s)
        self._judge_stop(plant, now_s)
        self._judge_supervision(plant, now_s)
        self._judge_bumpers(plant, now_s)
        self._judge_service(plant, now_s)
        self._seen_mps = max(abs(plant.speed_mps), self._seen_mps - 1.0 * TICK_S)

    def disturb(self, now_s: float, lasts_s: float) -> None:
        """A disturbance, which may show for so long: a stop meanwhile has a cause."""
        self._disturbed_until_s = max(self._disturbed_until_s, now_s + lasts_s)

    def touch(self, now_s: float) -> None:
        """Another obstacle: a hit of it is new, unless the bumper still reads hit."""
        if now_s - self._pressed_s > 0.3 + SEEING_S:
            self._struck, self._acknowledged = None, False
        else:
            self._is_unsure = True

    def blind(self, now_s: float, lasts_s: float) -> None:
        """The bus loses so many frames for this long that nothing is seen in time."""
        self._blind_until_s = max(self._blind_until_s, now_s + lasts_s)
        self._excused_until_s = max(self._excused_until_s, self._blind_until_s + RETURNS_S)

    @staticmethod
    def _claims_rest(reply: Fields) -> bool:
        return bool(reply["ok"] and "stands" in reply["detail"] and "not confirmed" not in reply["detail"])

    # The bytes.

    def _judge_parts(self, burst: list[CanFrame], taken: int, now_s: float) -> None:
        """Zero speed and the parking brake come first where the burst before went out in part."""
        motion = tuple(identifier for identifier, _ in burst if identifier in MOTION_CMDS)
        if set(motion) != set(MOTION_CMDS):
            return
        order = told(dict(burst), fine=self._fine)
        if order.enabled and now_s - self._order_s < PAUSE_S and self._was_cut is not None:
            due = BRAKE_FIRST if self._was_cut and not order.speed_mps else USUAL
            if motion[:2] != due:
                names = " ".join(f"{identifier:08X}" for identifier in motion)
                self._fail("burst_order", now_s, f"{names}, {'' if self._was_cut else 'not '}after a part of one")
        # Where all of the five were taken or none of the burst, both orders may be right.
        is_part = 0 < taken < len(MOTION_CMDS)
        self._was_cut = True if is_part else False if taken == len(burst) else None

    def _judge_order(self, order: Told, now_s: float) -> None:
        limits = self._limits
        before = self._order if now_s - self._order_s < PAUSE_S else None
        gap_s = max(now_s - self._order_s, TICK_S / 2)
        lateral_mps2 = order.speed_mps**2 * tan(radians(abs(order.angle_deg))) / WHEELBASE_M
        last = order if before is None else before
        # Out of auto it obeys nobody: a stop begins anew, with the gear and at the angle that are seen.
        is_auto = order.enabled and self._plant is not None and self._plant.mode == AUTO and self._heard.reads_auto
        obeys = is_auto and last.enabled and self._was_auto
        shifts = obeys and order.gear != last.gear
        allowed_mps2 = limits.lateral_acceleration_mps2 + 0.03 + 2 * order.speed_mps * self._bit_mps
        turned_deg = abs(order.angle_deg - last.angle_deg)
        turns_deg = limits.steering_rate_degps * max(gap_s, TICK_S) + 2 * ANGLE_BIT_DEG
        broken = {
            "partly_enabled": order.any_enabled != order.enabled,
            "neutral_unbraked": order.enabled and order.gear == GEAR_N and not order.parking,
            "gear_change_unbraked": shifts and not (order.parking and last.parking),
            "gear_reserved": order.gear not in {*SIGN, GEAR_N},
            "speed_against_brake": order.speed_mps > 0 and order.parking,
            "unwarned": self._is_permitted
            and order.speed_mps > 0
            and now_s - self._engaged_s < limits.warning_s - SEEING_S,
            "over_limit": order.speed_mps > limits.speed_limit_mps + self._bit_mps / 2,
            "angle": abs(order.angle_deg) > limits.steering_limit_deg + ANGLE_BIT_DEG,
            "steering_rate": obeys and turned_deg > turns_deg,
            "lateral_told": lateral_mps2 > allowed_mps2,
        }
        for kind, is_broken in broken.items():
            if is_broken:
                self._fail(kind, now_s, f"{_brief(order)}; before {_brief(last)}")
        self._judge_speed(order, before, gap_s, now_s)
        in_stop = self._plant is not None and self._mode(self._plant) == STOP and not self._plant.is_away
        if self._timer("stop").lasts(now_s, holds=in_stop and order.speed_mps > 0) > SEEING_S:
            self._fail("speed_in_mode_stop", now_s, f"{order.speed_mps:.2f} m/s")
        self._judge_yield(order, last, now_s, begins=before is None)
        if before is None:
            is_kept = "brake_slips" in self._latched and self._order is not None and not self._order.parking
            self._trust.begin(is_kept=is_kept)
            self._begun_s = now_s
        is_moving, is_away = self._heard.greatest_mps(now_s) > STANDSTILL_MPS, False
        if self._plant is not None:
            # Its speed may be frozen, or nothing may be heard of it. In mode stop it has no motor.
            is_moving |= abs(self._plant.speed_mps) > STANDSTILL_MPS or self._plant.mode == STOP
            is_away = self._plant.is_away
        self._trust.tell(order, now_s, is_permitted=self._is_permitted, is_moving=is_moving, is_away=is_away)
        self._order, self._order_s, self._was_auto = order, now_s, is_auto

    @property
    def _is_kept_by_motor(self) -> bool:
        """The motor alone holds it, since its parking brake slips: whoever takes over, that is not requested."""
        return self._trust.is_given_back  # Once the remote control has it, its latch may be reset.

    def _judge_yield(self, order: Told, last: Told, now_s: float, *, begins: bool) -> None:
        """The remote control gets zero speed with the parking brake a few times, and no other command."""
        if begins:
            self._begins_unknown = not self._heard.is_ours(now_s) and not self._is_guards
        elif self._was_engaged:
            self._begins_unknown = False
        if self._begins_unknown and order.speed_mps:
            self._fail("speed_from_standby", now_s, f"{_brief(order)}, and the mode is remote or unknown")
        is_unknown = self._heard.may_be_unknown(now_s)
        if self._heard.remote_s == NOT_YET_S or is_unknown:
            # Where it is found to have the robot again, what was begun meanwhile yields to it.
            self._yields = 0
        if now_s - self._heard.remote_s < 1.5 * TICK_S or is_unknown or self.is_damaged():
            return  # A stop that is owed goes on while nobody knows who has the robot.
        self._yields += 1
        if self._yields > YIELDS:
            self._fail("talks_to_remote", now_s, f"burst {self._yields} since the remote control has the robot")
        is_held = order.parking or self._is_kept_by_motor
        if order.speed_mps or not is_held or (order.enabled and order.gear != last.gear):
            self._fail("commands_remote", now_s, f"{_brief(order)}; before {_brief(last)}")

    def _judge_speed(self, order: Told, before: Told | None, gap_s: float, now_s: float) -> None:
        """The speed never rises without leave, never changes faster than the ramps, and falls when it must."""
        speed_mps, bit_mps = order.speed_mps, self._bit_mps
        before_mps = before.speed_mps if before is not None and before.gear == order.gear else 0.0
        is_fresh = self._is_permitted and now_s - self._asked_s <= self._limits.deadman_s + 0.02
        same_way = self._asked_mps * order.signed_mps > 0
        goal_mps = abs(self._asked_mps) if is_fresh and same_way and self._cause_s is None else 0.0
        if before is not None and speed_mps > before_mps + 1e-9:
            if not is_fresh:
                self._fail("rises_unasked", now_s, f"{before_mps:.3f} to {speed_mps:.3f} m/s, nobody asks")
            elif self._cause_s is not None and now_s - self._cause_s > 0.02:
                self._fail("resumes", now_s, f"{before_mps:.3f} to {speed_mps:.3f} m/s after {self._cause}")
            elif speed_mps > goal_mps + bit_mps and now_s - self._zero_since_s > 0.03:
                self._fail("rises_unasked", now_s, f"to {speed_mps:.3f} m/s, asked {self._asked_mps:.3f}")
        if before is not None and self._is_permitted:
            self._ceiling_mps += self._limits.acceleration_mps2 * gap_s
            if speed_mps > self._ceiling_mps + bit_mps + 0.002:
                self._fail("acceleration", now_s, f"{speed_mps:.3f} m/s, at most {self._ceiling_mps:.3f}")
        ahead_mps = max(LEAD_MPS, LEAD_S * self._limits.acceleration_mps2) + self._limits.acceleration_mps2 * gap_s
        seen_mps = self._heard.greatest_mps(now_s)
        is_ahead = speed_mps > seen_mps + ahead_mps + self._bit_mps and now_s >= self._blind_until_s
        if before is not None and speed_mps > before_mps + 1e-9 and is_ahead:
            self._fail("runs_ahead", now_s, f"told {speed_mps:.2f} m/s, seen {seen_mps:.2f}")
        self._ceiling_mps = min(self._ceiling_mps, speed_mps) if before is not None else speed_mps
        if before is None and speed_mps:
            # A burst after a silence begins where the chassis was left, or by what is seen.
            most = self._seen_mps + 0.05 if self._left_mps is None else min(self._seen_mps + 0.05, self._left_mps)
            if speed_mps > most + bit_mps + 0.02:
                left = "" if self._left_mps is None else f", left on {self._left_mps:.2f}"
                self._fail("given_back_fast", now_s, f"told {speed_mps:.2f}{left}, seen {self._seen_mps:.2f}")
        self._judge_fall(speed_mps, goal_mps, now_s, begins=before is None)

    def _judge_fall(self, speed_mps: float, goal_mps: float, now_s: float, *, begins: bool) -> None:
        rate = self._falls_mps2(at_once=self._emergency)
        if begins:
            self._excess_s = None
        if speed_mps <= goal_mps + self._bit_mps:
            self._excess_s = None
            return
        if self._excess_s is None or rate != self._excess_rate:
            self._excess_s, self._excess_mps, self._excess_rate = now_s, speed_mps, rate
        grace_s = 0.03 + (self._limits.deadman_s if not self._is_permitted and self._cause_s is None else 0.0)
        most_mps = max(goal_mps, self._excess_mps - rate * max(0.0, now_s - self._excess_s - grace_s))
        if speed_mps > most_mps + self._bit_mps + 0.02:
            why = self._cause or f"asked {self._asked_mps:.2f}"
            self._fail("not_falling", now_s, f"{speed_mps:.2f} m/s, at most {most_mps:.2f} after {why}")

    def _judge_silence(self, now_s: float) -> None:
        """Output has ceased in this tick: the last command must be a completed stop."""
        order, plant = self._order, self._plant
        if order is None or plant is None or now_s - self._order_s > TICK_S * 1.5 or self._is_guards:
            return
        if not self._gateway_lives:
            return
        is_yielded = self._heard.remote_s != NOT_YET_S and not self.is_damaged()
        is_held = order.parking or self._trust.is_given_back
        if is_yielded and order.enabled and (order.speed_mps or not is_held):
            self._fail("left_to_remote", now_s, f"the last word is {_brief(order)}")
        is_true = self._is_reachable(now_s) and not self.is_damaged()
        if plant.mode == AUTO and order.enabled and not order.parking and is_true:
            self._fail("silence_unbraked", now_s, f"enabled and no parking request at {plant.speed_mps:.2f} m/s")

    # The causes of stops.

    def _cause_stop(self, cause: str, now_s: float, *, at_once: bool) -> None:
        self._emergency = self._emergency or at_once
        if self._cause_s is None:
            self._cause_s, self._cause = now_s, cause
        self._is_permitted = False

    def gateway_fails(self, now_s: float) -> None:
        """The gateway hangs or is gone: within 100 ms the guard has to begin a stop."""
        self._cause_stop("the gateway failed", now_s + GUARD_S, at_once=False)
        self._excess_s, self._excess_rate = now_s + GUARD_S, self._falls_mps2(at_once=False)
        self._excess_mps = self._order.speed_mps if self._order is not None else 0.0
        self._begin_stop(now_s)
        self.disturb(now_s, 6.0)

    def loses_bus(self) -> None:
        """The gateway knows that it has lost the bus: what arrived before no longer counts."""
        self._heard.forget()

    def all_fail(self, now_s: float, until_s: float) -> None:
        """Gateway and guard are gone: no commands until another gateway begins."""
        self._cause_stop("all failed", now_s, at_once=False)
        self._excused_until_s = max(self._excused_until_s, until_s + 1.0)
        self.disturb(until_s, 6.0)

    def gateway_returns(self) -> None:
        """Another gateway begins. It knows no acknowledged bumper, and no latch but the guard's."""
        self._latched, self._acknowledged = [], False
        # Nor of a command that the one before left in the chassis: what is seen is all that bounds it.
        self._left_mps = None
        # Its lamps may be told only later: the counters that were sent before are none of its own.
        self._counters.clear()

    def line(self, now_s: float) -> str:
        """Request, command and truth now, in one line."""
        order, plant = self._order, self._plant
        if plant is None:
            return ""
        told_now = "-"
        if order is not None and now_s - self._order_s < 2 * TICK_S:
            told_now = _brief(order)
        true = (
            f"{'ARS'[plant.mode]} {'?PRND'[plant.gear]}{'P' if plant.braked else '-'} {plant.speed_mps:6.3f} m/s"
        )
        return (
            f"{now_s:6.2f} | asked {self._asked_mps:5.2f} {'yes' if self._is_permitted else 'no ':3} "
            f"| {told_now:18} | {true} {plant.x_m:8.3f} m {plant.angle_deg:5.1f} deg, "
            f"hill {plant.slope_deg:5.1f} | "
            f"{self._cause if self._cause_s is not None else ''} {','.join(self._latched)}"
        )

    @property
    def is_commanded(self) -> bool:
        """The chassis follows enabled frames."""
        return (
            self._order is not None
            and self._order.enabled
            and self._plant is not None
            and self._plant.mode == AUTO
        )

    @property
    def is_told_to_move(self) -> bool:
        """The last burst has a speed."""
        return self._order is not None and self._order.speed_mps > 0

    def _expect_deadman(self, now_s: float) -> None:
        if self._is_permitted and now_s - self._asked_s > self._limits.deadman_s + 0.03:
            self._cause_stop("deadman", now_s, at_once=False)

    def _idle_s(self, now_s: float) -> float:
        """How long it should have been disengaged for lack of a requested speed; negative before."""
        limit_s = self._limits.idle_s
        begin_s = max(self._zero_since_s, self._engaged_s)
        return -1.0 if self._asked_mps or not limit_s else now_s - begin_s - limit_s

    def _judge_hazard(self, now_s: float, *, is_due: bool) -> None:
        """A latched stop shows both indicators, the guard's too."""
        lamps = self._bytes.get(LIGHT_CMD, bytes(8))
        is_due = is_due and now_s >= self._blind_until_s
        if self._timer("hazard").lasts(now_s, holds=is_due) > SEEING_S and not lamps[1] & lamps[2] & 1:
            self._fail("no_hazard", now_s, f"the lamps were told {lamps[:3].hex()}; latched {self._latched}")

    def _find_cause(self, state: Fields, now_s: float) -> None:
        """The gateway has stopped the robot without a request."""
        reason = state["stop_reason"]
        is_free = now_s < max(self._disturbed_until_s, self._excused_until_s) or self.is_damaged()
        is_free |= reason == "idle" and self._idle_s(now_s) > -SEEING_S
        plant, order = self._plant, self._order
        if reason == "rolling" and plant is not None and order is not None and order.parking:
            # Parked at speed in a curve, where its outer wheel is faster than the ramp that it had.
            is_free |= abs(plant.speed_mps) > 0.3 and abs(plant.angle_deg) > 10
        if reason in UNTRUE_SPEED:
            is_free = is_free and not (self._is_undisturbed and plant is not None and plant.can_climb)
            if not self._is_untrue(reason, now_s):
                self._fail("reason_untrue", now_s, f"{reason}, seen {self._heard.speed_mps:.2f} m/s")
        if not is_free and not (reason == "deadman" and now_s - self._asked_s > self._limits.deadman_s - 0.03):
            self._fail("false_stop", now_s, f"{reason}; latched {state['latched']}")
        if reason in LATCHING and reason not in state["latched"]:
            self._fail("not_latched", now_s, f"{reason}; latched {state['latched']}")
        self._cause_s, self._cause, self._is_permitted = now_s, reason, False

    def _is_untrue(self, reason: str, now_s: float) -> bool:
        """The seen speed contradicts the command in the way of this reason."""
        if self.is_damaged() or self._plant is None or BODY in self._plant.frozen:
            return True
        seen_mps = self._heard.speed_mps - 2 * self._bit_mps
        stands = seen_mps < (STANDS_MPS if reason == "not_moving" else FROZEN_MPS)
        # Speeds that were frozen a moment ago still count as metres without a change of the mileage.
        stands |= reason == "feedback_frozen" and now_s - self._frozen_wheels_s < 5.0
        return stands or (reason == "feedback_frozen" and now_s - self._heard.unchanged_s > 0.9)

    def _falls_mps2(self, *, at_once: bool) -> float:
        """The least by which the commanded speed falls in a stop; a tenth less for bits and ticks."""
        limits = self._limits
        return 0.9 * (limits.emergency_deceleration_mps2 if at_once else limits.deceleration_mps2)

    def _follows(self, plant: Plant) -> bool:
        """The motor can slow the robot down along the ramp."""
        return plant.slows_mps2 >= self._limits.deceleration_mps2 + FOLLOWS_MPS2

    @property
    def _straightens_s(self) -> float:
        """Time to slow down from the highest speed to what the largest steering angle allows."""
        limits = self._limits
        bend = tan(radians(limits.steering_limit_deg))
        slow_mps = sqrt(limits.lateral_acceleration_mps2 * WHEELBASE_M / bend)
        return max(0.0, limits.speed_limit_mps - slow_mps) / limits.deceleration_mps2

    def _begin_stop(self, now_s: float) -> None:
        plant = self._plant
        if plant is None:
            return
        self._stop_record = (now_s, plant.x_m, plant.speed_mps, plant.slope_deg)
        if self._rest_m is not None:
            # The roll-back of a stop counts from its own moment.
            self._rest_m = plant.x_m
        self._rest_is_stop = True

    def _is_reachable(self, now_s: float) -> bool:
        return now_s >= self._excused_until_s

    @staticmethod
    def _mode(plant: Plant) -> int | None:
        """The mode, if what is shown of it is true."""
        body = plant.shown.get(BODY)
        return plant.mode if body is not None and body[5] == plant.mode and BODY not in plant.frozen else None

    def _is_remote(self, now_s: float) -> bool:
        plant = self._plant
        return (
            plant is not None
            and not plant.is_away
            and self._mode(plant) == REMOTE
            and now_s >= self._blind_until_s
        )

    @staticmethod
    def _hides_mode(plant: Plant) -> bool:
        """The robot reports the remote control, and is in another mode: nobody can know."""
        body = plant.shown.get(BODY)
        return plant.mode != REMOTE and body is not None and body[5] == REMOTE

    # The motion.

    def _judge_remote(self, plant: Plant, now_s: float) -> None:
        if self._remote.lasts(now_s, holds=self._is_remote(now_s)) > 0.1:
            self._cause_stop("taken over", now_s, at_once=False)
        # Given back while it obeys an old command: told to stop at once.
        is_left = self._mode(plant) == AUTO and self._left_mps is not None and now_s - self._order_s > 1.0
        is_left = is_left and now_s >= self._blind_until_s
        moving_s = self._timer("left").lasts(now_s, holds=is_left and abs(plant.speed_mps) > MOVES_MPS)
        if moving_s > 0.2 + SEEING_S + 0.2 and self._gateway_lives:
            self._fail("left_moving", now_s, f"{plant.speed_mps:.2f} m/s in auto, nobody tells it to stop")

    def _judge_roll_back(self, plant: Plant, now_s: float) -> None:
        wants_zero = self._cause_s is not None or not self._is_permitted or not self._asked_mps
        if not self._is_reachable(now_s):
            self._rest_m = self._best_m = None
            self._rest_sign = 0.0
            return
        speed_mps, x_m = plant.speed_mps, plant.x_m
        if self._order is not None and self._order.signed_mps * speed_mps > 0:
            # A motor that comes back in the midst of a ramp follows what is left of it.
            self._rest_m = None
        if not wants_zero:
            self._rest_m, self._rest_sign, self._rest_is_stop, self._rest_bound_m = None, 0.0, False, 0.0
            self._judge_start(plant, now_s)
            return
        self._best_m = None
        self._rest_bound_m = max(self._rest_bound_m, _unheld_m(plant))
        if self._rest_m is None:
            if not self._rest_sign:
                self._rest_sign = 1.0 if speed_mps > 0 else -1.0 if speed_mps < 0 else 0.0
            if speed_mps * self._rest_sign > 0:
                return
            self._rest_m = x_m
        rolled_m = abs(x_m - self._rest_m)
        is_stop = self._rest_is_stop or not plant.brake_holds
        # Slow pulses show that it creeps, when it has for a while: later than the motor may be given it back.
        self._rest_bound_m = max(self._rest_bound_m, rolled_m * (self._trust.is_lost or plant.creeps_slowly))
        self._expect_notice(plant, rolled_m, now_s)
        if rolled_m > (STOP_M if is_stop else RELEASE_M) + self._rest_bound_m:
            kind = "roll_back_at_stop" if self._rest_is_stop else "roll_back_at_release"
            self._fail(kind, now_s, f"{rolled_m:.2f} m on {plant.slope_deg:.0f} deg, {speed_mps:.2f} m/s")

    def _expect_notice(self, plant: Plant, rolled_m: float, now_s: float) -> None:
        """A parking brake that does not hold is noticed and latched; after a reset, once more."""
        if self._latched:
            self._latched_m = plant.x_m
        rolled_m = min(rolled_m, abs(plant.x_m - self._latched_m))
        is_due = not plant.brake_holds and not plant.creeps_unseen and self._gateway_lives
        # Where the speeds are frozen only the pulses show it.
        allowed_s = SEEING_S + PULSES_S * ({DRIVE, WHEELS} <= plant.frozen)
        if plant.mode == AUTO and now_s - self._order_s < 3 * TICK_S:
            # What is left of a ramp explains a speed.
            is_due &= abs(plant.speed_mps) > max(self._explained.values()) + MOVES_MPS
        counted_m = CREEP_PULSES / (2 * plant.build.pulses_per_m) if plant.brake_creep_mps else 0.0
        is_unnoticed = is_due and rolled_m > STOP_M / 2 + counted_m and not self._latched
        if self._timer("unnoticed").lasts(now_s, holds=is_unnoticed) > allowed_s:
            self._fail("brake_unnoticed", now_s, f"{rolled_m:.2f} m, {'braked' if plant.braked else 'released'}")

    def _judge_start(self, plant: Plant, now_s: float) -> None:
        """While a speed is requested, the robot does not roll the other way."""
        sign = 1.0 if self._asked_mps > 0 else -1.0
        if sign != self._asked_sign:
            self._asked_sign, self._best_m = sign, None
        if self._best_m is None:
            if plant.speed_mps * sign < 0:
                return
            self._best_m = plant.x_m
        self._best_m = max(self._best_m * sign, plant.x_m * sign) * sign
        rolled_m = (self._best_m - plant.x_m) * sign
        if not rolled_m:
            self._start_bound_m = 0.0
        if not plant.can_hold:
            # This remains allowed when the motor comes back: by then it has rolled so far.
            self._start_bound_m = max(self._start_bound_m, _dead_motor_m(plant) + 0.2)
        elif not plant.brake_holds:
            self._start_bound_m = max(self._start_bound_m, _slipping_m(plant))
        if rolled_m > UNSTARTED_M + self._start_bound_m:
            self._fail("roll_back_at_start", now_s, f"{rolled_m:.2f} m on {plant.slope_deg:.0f} deg")

    def _judge_stop(self, plant: Plant, now_s: float) -> None:
        """A stop ends: standing, the parking brake applied, and not far away."""
        if self._stop_record is None:
            return
        if not self._is_reachable(now_s):
            self._stop_record = None
            return
        if self._hides_mode(plant) or self._trust.is_lost:
            # The stop begins when it can be known, or something holds the robot again.
            self._stop_record = (now_s, plant.x_m, plant.speed_mps, plant.slope_deg)
            return
        began_s, x_m, speed_mps, _ = self._stop_record
        if self._is_permitted or self._trust.is_lost:
            self._stop_record = None
            return
        slows_mps2 = self._limits.deceleration_mps2
        # 0.3 s until it is seen not to slow, the brake's delay and the drive's lag, then the lesser of the ramp
        # and of what the parking brake has left on this hill.
        worn_mps2 = _worn_mps2(plant)
        grip = min(worn_mps2, PARKING_MPS2 + 0.2 - abs(plant.load_mps2))
        reach_m = abs(speed_mps) * (0.6 + plant.build.brake_delay_s + self._lag_s)
        reach_m += (abs(speed_mps) + 0.5) ** 2 / (2 * min(slows_mps2, grip)) + STOP_M
        if not self._follows(plant):
            # It slows, but less than it is told: the brake comes where the ramp has ended.
            reach_m += 0.75 * speed_mps**2 / slows_mps2
        if abs(plant.x_m - x_m) > reach_m:
            self._fail("stop_distance", now_s, f"{abs(plant.x_m - x_m):.1f} m from {speed_mps:.2f} m/s")
        due_s = abs(speed_mps) / min(slows_mps2, worn_mps2) + 2.0 + plant.build.brake_delay_s + 3 * self._lag_s
        if now_s - began_s > due_s:
            self._stop_record = None
            # One that stands when it is given back, or found, is told nothing, and one whose mode frame is frozen.
            is_ours = self._mode(plant) is not None and self._order_s >= began_s
            # Where the brake does not hold, or did not a moment ago, the motor may hold it: only the metres count.
            if not plant.brake_holds or "brake_slips" in self._latched:
                return
            if abs(plant.speed_mps) > 0.02 or (is_ours and not plant.braked):
                how = "braked" if plant.braked else "not braked"
                self._fail("stop_unfinished", now_s, f"{due_s:.1f} s after, {plant.speed_mps:.2f} m/s, {how}")

    def _judge_supervision(self, plant: Plant, now_s: float) -> None:
        order = self._order if now_s - self._order_s < 3 * TICK_S else None
        shown = plant.shown
        is_blind = now_s < self._blind_until_s or not {STEERING, DRIVE, WHEELS} <= shown.keys()
        commands = order is not None and order.enabled and plant.mode == AUTO
        if not self._gateway_lives or not commands or order is None or is_blind:
            for name in SUPERVISION:
                self._timer(name).lasts(now_s, holds=False)
            self._left_deg = self._right_deg = plant.angle_deg
            self._explained = {1.0: plant.speed_mps, -1.0: -plant.speed_mps}
            return
        speed_mps = plant.speed_mps
        self._judge_seen(plant, order, now_s)
        if WHEELS in plant.frozen:
            self._frozen_wheels_s = now_s
        # Rolling: faster one way than the last commands that way, and a drive that follows them late, explain.
        for sign in (1.0, -1.0):
            told_mps = max(order.signed_mps * sign, 0.0)
            lag_mps2 = min(LAGGING_MPS2, (self._explained[sign] - told_mps) / LAGGING_S)
            self._explained[sign] = max(told_mps, self._explained[sign] - lag_mps2 * TICK_S)
            rolls = (
                speed_mps * sign > self._explained[sign] + MOVES_MPS + self._bit_mps
                and order.signed_mps * sign <= 0
            )
            # One that is given back to its motor is judged by whether that holds it.
            is_due = plant.brake_holds and "brake_slips" not in self._latched
            lasts_s = self._timer(f"roll{sign}").lasts(now_s, holds=rolls and not order.parking and is_due)
            allowed_s = 0.1 + SEEING_S
            if now_s - self._frozen_wheels_s <= allowed_s:
                allowed_s += PULSES_S
            if self.finds_variant and now_s - self._begun_s < 0.5:
                # In an unknown scale it is only seen that the robot moves: 300 ms without standstill.
                allowed_s = max(allowed_s, 0.3 + SEEING_S)
            if lasts_s > allowed_s + (GUARD_BRAKE_S if self._is_guards else 0.0):
                kind = "rolling_against" if order.speed_mps else "rolling_unnoticed"
                self._fail(kind, now_s, f"{speed_mps:.2f} m/s, told {order.signed_mps:.2f}, no parking request")
        self._judge_runaway(plant, order, now_s)
        # Steering: as it is shown, between what was told lately and followers that are slower than any chassis.
        shown_deg = (int.from_bytes(shown[STEERING][1:3], "little") & 0xFFF) * 0.043945 - 90
        self._left_deg = max(order.angle_deg, self._left_deg - _turned_deg(self._left_deg - order.angle_deg))
        self._right_deg = min(order.angle_deg, self._right_deg + _turned_deg(order.angle_deg - self._right_deg))
        off = not self._right_deg - STUCK_DEG < shown_deg < self._left_deg + STUCK_DEG
        self._expect_latch("stuck", "steering_unnoticed", 0.3, now_s, f"{shown_deg:.1f} deg", holds=off)
        # Where both are frozen no speed is measured, and the rules on frozen feedback judge.
        measured_mps = 0.0 if plant.frozen >= {DRIVE, WHEELS} else abs(speed_mps)
        fast = self._is_permitted and measured_mps > self._limits.speed_limit_mps + 0.3 + 2 * self._bit_mps
        self._expect_latch("fast", "overspeed_unnoticed", 0.3, now_s, f"{speed_mps:.2f} m/s", holds=fast)
        lateral = max(order.speed_mps, measured_mps) ** 2
        lateral *= tan(radians(max(abs(order.angle_deg), abs(plant.angle_deg)))) / WHEELBASE_M
        # So long it takes from full speed to what full lock allows; the drive lags.
        leans = lateral > self._limits.lateral_acceleration_mps2 + 0.4
        if (
            self._timer("lateral").lasts(now_s, holds=self._is_permitted and leans)
            > self._straightens_s + 2 * self._lag_s + 2 * SEEING_S
        ):
            self._fail("lateral_measured", now_s, f"{lateral:.2f} m/s2")
        shown_mps = int.from_bytes(shown[DRIVE][1:3], "little") * self._bit_mps
        raw = int.from_bytes(shown[WHEELS][1:3], "little") + int.from_bytes(shown[WHEELS][3:5], "little")
        wheels_mps = abs(raw / 2 - (32768 if self._fine else 200)) * self._bit_mps
        larger, smaller = max(shown_mps, wheels_mps), min(shown_mps, wheels_mps)
        misfit = larger > smaller + 0.38 and larger > 1.6 * smaller
        self._expect_latch("drive", "speeds_unnoticed", 0.3, now_s, f"{larger:.2f}, {smaller:.2f}", holds=misfit)
        if self._timer("brake").lasts(now_s, holds=plant.braked and order.speed_mps > 0) > SEEING_S:
            self._fail("speed_against_closed_brake", now_s, f"told {order.speed_mps:.2f} m/s")
        self._judge_frozen_body(plant, now_s)

    def _judge_runaway(self, plant: Plant, order: Told, now_s: float) -> None:
        """A robot that speeds up beyond its command has its parking brake requested."""
        for sign in (1.0, -1.0):
            over_mps = plant.speed_mps * sign - self._explained[sign] - 2 * self._bit_mps
            risen_mps = (plant.speed_mps - self._lately[-round(RISE_S / TICK_S)][1]) * sign - 2 * self._bit_mps
            dies = over_mps > RUNAWAY_MPS and risen_mps > RUNAWAY_RISE_MPS and not plant.frozen & {DRIVE, WHEELS}
            lasts_s = self._timer(f"dies{sign}").lasts(now_s, holds=dies and not order.parking)
            # A speed beyond the chassis is not believed. Half a second later no speed is received at all.
            more_s = 0.5 if abs(plant.speed_mps) > ABSURD_MPS else 0.0
            if "brake_slips" in self._latched:
                more_s += MOTOR_HOLDS_S
            if lasts_s > 0.1 + SEEING_S + more_s and not self._is_guards:
                self._fail("runaway_unbraked", now_s, f"{plant.speed_mps:.2f} m/s, told {order.signed_mps:.2f}")

    def _judge_seen(self, plant: Plant, order: Told, now_s: float) -> None:
        """A robot that is commanded to move is seen to move, and its feedback changes with the command."""
        seen_mps = self._heard.speed_mps
        told_mps = abs(order.signed_mps) - self._bit_mps if self._is_permitted else 0.0
        # The command as it was a second ago, with its lag and without: since then drive and wheels say the same.
        before = self._lately[0][0], self._lately[0][3]
        is_new = now_s - self._heard.unchanged_s <= 1.0
        lowest, highest = (before, before) if is_new else self._told_range
        self._told_range = tuple(map(min, lowest, before)), tuple(map(max, highest, before))
        changed_mps = min(map(sub, *reversed(self._told_range))) if self._is_permitted else 0.0
        # At rest each reading is like the one before, and the other rows judge.
        is_frozen = seen_mps >= FROZEN_MPS and changed_mps > TOLD_MPS + self._bit_mps
        counts = told_mps > FROZEN_TOLD_MPS and seen_mps < FROZEN_MPS
        rises = abs(plant.speed_mps) * plant.build.pulses_per_m * PULSES_EVERY_S > 2 and PULSES not in plant.frozen
        if not counts or BODY in plant.frozen:
            self._counted_m = plant.travelled_m
        # Loaded, uphill, with a weak battery it gathers speed, and that is no false stop's business.
        gathers = seen_mps > self._lately[0][2] + GATHERS_MPS
        stands = told_mps > TOLD_MPS and seen_mps < STANDS_MPS and not gathers
        # Which, by which rule, after which time beyond that of seeing it.
        rows = (
            ("stands", "not_moving_unnoticed", 1.0 + LAGGING_S, stands),
            ("frozen", "frozen_unnoticed", 0.0, is_frozen),
            ("pulses", "frozen_pulses_unnoticed", PULSES_S, counts and rises),
            ("mileage", "frozen_mileage_unnoticed", 0.0, plant.travelled_m - self._counted_m > 3.0),
        )
        for timer, kind, rule_s, holds in rows:
            detail = f"told {order.signed_mps:.2f} m/s, seen {seen_mps:.2f}"
            self._expect_latch(timer, kind, rule_s, now_s, detail, holds=holds)

    def _expect_latch(
        self, timer: str, kind: str, rule_s: float, now_s: float, detail: str, *, holds: bool
    ) -> None:
        """After the rule's time the robot is being stopped, and that is latched."""
        lasts_s = self._timer(timer).lasts(now_s, holds=holds)
        if lasts_s > rule_s + SEEING_S and not self._latched:
            self._fail(kind, now_s, f"{detail}, for {lasts_s:.2f} s")

    def _judge_frozen_body(self, plant: Plant, now_s: float) -> None:
        """A mileage that stays while the pulses count: its step is a metre, so 3 m must show it."""
        if BODY not in plant.frozen:
            self._frozen_m = None
        elif self._frozen_m is None or abs(plant.speed_mps) > BELIEVED_MPS or plant.frozen & {DRIVE, WHEELS}:
            # Where the speeds are frozen too, the metres are those of what is seen.
            self._frozen_m = plant.travelled_m
        elif plant.travelled_m - self._frozen_m > 3.0 and not self._latched and self._is_permitted:
            self._fail("frozen_body_unnoticed", now_s, "3 m driven with a mode and bumpers that are old")

    def _judge_bumpers(self, plant: Plant, now_s: float) -> None:
        body = plant.shown.get(BODY, bytes(6))
        order = self._order if now_s - self._order_s < 3 * TICK_S else None
        pressed = "front_bumper" if body[4] & 1 else "rear_bumper" if body[4] & 0x10 else None
        if pressed is not None and self._struck in {None, pressed}:
            self._clear_s = now_s
        if now_s - self._clear_s > 0.3 + SEEING_S:
            self._struck, self._acknowledged = None, False
        if self._struck is None and pressed is not None:
            self._struck, self._struck_s = pressed, now_s
        self._doubt_bumpers(now_s, is_pressed=pressed is not None)
        commanding = order is not None and order.enabled and plant.mode == AUTO and self._gateway_lives
        for side in ("front_bumper", "rear_bumper"):
            counts = commanding and pressed == side and not self._acknowledged and not self._is_unsure
            held_s = self._timer(side).lasts(now_s, holds=counts)
            if held_s > 0.02 + 0.06:
                if side not in self._latched:
                    self._fail("bumper_unnoticed", now_s, f"{side} for {held_s * 1e3:.0f} ms")
                self._cause_stop(side, now_s, at_once=True)
        if commanding and order is not None and self._acknowledged and self._struck is not None:
            toward = 1.0 if self._struck == "front_bumper" else -1.0
            if order.signed_mps * toward > self._bit_mps and now_s - self._clear_s < 0.2 and self._is_permitted:
                self._fail("into_bumper", now_s, f"told {order.signed_mps:.2f} m/s")

    def _doubt_bumpers(self, now_s: float, *, is_pressed: bool) -> None:
        """After bad or missing frames, or some 300 ms of clear, the gateway's view of the bumpers is unknown."""
        clear_s = now_s - self._pressed_s
        bounces = is_pressed and 0.3 - 0.06 < clear_s <= 0.3 + SEEING_S
        if is_pressed:
            self._pressed_s = now_s
        if bounces or self.is_damaged() or now_s < self._blind_until_s:
            self._is_unsure = True
        elif not is_pressed and clear_s > 0.3 + SEEING_S:
            self._is_unsure = False

    def _judge_service(self, plant: Plant, now_s: float) -> None:
        """What the operator relies on: the robot engages, holds itself, moves, and reports what is wrong."""
        order = self._order if now_s - self._order_s < 3 * TICK_S else None
        quiet = now_s > max(self._disturbed_until_s, self._excused_until_s)
        # A stop that is under way ends first, with the gentlest ramp of the settings.
        due_s = 6.0 + self._limits.speed_limit_mps / self._limits.deceleration_mps2
        if self._engage_asked_s is not None and now_s - self._engage_asked_s > due_s and self._is_undisturbed:
            self._fail("cannot_engage", now_s, f"{due_s:.1f} s after it was asked")
        engaged = self._is_permitted and self._was_engaged and order is not None
        is_told_zero = order is not None and not order.speed_mps
        # Speed feedback that is frozen may say that it moves, and so may a damaged frame that passes for whole.
        shows_rest = not plant.frozen & {DRIVE, WHEELS} and self._heard.speed_mps <= MOVES_MPS
        holds_zero = (
            engaged and is_told_zero and not self._asked_mps and abs(plant.speed_mps) < 0.02 and shows_rest
        )
        stands_s = self._timer("hold").lasts(now_s, holds=holds_zero)
        if order is not None and stands_s > 1.0 + 0.4 and not order.parking and now_s - self._zero_since_s > 1.5:
            self._fail("no_auto_hold", now_s, f"standing for {stands_s:.1f} s without the parking brake")
        kept = engaged and abs(self._asked_mps) >= 0.2 and abs(plant.speed_mps) < 0.05 and plant.can_climb
        if (
            self._timer("kept").lasts(now_s, holds=kept and quiet and plant.wall is None)
            > 3.0 + self._limits.warning_s
        ):
            self._fail("does_not_move", now_s, f"asked {self._asked_mps:.2f} m/s for 3 s")
        is_loose = self._mode(plant) in {AUTO, STOP} and not plant.braked and not self._is_permitted
        is_loose = is_loose and self._latched_s > 0 and self._is_reachable(now_s) and PARKING not in plant.frozen
        if (
            self._timer("loose").lasts(now_s, holds=is_loose and self._gateway_lives) > LOOSE_S
            and now_s - self._order_s > LOOSE_S
        ):
            self._fail("latched_unbraked", now_s, f"{plant.speed_mps:.2f} m/s, and nothing is told")
        adrift = (
            self._mode(plant) == STOP and not plant.braked and abs(plant.speed_mps) > 0.15 and not plant.is_away
        )
        adrift = adrift and self._is_reachable(now_s)
        adrift_s = self._timer("adrift").lasts(now_s, holds=adrift and self._gateway_lives)
        if adrift_s > 0.2 + 2 * SEEING_S and (order is None or not order.parking):
            self._fail("mode_stop_moving", now_s, f"{plant.speed_mps:.2f} m/s in mode stop, and nothing is told")

    def expect_rest(self, now_s: float, kind: str, since_s: float) -> None:
        """By now the robot must stand with its parking brake applied, unless it was engaged since then."""
        plant = self._plant
        is_engaged = self._is_permitted or self._engaged_s > since_s
        if plant is None or is_engaged or not self._is_reachable(now_s):
            return
        if abs(plant.speed_mps) > 0.02 or not plant.braked:
            how = "braked" if plant.braked else "not braked"
            self._fail(kind, now_s, f"{plant.speed_mps:.2f} m/s, {how}")

    def expect_latched(self, now_s: float, kind: str) -> None:
        """By now it must be latched."""
        if not self._latched:
            self._fail(kind, now_s, "nothing is latched")

    def expect_frames(self, now_s: float, kind: str) -> None:
        """By now the chassis must receive a stop."""
        if now_s - self._order_s > 3 * TICK_S:
            self._fail(kind, now_s, f"the last frame was {now_s - self._order_s:.2f} s ago")

    def _timer(self, name: str) -> Since:
        return self._timers.setdefault(name, Since())

    def _fail(self, kind: str, now_s: float, detail: str) -> None:
        self.violations.setdefault(kind, Violation(kind, now_s, detail))


def _brief(order: Told) -> str:
    """Enables, gear, parking request, speed and angle in one line."""
    brake, on = "P" if order.parking else "-", "on" if order.enabled else "off"
    return f"{on:3} {'?PRND???'[order.gear]}{brake} {order.speed_mps:5.3f} {order.angle_deg:5.1f}"


def _turned_deg(off_deg: float) -> float:
    """How far the slowest steering that a gateway has to allow for turns in a tick."""
    return min(25.0, off_deg / SLOW_STEERING_S) * TICK_S


def _worn_mps2(plant: Plant) -> float:
    """How fast a worn parking brake slows a robot that it holds at standstill; no bound for a good one."""
    return plant.brake_slows_mps2 if plant.brake_holds and plant.brake_grip < 1 else inf


def _unheld_m(plant: Plant) -> float:
    """Additional metres for a robot whose motor, or whose brake, does not hold it."""
    if not plant.can_hold:
        return _dead_motor_m(plant)
    return 0.0 if plant.brake_holds else _slipping_m(plant) - STOP_M


def _dead_motor_m(plant: Plant) -> float:
    """Metres a robot rolls that nothing holds, until the rule on rolling has closed the parking brake.

    Where the motor cannot hold the hill, gravity alone acts for 0.1 s, ``SEEING_S`` and the brake's delay; then
    the brake has what gravity leaves of its grip. No gateway can do better. With frozen speeds only the pulses
    show it.
    """
    pull = abs(plant.load_mps2)
    free_s = 0.1 + SEEING_S + plant.build.brake_delay_s + PULSES_S * ({DRIVE, WHEELS} <= plant.frozen)
    return pull * free_s**2 / 2 + (pull * free_s) ** 2 / (2 * (PARKING_MPS2 - pull))


def _slipping_m(plant: Plant) -> float:
    """Metres a robot rolls behind a brake without any grip, until the motor has it.

    Gravity alone acts for the 0.1 s of the rule on rolling, the 20 ms between two frames, a tick, and until the
    brake has opened. Then the motor slows it, with the lag of its drive.
    """
    pull = abs(plant.load_mps2)
    free_s = 0.1 + 3 * TICK_S + plant.build.brake_delay_s
    speed_mps = pull * free_s
    slowing_m = max(speed_mps * plant.build.drive_lag_s, speed_mps**2 / (2 * plant.slows_mps2))
    return pull * free_s**2 / 2 + slowing_m

"""The oracle finds what it is there to find: each row of ``BREAKS`` breaks a rule."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from random import Random
from typing import Any, Self

import pytest
from msgspec.structs import replace

from schemas.settings import CommandSettings
from tests.system.scenarios.oracle import Oracle
from tests.system.scenarios.plant import (
    BODY,
    BRAKING_CMD,
    DRIVE,
    DRIVE_CMD,
    GEAR_CMD,
    GEAR_D,
    GEAR_N,
    GEAR_R,
    PARKING_CMD,
    PERIOD_STEPS,
    PULSES,
    STEERING_CMD,
    STEP_S,
    WHEELS,
    Build,
    Plant,
    checksum,
    orders,
)

USUAL = (DRIVE_CMD, GEAR_CMD, STEERING_CMD, BRAKING_CMD, PARKING_CMD)
STICKS = (0.5, 0.0)


class Stage:
    """An oracle, a plant and a commander; each step returns the stage. The robot is engaged, and stands braked."""

    def __init__(self) -> None:
        self.oracle = Oracle(CommandSettings(speed_limit_mps=1.0), fine=True, is_undisturbed=True, lag_s=0.1)
        self.robot = Plant(Build(fine=True, drive_lag_s=0.1), Random(1))  # noqa: S311
        self.now_s = 1.0
        self.state: dict[str, Any] = {"latched": [], "engaged": True, "stop_reason": "none"}
        self.asked_mps: float | None = 0.0
        self._counter = 0
        self.burst(parking=1).tell(0.5, parking=1)
        self.oracle.reply("engage", {"ok": True, "reason": "none"}, self.now_s)

    def burst(
        self,
        speed_mps: float = 0.0,
        *,
        gear: int = GEAR_D,
        parking: int = 0,
        raw_angle: int = 2048,
        taken: int = 5,
        enabled: int = 1,
        order: tuple[int, ...] = USUAL,
    ) -> Self:
        frames = orders(gear, speed_mps, fine=True)
        bodies = {PARKING_CMD: bytes([1, parking, 0]), STEERING_CMD: b"\x01" + raw_angle.to_bytes(2, "little")}
        sent = []
        for identifier in order:
            body = bytes([enabled]) + bodies.get(identifier, frames[identifier][:3])[1:]
            head = body + bytes([0, 0, 0, self._counter << 4])
            sent.append((identifier, head + bytes([checksum(head)])))
        self._counter = (self._counter + 1) % 16
        self.oracle.frames(sent, self.now_s, taken=taken, by_guard=False)
        for identifier, data in sent[:taken]:
            self.robot.receive(identifier, data)
        return self

    def run(self, seconds: float, each: Callable[[], object] = bool) -> Self:
        """Let time pass, and do this each tick."""
        for _ in range(round(seconds * 100)):
            self.now_s += 0.01
            for _ in range(round(0.01 / STEP_S)):
                self.oracle.hears(self.robot.step(), self.now_s)
            self.oracle.motion(self.robot, self.now_s, gateway_lives=True)
            if self.asked_mps is not None:
                self.oracle.requests("drive", {"speed_mps": self.asked_mps}, self.now_s)
            self.oracle.state(self.state, self.now_s)
            each()
        return self

    def call(self, act: Callable[..., object], *given: object) -> Self:
        act(*given)
        return self

    def tell(self, seconds: float, speed_mps: float = 0.0, **told: Any) -> Self:  # noqa: ANN401 - of a burst
        return self.run(seconds, lambda: self.burst(speed_mps, **told))

    def tell_each(self, speeds_mps: Iterable[float]) -> Self:
        for speed_mps in speeds_mps:
            self.tell(0.01, speed_mps)
        return self

    def steer(self, *angles: int) -> Self:
        for angle in angles:
            self.tell(0.01, raw_angle=2048 + angle)
        return self

    def silence(self, seconds: float = 0.01) -> Self:
        return self.run(seconds, lambda: self.oracle.frames([], self.now_s, taken=0, by_guard=False))

    def plant(self, **knobs: Any) -> Self:  # noqa: ANN401 - any knob
        """Turn knobs of the plant; a slope is there at once."""
        if (slope_deg := knobs.get("slope_deg")) is not None:
            knobs["slope_target_deg"] = slope_deg
        for name, value in knobs.items():
            setattr(self.robot, name, value)
        return self

    def build(self, **changes: Any) -> Self:  # noqa: ANN401 - any field of a build
        return self.plant(build=replace(self.robot.build, **changes))

    def limits(self, **changes: float) -> Self:
        self.oracle._limits = replace(self.oracle._limits, **changes)
        return self

    def ask(self, speed_mps: float | None) -> Self:
        """The operator requests a speed; for None it falls silent."""
        self.asked_mps = speed_mps
        return self

    def request(self, verb: str) -> Self:
        self.oracle.requests(verb, {}, self.now_s)
        return self

    def reply(self, detail: str = "") -> Self:
        self.oracle.reply("stop", {"ok": True, "reason": "none", "detail": detail}, self.now_s)
        return self

    def stops(self, reason: str = "", *, latched: bool = True) -> Self:
        self.state = {"latched": [reason] * latched, "engaged": False, "stop_reason": reason or "none"}
        return self

    def disturb(self, lasts_s: float = 9.0) -> Self:
        self.oracle.disturb(self.now_s, lasts_s)
        return self

    def skip(self) -> Self:
        self._counter = (self._counter + 3) % 16
        return self

    def all_fail(self, lasts_s: float = 0.0) -> Self:
        self.oracle.all_fail(self.now_s, self.now_s + lasts_s)
        return self

    # Scenes that several begin with.

    def accelerate(self, to_mps: float = 0.5) -> Self:
        """Drive by the rules, from the parking brake on."""
        ticks = range(1, round(to_mps / 0.008) + 2)
        self.tell(0.2).ask(to_mps).tell_each(min(to_mps, 0.008 * tick) for tick in ticks)
        return self.tell(0.5, to_mps)

    def slow_down(self, ticks: int) -> Self:
        """The ramp from 0.5 m/s to zero, and on at zero."""
        return self.tell_each(max(0.0, 0.49 - 0.012 * tick) for tick in range(ticks))

    def yields_twice(self) -> Self:
        """A stop that is owed begins without body frames for 0.2 s, and yields to the remote control."""
        self.tell(0.2, parking=1).plant(sticks=(0.0, 0.0)).tell(0.11, parking=1).silence(0.3)
        self.plant(silent=frozenset({BODY})).silence(0.21).tell(0.3, parking=1)
        return self.plant(silent=frozenset()).tell(0.1, parking=1).silence(0.5)

    def stop_latched(self) -> Self:
        self.tell(0.2).request("stop").stops("remote_stop").tell(1.0, parking=1)
        return self.tell(0.5, gear=GEAR_N, parking=1, enabled=0).silence()

    def slips(self) -> Self:
        self.build(parks_motor=True).tell(0.5).plant(brake_grip=0.0, slope_deg=5.0).disturb()
        return self.tell(0.2, parking=1).stops("brake_slips")

    def given_back(self, after_s: float) -> Self:
        """It is braked again so long after it was given back to its motor."""
        return self.slips().tell(after_s + 0.05).tell(3.0, parking=1)


SPEED = frozenset({DRIVE, WHEELS})
Scene = Callable[[Stage], object]

BREAKS: list[tuple[str, Scene]] = [
    ("neutral_unbraked", lambda it: it.tell(0.1, gear=GEAR_N)),
    ("gear_change_unbraked", lambda it: it.tell(0.1).burst(gear=GEAR_R)),
    ("speed_against_brake", lambda it: it.burst(0.005, parking=1)),
    ("over_limit", lambda it: it.accelerate(1.1)),
    ("acceleration", lambda it: it.ask(1.0).tell(0.1).tell(0.05, 0.1)),
    ("angle", lambda it: it.burst(raw_angle=2048 + 560)),
    ("steering_rate", lambda it: it.tell(0.1).steer(20)),
    ("lateral_told", lambda it: it.burst(2.0, raw_angle=2048 + 500)),
    ("rises_unasked", lambda it: it.tell(0.1).ask(None).tell(0.5).tell(0.1, 0.006)),
    ("not_falling", lambda it: it.accelerate().ask(0.0).tell(0.3, 0.5)),
    # The deadman, and a remote stop.
    ("not_falling", lambda it: it.accelerate().ask(None).tell(0.7, 0.5)),
    ("not_falling", lambda it: it.accelerate().request("stop").tell(0.3, 0.5)),
    ("roll_back_at_release", lambda it: it.plant(slope_deg=8.0).tell(1.5, gear=GEAR_N)),
    ("rolling_unnoticed", lambda it: it.tell(0.2).plant(motor_strength=0.0, slope_deg=8.0).tell(0.5)),
    ("rolling_against", lambda it: it.accelerate().plant(hand=(-0.3, 2000.0)).tell(1.5, 0.5)),
    ("rolling_unnoticed", lambda it: it.tell(0.2).plant(hand=(0.25, 2000.0)).tell(1.0)),
    ("steering_unnoticed", lambda it: it.plant(stuck=True).steer(*range(0, 300, 10), *[300] * 70)),
    ("overspeed_unnoticed", lambda it: it.plant(speed_gain=1.6).accelerate(1.0).tell(0.5, 1.0)),
    # The wheels alone show it.
    (
        "overspeed_unnoticed",
        lambda it: it.accelerate().plant(frozen=frozenset({DRIVE}), speed_gain=3.0).tell(1.6, 0.5),
    ),
    ("frozen_body_unnoticed", lambda it: it.accelerate().plant(frozen=frozenset({BODY})).tell(7.0, 0.5)),
    ("bumper_unnoticed", lambda it: it.accelerate().call(it.robot.touch, "front").tell(1.0, 0.5)),
    ("talks_to_remote", lambda it: it.plant(sticks=STICKS).tell(0.3, parking=1)),
    ("talks_to_remote", lambda it: it.yields_twice().tell(0.2, parking=1)),
    ("stop_lies", lambda it: it.plant(sticks=STICKS).run(0.4).reply().request("stop").run(0.3).reply()),
    ("silence_unbraked", lambda it: it.tell(0.2).silence()),
    ("no_auto_hold", lambda it: it.tell(2.0)),
    ("stop_unfinished", lambda it: it.accelerate().request("disengage").stops(latched=False).slow_down(300)),
    ("false_stop", lambda it: it.accelerate().stops("implausible_speed", latched=False).tell(0.02, 0.49)),
    ("malformed_frame", lambda it: it.tell(0.1).skip().burst()),
    ("given_back_fast", lambda it: it.tell(0.2, parking=1).silence(0.5).burst(0.5)),
    ("does_not_move", lambda it: it.ask(0.5).tell(4.0, parking=1)),
    ("no_hazard", lambda it: it.accelerate().request("stop").stops("remote_stop").slow_down(50)),
    ("unwarned", lambda it: it.limits(warning_s=2.0).accelerate()),
    ("commands_remote", lambda it: it.accelerate().plant(sticks=STICKS).tell(0.05, 0.4)),
    ("commands_remote", lambda it: it.tell(0.2).plant(sticks=(0.0, 0.0)).tell(0.11)),
    ("left_to_remote", lambda it: it.accelerate().plant(sticks=STICKS).run(0.03).burst(0.4).silence()),
    ("speed_from_standby", lambda it: it.accelerate().plant(silent=frozenset({BODY})).silence(0.5).burst(0.4)),
    ("not_moving_unnoticed", lambda it: it.plant(blocked=True).accelerate().tell(1.5, 0.5)),
    ("runs_ahead", lambda it: it.plant(blocked=True).accelerate(0.9)),
    (
        "frozen_unnoticed",
        lambda it: (
            it.accelerate(0.3).plant(frozen=frozenset(PERIOD_STEPS)).ask(0.7),
            it.tell_each(min(0.7, 0.3 + 0.008 * tick) for tick in range(250)),
        ),
    ),
    ("frozen_pulses_unnoticed", lambda it: it.tell(0.3).plant(frozen=SPEED).accelerate(0.25).tell(1.0, 0.25)),
    (
        "frozen_mileage_unnoticed",
        lambda it: it.tell(0.3).plant(frozen=SPEED | {PULSES}).accelerate(0.25).tell(14.0, 0.25),
    ),
    ("reason_untrue", lambda it: it.accelerate().disturb(1.0).stops("not_moving").tell(0.02, 0.49)),
    (
        "runaway_unbraked",
        lambda it: it.accelerate().plant(motor_strength=0.0, slope_deg=-15.0).tell(0.6, 0.5),
    ),
    (
        "brake_unnoticed",
        lambda it: (
            it.tell(0.2, gear=GEAR_N, parking=1).plant(brake_grip=0.0, slope_deg=3.0),
            it.tell(1.2, gear=GEAR_N, parking=1),
        ),
    ),
    (
        "latched_unbraked",
        lambda it: it.stop_latched().plant(sticks=(0.0, 0.0)).silence(0.5).plant(sticks=None).silence(2.0),
    ),
    # It stood by its motor, creeps so fast that each frame has a pulse, is latched, and goes on.
    (
        "roll_back_at_stop",
        lambda it: (
            it.tell(0.2).tell(0.2, parking=1).tell(0.2, gear=GEAR_N, parking=1),
            it.plant(brake_creep_mps=0.03, slope_deg=3.0).request("stop").stops("remote_stop"),
            it.tell(17.0, gear=GEAR_N, parking=1),
        ),
    ),
    # It is given to its brake again although its motor holds it, and before that could.
    ("roll_back_at_stop", lambda it: it.given_back(1.0)),
    ("roll_back_at_stop", lambda it: it.given_back(0.1)),
    ("stands_untrue", lambda it: it.accelerate().reply("the robot stands, and its parking brake is applied")),
    # The brake is the last word after a part of a burst, or the second for no reason.
    ("burst_order", lambda it: it.tell(0.1, parking=1).tell(0.01, parking=1, taken=3).burst(parking=1)),
    (
        "burst_order",
        lambda it: it.tell(0.1, parking=1).burst(parking=1, order=(DRIVE_CMD, PARKING_CMD, *USUAL[1:4])),
    ),
    (
        "found_moving_not_latched",
        lambda it: it.all_fail(1.0).oracle.expect_latched(it.now_s + 2.0, "found_moving_not_latched"),
    ),
]


def test_a_drive_by_the_rules_breaks_none() -> None:
    """Up, along, down again, and the parking brake."""
    stage = Stage()
    stage.accelerate().ask(0.0).slow_down(50).tell(1.0, parking=1)
    assert stage.oracle.violations == {}


@pytest.mark.parametrize(("kind", "scene"), BREAKS)
def test_each_broken_rule_is_found(kind: str, scene: Scene) -> None:
    stage = Stage()
    scene(stage)
    assert kind in stage.oracle.violations, stage.oracle.violations

"""A scenario from a seed: a chassis, a hill, an operator, and what goes wrong. ``run`` plays and judges it."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any, Final, Literal

import msgspec

from schemas.settings import ChassisSettings, CommandSettings, Settings
from tests.system.scenarios.oracle import GUARD_S, MOVES_MPS, Oracle, Violation
from tests.system.scenarios.plant import (
    AUTO,
    BODY,
    BRAKING,
    DRIVE,
    GEAR,
    GEAR_D,
    GEAR_R,
    LIGHT,
    PARKING,
    PERIOD_STEPS,
    PULSES,
    SPEAKER,
    STEERING,
    WHEELS,
    Build,
    Plant,
)
from tests.system.scenarios.rig import Bus, Gateway, Guard, Leg, Operator, Rig

SCRIPT_S: Final = 18.0  # length of the operator's script, without engaging and coming to rest
LIMIT_S: Final = 30.0
FOREVER_S: Final = 99.0
SHOWS_S: Final = 3.0  # a disturbance that has ended may still show in a stop for this long
DAMAGE_SHOWS_S: Final = 0.1  # a damaged frame counts as a cause for this long
LOSS, CORRUPTION = 0.01, 0.001

ALL_FEEDBACK: Final = frozenset(PERIOD_STEPS)
SPEED_FEEDBACK: Final = frozenset({DRIVE, WHEELS})


class Act(msgspec.Struct, frozen=True):
    """A knob of the plant or of the bus is turned.

    Attributes:
        shows_s: for so long a stop has a cause in it.
        when: it waits for this moment, of ``MOMENTS``.
        then: acts that follow, from its own moment.
    """

    at_s: float
    knob: str
    value: Any
    shows_s: float = 0.0
    when: str = ""
    then: tuple[Act, ...] = ()


class Scenario(msgspec.Struct, frozen=True, kw_only=True):
    """All that a seed decides.

    Attributes:
        finds_variant: the gateway has to find the chassis's variant.
        found_mps: at the start the chassis drives by itself at this speed.
        fails_s, hangs_s: when the gateway's process fails, and for how long; without a guard never.
        guard_dies: the guard fails with it, for ever.
        returns_s: from a failure for ever to another gateway; 0: none.
        limit_s: it ends then, or ``rests_s`` after the operator.
    """

    seed: int
    build: Build
    slope_deg: float
    pedal_gain: float
    command: CommandSettings
    finds_variant: bool = False
    link_s: float
    loss: float
    corruption: float
    legs: list[Leg]
    gives_up_s: float
    recovers: bool
    acts: list[Act]
    disturbances: list[str]
    found_mps: float = 0.0
    fails_s: float = 0.0
    hangs_s: float = 0.0
    guard_dies: bool = False
    returns_s: float = 0.0
    limit_s: float = LIMIT_S
    rests_s: float = 5.0

    @property
    def is_undisturbed(self) -> bool:
        return not self.disturbances


class Result(msgspec.Struct, frozen=True):
    """The outcome; ``way_m`` counts from the first act."""

    seed: int
    violations: list[Violation]
    stops: int
    driven_m: float
    simulated_s: float
    way_m: float
    disturbances: list[str]


def _slope(random: Random) -> list[Act]:
    return [Act(0, "slope_rate_degps", random.uniform(2, 30)), Act(0, "slope_target_deg", random.uniform(-20, 20))]


def _for_a_while(knob: str, value: object, before: object, random: Random, most_s: float) -> list[Act]:
    lasts_s = random.choice((random.uniform(0.2, most_s), FOREVER_S))
    return [Act(0, knob, value, lasts_s + SHOWS_S), Act(lasts_s, knob, before)]


def _motor(random: Random) -> list[Act]:
    return _for_a_while("motor_strength", random.choice((0.0, random.uniform(0, 1))), 1.0, random, 4.0)


def _pedal(random: Random) -> list[Act]:
    return [Act(0, "pedal_gain", random.choice((0.0, 0.3, 1.0)))]


def _overspeed(random: Random) -> list[Act]:
    return _for_a_while("speed_gain", random.uniform(1.2, 2.5), 1.0, random, 5.0)


def _stuck(random: Random) -> list[Act]:
    return _for_a_while("stuck", True, False, random, 5.0)  # noqa: FBT003 - a knob's values


def _hand(random: Random) -> list[Act]:
    push = (random.choice((-1, 1)) * random.uniform(0.15, 1.0), random.uniform(300, 900))
    lasts_s = random.uniform(0.5, 4.0)
    return [Act(0, "hand", push, lasts_s + SHOWS_S), Act(lasts_s, "hand", None)]


def _button(random: Random) -> list[Act]:
    lasts_s = random.uniform(0.1, 4.0)
    return [Act(0, "button", value=True, shows_s=lasts_s + SHOWS_S), Act(lasts_s, "button", value=False)]


def _remote(random: Random) -> list[Act]:
    lasts_s = random.uniform(0.3, 5.0)
    sticks = [(random.uniform(-1.0, 1.0) * random.choice((0, 1)), random.uniform(-20, 20)) for _ in range(2)]
    stops = [Act(lasts_s * random.random(), "ask", "stop")] if random.random() < 0.4 else []
    return [
        *stops,
        Act(0, "sticks", sticks[0], lasts_s + SHOWS_S),
        Act(lasts_s * random.random(), "sticks", sticks[1]),
        Act(lasts_s, "sticks", None),
    ]


def _reboot(random: Random) -> list[Act]:
    lasts_s = random.uniform(0.3, 2.0)
    return [Act(0, "reboot", lasts_s, lasts_s + SHOWS_S)]


def _freeze(random: Random) -> list[Act]:
    identifier = random.choice((GEAR, STEERING, DRIVE, PARKING, WHEELS, BODY, BODY))
    return [_at("", "frozen", frozenset({identifier}), frozenset(), random.uniform(0.5, 6.0))]


def _at(when: str, knob: str, value: object, after: object, lasts_s: float) -> Act:
    return Act(0, knob, value, lasts_s + SHOWS_S, when, (Act(lasts_s, knob, after),))


def _frozen_speed(random: Random) -> list[Act]:
    """All feedback, or that of the speed alone, freezes; the frames go on."""
    frozen = random.choice((ALL_FEEDBACK, ALL_FEEDBACK - {PULSES, BODY}, SPEED_FEEDBACK, SPEED_FEEDBACK))
    lasts_s = random.choice((random.uniform(1.0, 6.0), FOREVER_S))
    return [_at(random.choice(("released", "accelerating")), "frozen", frozen, frozenset(), lasts_s)]


def _blocked(random: Random) -> list[Act]:
    lasts_s = random.choice((random.uniform(0.3, 4.0), FOREVER_S))
    return [_at(random.choice(("", "released")), "blocked", 1, 0, lasts_s)]


def _motor_dies(random: Random) -> list[Act]:
    """Downhill, anywhere in the robot's ramps."""
    steep_deg = random.choice((-1, 1)) * random.uniform(8, 20)
    return [
        Act(0, "slope_rate_degps", 30.0),
        Act(0, "slope_target_deg", steep_deg, SHOWS_S),
        Act(0, "motor_strength", random.choice((0.0, 0.0, 0.3)), FOREVER_S, "downhill"),
    ]


def _brake(random: Random) -> list[Act]:
    """A parking brake that reads applied, and holds nothing, slips or creeps."""
    grip, creep_mps = random.choice(
        ((0.0, 0.0), (random.uniform(0, 0.4), 0.0), (1.0, random.uniform(0.005, 0.05)))
    )
    when = random.choice(("", "braked"))
    steep_deg = random.choice((-1, 1)) * random.uniform(2, 20)
    return [
        Act(0, "slope_target_deg", steep_deg, SHOWS_S),
        Act(0, "brake_grip", grip, FOREVER_S, when),
        Act(0, "brake_creep_mps", creep_mps, 0.0, when),
    ]


def _remote_unseen(random: Random) -> list[Act]:
    """The remote control takes over and gives back while the bus is away at some phase; a stop is owed."""
    lasts_s, away_s = random.uniform(0.2, 3.0), random.choice((0.02, 0.1, 0.2, random.uniform(0.2, 2.0)))
    from_s = random.uniform(0.0, away_s)
    sticks = (random.choice((0.0, 0.0, random.uniform(-1.0, 1.0))), 0.0)
    return [
        Act(0, "away", value=True, shows_s=away_s + SHOWS_S),
        Act(away_s, "away", value=False),
        Act(from_s, "sticks", sticks, lasts_s + SHOWS_S),
        Act(from_s + lasts_s, "sticks", None),
        *([Act(random.uniform(0, away_s + 0.5), "ask", "stop")] if random.random() < 0.4 else []),
    ]


def _body_away(random: Random) -> list[Act]:
    """The body frames are missing for a moment while the remote control takes over; later it gives back."""
    away_s, from_s = random.uniform(0.4, 0.6), random.uniform(0.0, 0.4)
    back_s = random.uniform(1.0, 5.0)
    return [
        _at("accelerating", "silent", frozenset({BODY}), frozenset(), away_s),
        Act(from_s, "sticks", (0.0, 0.0), back_s + SHOWS_S, "accelerating", (Act(back_s, "sticks", None),)),
    ]


def _part(random: Random) -> list[Act]:
    """The bus takes only some frames of each burst."""
    lasts_s = random.choice((0.01, 0.01, random.uniform(0.02, 1.0)))
    acts = [Act(0, "most", random.randint(0, 6), lasts_s + SHOWS_S)]
    acts += [Act(lasts_s * part / 3, "most", random.randint(0, 6)) for part in (1, 2) if lasts_s > 0.1]
    return [*acts, Act(lasts_s, "most", None)]


def _touch(random: Random) -> list[Act]:
    return [Act(0, "touch", random.choice(("front", "rear")), FOREVER_S)]


def _losses(random: Random) -> list[Act]:
    lasts_s = random.uniform(0.1, 1.0)
    return [Act(0, "loss", random.uniform(0.2, 1.0), lasts_s + SHOWS_S), Act(lasts_s, "loss", 0.0)]


# Moments that an act may wait for.
MOMENTS: Final[dict[str, Callable[[Plant], bool]]] = {
    "": lambda _: True,
    "released": lambda plant: plant.mode == AUTO and not plant.braked and not plant.speed_mps,
    "accelerating": lambda plant: plant.mode == AUTO and abs(plant.speed_mps) > 0.2,
    "downhill": lambda plant: plant.speed_mps * plant.load_mps2 < 0 and abs(plant.slope_deg) > 5,
    "braked": lambda plant: plant.mode == AUTO and plant.braked and not plant.speed_mps,
}
DISTURBANCES: Final[dict[str, Callable[[Random], list[Act]]]] = {
    "slope": _slope,
    "motor": _motor,
    "pedal": _pedal,
    "overspeed": _overspeed,
    "stuck steering": _stuck,
    "hand": _hand,
    "button": _button,
    "remote control": _remote,
    "reboot": _reboot,
    "freeze": _freeze,
    "frozen speed": _frozen_speed,
    "blocked": _blocked,
    "motor dies": _motor_dies,
    "remote control unseen": _remote_unseen,
    "body away": _body_away,
    "brake": _brake,
    "part of a burst": _part,
    "bumper": _touch,
    "losses": _losses,
}


def _legs(random: Random, speed_limit_mps: float) -> list[Leg]:
    legs: list[Leg] = []
    sign = random.choice((-1.0, 1.0, 1.0))
    while sum(leg.lasts_s for leg in legs) < SCRIPT_S:
        speed_mps = sign * random.choice((0.1, 0.3, 0.5, 1.0, speed_limit_mps, 3.0))
        angle_deg = random.choice((0.0, 0.0, random.uniform(-30, 30)))
        drive = Leg(random.uniform(1.0, 4.0), speed_mps, angle_deg)
        match random.choice(
            ("release", "release", "release", "hold", "reverse", "steer", "verb", "silence", "park")
        ):
            case "release":
                legs += [drive, Leg(random.uniform(0.1, 1.5), 0.0, angle_deg)]
            case "hold":
                legs += [drive, Leg(random.uniform(2.5, 6.0)), Leg(2.0, speed_mps)]
            case "reverse":
                sign = -sign
                legs += [drive, Leg(random.uniform(1.0, 3.0), -speed_mps, angle_deg)]
            case "steer":
                legs += [drive, Leg(random.uniform(0.5, 2.0), speed_mps, -angle_deg)]
            case "verb":
                legs += [
                    drive,
                    Leg(random.uniform(1.0, 3.0), speed_mps, verb=random.choice(("stop", "disengage"))),
                ]
            case "silence":
                legs += [drive, Leg(random.uniform(0.1, 2.5), streams=False)]
            case _:
                legs += [drive, Leg(random.uniform(0.0, 1.0)), Leg(random.uniform(0.3, 2.0), verb="park")]
                legs += [Leg(random.choice((0.1, 1.0)), verb="unpark")]
    return legs


def _legs_by_stick(random: Random, speed_limit_mps: float) -> list[Leg]:
    """Taps, turns and gaps, most of them shorter than a ramp, some slower than standstill's bound."""
    legs: list[Leg] = []
    while sum(leg.lasts_s for leg in legs) < SCRIPT_S:
        speed_mps = random.choice((-1.0, 1.0, 1.0)) * random.choice(
            (0.02, 0.04, 0.1, random.uniform(0, speed_limit_mps))
        )
        angle_deg = random.choice((0.0, random.uniform(-30, 30)))
        legs.append(Leg(random.uniform(0.04, 1.2), speed_mps, angle_deg))
        match random.choice(("tap", "turn", "gap", "go on")):
            case "tap":
                legs.append(Leg(random.uniform(0.02, 1.5), 0.0, angle_deg))
            case "turn":
                legs.append(Leg(random.uniform(0.1, 2.0), -speed_mps, -angle_deg))
            case "gap":
                legs.append(Leg(random.uniform(0.1, 0.6), streams=False))
    return legs


def _command(random: Random, speed_limit_mps: float, link_s: float) -> CommandSettings:
    """In every third scenario all settings are random; the link allows commands of that age."""
    if random.random() < 2 / 3:
        return CommandSettings(speed_limit_mps=speed_limit_mps)
    deceleration_mps2 = random.uniform(0.3, 2.0)
    return CommandSettings(
        lease_s=random.uniform(0.5, 10.0),
        deadman_s=random.uniform(0.05, 0.5),
        max_age_s=random.uniform(2 * link_s + 0.15, 1.0),
        travel_delay_m=random.uniform(0.2, 5.0),
        speed_limit_mps=speed_limit_mps,
        acceleration_mps2=random.uniform(0.1, 1.5),
        deceleration_mps2=deceleration_mps2,
        emergency_deceleration_mps2=random.uniform(max(0.5, deceleration_mps2), 3.0),
        steering_limit_deg=random.uniform(1.0, 24.0),
        steering_rate_degps=random.uniform(5.0, 60.0),
        lateral_acceleration_mps2=random.uniform(0.2, 3.0),
        idle_s=random.choice((0.0, 300.0, 3.0)),
        warning_s=random.choice((0.0, 0.0, random.uniform(0.2, 1.5))),
    )


def scenario(seed: int) -> Scenario:
    """The scenario of a seed. In every third one the operator has a stick."""
    random = Random(seed)  # noqa: S311 - scenarios keep no secrets
    kind = random.choices(("undisturbed", "disturbed", "guard", "found"), (30, 50, 15, 5))[0]
    found = frozenset({random.choice((DRIVE, BODY, WHEELS))} if kind == "found" and random.random() < 0.6 else ())
    build = Build(
        fine=random.random() < 0.5,
        payload_kg=random.choice((0.0, 100.0, random.uniform(0, 100))),
        stop_mode=random.choice(("brakes", "coasts", "parks")),
        drive_lag_s=random.choice((0.05, 0.15, 0.4, random.uniform(0.05, 0.4))),
        steering_lag_s=random.uniform(0.05, 0.2),
        brake_delay_s=random.choice((0.0, 0.05, 0.15)),
        battery=random.choice((1.0, 1.0, 1.0, random.uniform(0.6, 1.0))),
        parks_motor=random.random() < 0.5,
        pulses_per_m=random.uniform(200, 3000),
        is_noisy=random.random() < 0.4,
        missing=found or frozenset({BRAKING, LIGHT, SPEAKER} if random.random() < 0.05 else ()),
    )
    is_lossy = random.random() < 0.5
    speed_limit_mps = random.choice((2.222, 2.222, 1.0, 0.5))
    link_s = random.choice((0.0, 0.02, 0.1))
    names: list[str] = []
    acts: list[Act] = []
    if kind == "disturbed":
        for _ in range(random.randint(1, 3)):
            name = random.choice(list(DISTURBANCES))
            at_s = random.uniform(2.0, SCRIPT_S)
            names.append(name)
            acts += [msgspec.structs.replace(act, at_s=at_s + act.at_s) for act in DISTURBANCES[name](random)]
    fails_s = random.uniform(2.5, SCRIPT_S) if kind == "guard" else 0.0
    guard_dies = bool(fails_s) and random.random() < 0.25
    if kind in {"guard", "found"}:
        names.append(kind)
    return Scenario(
        seed=seed,
        build=build,
        slope_deg=random.choice(
            (0.0, random.uniform(-20, 20), random.uniform(-20, 20), random.choice((-20.0, 20.0)))
        ),
        pedal_gain=random.choice((0.0, 0.0, 0.3, 1.0)),
        command=_command(random, speed_limit_mps, link_s),
        finds_variant=random.random() < 0.25,
        link_s=link_s,
        loss=LOSS if is_lossy else 0.0,
        corruption=CORRUPTION if is_lossy else 0.0,
        legs=(_legs if seed % 3 else _legs_by_stick)(random, speed_limit_mps),
        gives_up_s=random.uniform(0.3, 2.0),
        recovers=random.random() < 0.8,
        acts=sorted(acts, key=lambda act: act.at_s),
        disturbances=names,
        found_mps=random.uniform(0.3, 1.8) if kind == "found" else 0.0,
        fails_s=fails_s,
        hangs_s=random.choice((FOREVER_S, FOREVER_S if guard_dies else random.uniform(0.15, 2.0)))
        if fails_s
        else 0.0,
        guard_dies=guard_dies,
        returns_s=random.choice((0.4 if guard_dies else 0.0, random.uniform(0.4, 8.0))) if fails_s else 0.0,
        rests_s=35.0 if "brake" in names else 5.0,
        limit_s=LIMIT_S + 35.0 if "brake" in names else LIMIT_S,
    )


def _variant(plan: Scenario) -> Literal["auto", "fine", "coarse"]:
    if plan.finds_variant:
        return "auto"
    return "fine" if plan.build.fine else "coarse"


class Play:
    """A scenario being played; ``began_m`` is the way travelled at the first act."""

    def __init__(
        self,
        plan: Scenario,
        *,
        keeps: bool,
        watch: Callable[[Play], None] | None = None,
        judge: type[Oracle] = Oracle,
    ) -> None:
        self._watch = watch
        random = Random(plan.seed + 1)  # noqa: S311 - scenarios keep no secrets
        self.plan = plan
        self.plant = Plant(plan.build, random, plan.slope_deg)
        self.plant.pedal_gain = plan.pedal_gain
        if plan.found_mps:
            self.plant.found_driving(random.choice((GEAR_D, GEAR_R)), plan.found_mps)
        self._random, self._keeps = random, keeps
        self._settings = settings = Settings(
            command=plan.command,
            chassis=ChassisSettings(variant=_variant(plan)),
        )
        self.oracle = judge(
            plan.command,
            fine=plan.build.fine,
            is_undisturbed=plan.is_undisturbed,
            lag_s=plan.build.drive_lag_s,
        )
        self.oracle.finds_variant = plan.finds_variant
        self.gateway = Gateway(settings, random, keeps=keeps)
        operator = Operator(plan.legs, gives_up_s=plan.gives_up_s, recovers=plan.recovers)
        bus = Bus(random, plan.loss, plan.corruption)
        guard = Guard(settings.command) if plan.fails_s else None
        self.rig = Rig(self.plant, self.gateway, operator, bus, self.oracle, guard)
        self.rig.link_ns = round(plan.link_s * 1e9)
        self.oracle.is_damaged = lambda: self.rig.now_s - max(bus.failed_ns, bus.passed_ns) / 1e9 < DAMAGE_SHOWS_S
        self._acts = list(plan.acts)
        self.began_m: float | None = None
        self._checks = self._expectations()

    def run(self) -> Result:
        """Play it to its end."""
        rig, plan = self.rig, self.plan
        end_s = plan.limit_s
        while rig.now_s < end_s:
            self._turn_knobs()
            rig.tick()
            if self._watch is not None:
                self._watch(self)
            if rig.operator.is_done:
                end_s = min(end_s, rig.now_s + plan.rests_s)
                rig.operator.is_done = False
        oracle = self.oracle
        return Result(
            plan.seed,
            list(oracle.violations.values()),
            oracle.stops,
            oracle.was_driven_m,
            rig.now_s,
            0.0 if self.began_m is None else self.plant.travelled_m - self.began_m,
            plan.disturbances,
        )

    def _expectations(self) -> list[tuple[float, Callable[[float], None]]]:
        oracle, plan = self.oracle, self.plan
        checks: list[tuple[float, Callable[[float], None]]] = []
        if plan.found_mps:
            checks = [
                (1.2, lambda now_s: oracle.expect_frames(now_s, "found_moving_ignored")),
                (
                    1.2 + plan.found_mps / plan.command.deceleration_mps2 + 4.0,
                    lambda now_s: oracle.expect_rest(now_s, "found_moving_no_rest", 0.0),
                ),
            ]
            self.rig.operator.wait_until(8.0)
        if plan.fails_s:
            checks = [
                (plan.fails_s, self._fail_gateway),
                (plan.fails_s + plan.hangs_s, self._revive_gateway),
            ]
        return checks

    def _fail_gateway(self, now_s: float) -> None:
        rig, oracle = self.rig, self.oracle
        rig.hangs, rig.dead = True, self.plan.hangs_s == FOREVER_S
        next_s = now_s + (self.plan.returns_s or FOREVER_S)
        if rig.dead:
            self._checks.append((next_s, self._begin_gateway))
        if self.plan.guard_dies:
            rig.guards.clear()
            oracle.all_fail(now_s, next_s)
        elif oracle.is_commanded:
            speed_mps = abs(self.plant.speed_mps)
            self._checks.append((now_s + GUARD_S, lambda at_s: oracle.expect_frames(at_s, "guard_late")))
            rest_s = now_s + speed_mps / self.plan.command.deceleration_mps2 + 4.0
            if rig.dead and next_s > rest_s:
                # One that comes back may drive again by then.
                self._checks.append((rest_s, lambda at_s: oracle.expect_rest(at_s, "guard_no_rest", now_s)))
            oracle.gateway_fails(now_s)

    def _revive_gateway(self, now_s: float) -> None:
        del now_s
        self.rig.hangs = False

    def _begin_gateway(self, now_s: float) -> None:
        rig, oracle = self.rig, self.oracle
        if self.plan.guard_dies and oracle.is_commanded and abs(self.plant.speed_mps) > MOVES_MPS:
            rest_s = rig.now_s + 1.0 + abs(self.plant.speed_mps) / self.plan.command.deceleration_mps2 + 4.0
            self._checks += [
                (rig.now_s + 1.2, lambda at_s: oracle.expect_frames(at_s, "found_moving_ignored")),
                (rig.now_s + 1.2, lambda at_s: oracle.expect_latched(at_s, "found_moving_not_latched")),
                (rest_s, lambda at_s: oracle.expect_rest(at_s, "found_moving_no_rest", now_s)),
            ]
        self.gateway = Gateway(
            self._settings,
            self._random,
            keeps=self._keeps,
            now_ns=rig.now_ns,
            stopped_before=any(guard.has_stopped for guard in rig.guards[-1:]),
            crashed=True,
        )
        rig.succeed(self.gateway, Guard(self._settings.command))
        oracle.gateway_returns()

    def _turn_knobs(self) -> None:
        now_s = self.rig.now_s
        due = [check for check in self._checks if now_s >= check[0]]
        for check in due:
            self._checks.remove(check)
            check[1](now_s)
        if self.oracle.is_damaged():
            self.oracle.disturb(now_s, SHOWS_S)
        for act in [act for act in self._acts if now_s >= act.at_s and MOMENTS[act.when](self.plant)]:
            self._acts.remove(act)
            self._turn(act, now_s)

    def _turn(self, act: Act, now_s: float) -> None:
        rig, plant, oracle = self.rig, self.plant, self.oracle
        self._acts += [msgspec.structs.replace(after, at_s=now_s + after.at_s) for after in act.then]
        if self.began_m is None:
            self.began_m = plant.travelled_m
        if act.shows_s:
            oracle.disturb(now_s, act.shows_s)
        match act.knob:
            case "reboot":
                plant.reboot(act.value)
                oracle.blind(now_s, act.value)
            case "away":
                oracle.blind(now_s, max(0.0, act.shows_s - SHOWS_S))
                rig.bus.go(away=act.value)
                oracle.loses_bus()
            case "most":
                oracle.blind(now_s, max(0.0, act.shows_s - SHOWS_S))
                rig.bus.most = act.value
            case "touch":
                plant.touch(act.value)
                oracle.touch(now_s)
            case "ask":
                rig.ask(act.value)
            case "loss":
                oracle.blind(now_s, max(0.0, act.shows_s - SHOWS_S))
                rig.bus.loss = act.value or self.plan.loss
            case knob:
                setattr(plant, knob, act.value)


def run(seed: int, *, runs_again: bool = False, watch: Callable[[Play], None] | None = None) -> Result:
    """Play a seed's scenario, and rerun its journal too if ``runs_again``; ``watch`` is called after each tick."""
    play = Play(scenario(seed), keeps=runs_again, watch=watch)
    result = play.run()
    difference = play.gateway.differs_when_run_again() if runs_again else ""
    if difference:
        result.violations.append(Violation("run_again_differs", play.rig.now_s, difference))
    return result

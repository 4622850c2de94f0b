"""Faults that are aimed, one at a time, and the metres that each may cost: the default chassis, empty, 2.2 m/s."""

from typing import Final

import msgspec
import pytest

from schemas.settings import CommandSettings
from tests.support.nights import every_value
from tests.system.scenarios.plant import BODY, DRIVE, PERIOD_STEPS, WHEELS, Build
from tests.system.scenarios.rig import Leg
from tests.system.scenarios.scenario import FOREVER_S, Act, Play, Result, Scenario

ALL: Final = frozenset(PERIOD_STEPS)
SPEED: Final = frozenset({DRIVE, WHEELS})
FULL_MPS: Final = 2.222
# Before the first speed, amid the ramp, after it, and as the next one begins.
STANDS_S, UNDER_WAY_S, FAST_S, LETS_GO_S = 1.0, 3.3, 6.0, 7.9


def aimed(
    *acts: Act,
    mps: float = FULL_MPS,
    slope_deg: float = 0.0,
    ends: tuple[Leg, ...] = (Leg(9.0, FULL_MPS),),
    deceleration_mps2: float = 1.2,
    build: Build | None = None,
    rests_s: float = 5.0,
) -> Scenario:
    """Stand for a second, drive for 6 s, then the legs of ``ends``, with these disturbances."""
    return Scenario(
        seed=1,
        build=build or Build(),
        slope_deg=slope_deg,
        pedal_gain=0.0,
        command=CommandSettings(speed_limit_mps=FULL_MPS, deceleration_mps2=deceleration_mps2),
        link_s=0.02,
        loss=0.0,
        corruption=0.0,
        legs=[Leg(1.0), Leg(6.0, mps), *ends],
        gives_up_s=1.0,
        recovers=False,
        acts=sorted(acts, key=lambda act: act.at_s),
        disturbances=["aimed"],
        limit_s=30.0 + rests_s,
        rests_s=rests_s,
    )


def frozen(frames: frozenset[int], at_s: float, when: str = "") -> Act:
    """These frames repeat their values for ever."""
    return Act(at_s, "frozen", frames, FOREVER_S, when)


def dying(phase_s: float, mps: float, deceleration_mps2: float) -> Scenario:
    """The motor dies down 20 deg, so long after the operator's release."""
    dies = Act(LETS_GO_S + phase_s, "motor_strength", 0.0, FOREVER_S)
    return aimed(dies, mps=mps, slope_deg=-20.0, ends=(Leg(6.0),), deceleration_mps2=deceleration_mps2)


def slipping(grip: float, creep_mps: float, end: Leg) -> Scenario:
    """The parking brake does not hold up 20 deg once applied, with the motor off."""
    fails = Act(LETS_GO_S, "brake_grip", grip, FOREVER_S, "braked", (Act(0, "brake_creep_mps", creep_mps),))
    build = Build(parks_motor=True, stop_mode="coasts")
    return aimed(fails, mps=0.5, slope_deg=20.0, ends=(Leg(0.5), end), build=build, rests_s=30.0)


WAYS: Final[dict[str, tuple[Scenario, float]]] = {
    "all frozen at standstill": (aimed(frozen(ALL, STANDS_S, "released")), 4.0),
    "speed frozen at standstill": (aimed(frozen(SPEED, STANDS_S, "released")), 4.0),
    "all frozen in mid-acceleration": (aimed(frozen(ALL, UNDER_WAY_S)), 5.0),
    "speed frozen in mid-acceleration": (aimed(frozen(SPEED, UNDER_WAY_S)), 5.0),
    "held from standstill": (aimed(Act(STANDS_S, "blocked", value=True, shows_s=FOREVER_S)), 0.01),
    **{
        f"a brake with a grip of {grip}, creeping at {creep_mps}, in {name}": (slipping(grip, creep_mps, end), 0.3)
        for name, end in (("a stop", Leg(9.0, verb="stop", streams=False)), ("auto-hold", Leg(9.0)))
        for grip, creep_mps in ((0.0, 0.0), (0.3, 0.0))
    },
}


def play(plan: Scenario) -> Result:
    return Play(plan, keeps=False).run()


@pytest.mark.parametrize(("plan", "bound_m"), WAYS.values(), ids=WAYS)
def test_a_fault_costs_no_more_than_so_many_metres(plan: Scenario, bound_m: float) -> None:
    """From the fault on, with no rule broken."""
    result = play(plan)
    assert result.violations == []
    assert result.way_m < bound_m


@pytest.mark.parametrize(
    ("fast", "ramp_mps2", "phase_s"), every_value(((1.0, 1.0), (2.0, 1.8)), (0.3, 1.2, 2.0), (-1.0, 0.1, 0.4))
)
def test_a_motor_that_dies_downhill_costs_no_more(
    fast: tuple[float, float], ramp_mps2: float, phase_s: float
) -> None:
    """At a speed and within so many metres, so long after the release."""
    result = play(dying(phase_s, fast[0], ramp_mps2))
    assert result.violations == []
    assert result.way_m < fast[1]


@pytest.mark.parametrize("at_s", [STANDS_S, UNDER_WAY_S, FAST_S])
def test_a_robot_that_is_held_gives_up_and_does_not_jump(at_s: float) -> None:
    """Within 2 s of the command; nothing jumps when it comes free."""
    told_s, gave_up_s = [], []

    def watch(it: Play) -> None:
        if it.plant.blocked and it.oracle.is_told_to_move:
            told_s.append(it.rig.now_s)
        if it.plant.blocked and told_s and not it.gateway.state["engaged"]:
            gave_up_s.append(it.rig.now_s)

    plan = aimed(Act(at_s, "blocked", 1, FOREVER_S, then=(Act(5.0, "blocked", 0),)))
    result = Play(plan, keeps=False, watch=watch).run()
    assert result.violations == []
    assert gave_up_s[0] - told_s[0] < 2.0


@pytest.mark.parametrize(("phase", "away_s", "verbs"), every_value(range(0, 10, 3), (0.05, 0.3), ((), ("stop",))))
def test_the_remote_control_is_told_no_speed_when_the_bus_returns(
    phase: int, away_s: float, verbs: tuple[str, ...]
) -> None:
    """Whenever it took over meanwhile, whatever stop is owed."""
    plan = aimed(
        Act(FAST_S, "away", value=True, shows_s=away_s + 3.0),
        Act(FAST_S + away_s, "away", value=False),
        Act(FAST_S + away_s * phase / 10, "sticks", (0.5, 0.0), 5.0, then=(Act(2.0, "sticks", None),)),
        *(Act(FAST_S + 0.02, "ask", verb) for verb in verbs),
    )
    assert play(plan).violations == []


@pytest.mark.parametrize("away_s", [0.4, 0.5, 0.6])
def test_a_robot_that_is_given_back_does_not_drive_off(away_s: float) -> None:
    """The body frames were missing while the remote control took over."""
    plan = aimed(
        Act(FAST_S, "silent", frozenset({BODY}), FOREVER_S, then=(Act(away_s, "silent", frozenset()),)),
        Act(FAST_S + 0.2, "sticks", (0.0, 0.0), FOREVER_S, then=(Act(3.0, "sticks", None),)),
    )
    assert play(plan).violations == []


@pytest.mark.parametrize(("most", "lasts_s"), every_value(range(2, 7), (0.05, 20.0)))
def test_the_brake_comes_through_where_bursts_go_out_in_part(most: int, lasts_s: float) -> None:
    """A stop ends with the parking brake applied, even if the bus takes two frames a burst."""
    cut = Act(FAST_S, "most", most, lasts_s + 3.0, then=(Act(lasts_s, "most", None),))
    it = Play(aimed(cut, Act(FAST_S + 0.02, "ask", "stop")), keeps=False)
    assert it.run().violations == []
    assert (it.plant.braked, it.plant.speed_mps) == (True, 0.0)


@pytest.mark.parametrize("mps", [0.5, 1.5])
def test_a_robot_that_nobody_commands_any_more_is_found_and_latched(mps: float) -> None:
    """Gateway and guard died together, and only a gateway returns."""
    plan = msgspec.structs.replace(
        aimed(mps=mps), fails_s=FAST_S, hangs_s=FOREVER_S, guard_dies=True, returns_s=2.0
    )
    assert play(plan).violations == []

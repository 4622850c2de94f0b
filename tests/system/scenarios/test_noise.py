"""A long drive on a bus that loses and damages frames, and nothing else wrong: does the robot stop for nothing?

An hour of it is played each night (``tests/nightly``).
"""

from random import Random

from schemas.settings import CommandSettings
from tests.system.scenarios.plant import Build
from tests.system.scenarios.rig import Leg
from tests.system.scenarios.scenario import CORRUPTION, DAMAGE_SHOWS_S, LOSS, Play, Scenario

SECONDS = 40.0


def causeless_stops(seed: int, seconds: float) -> list[str]:
    """Drive for so long, with 1 % of the frames lost and 0.1 % damaged.

    One in 36 damaged frames passes for a whole one, because two wrong bits may cancel out in the XOR checksum. A
    stop at one that can have said that a bumper was hit or that the mode changed has a cause: it reads true.
    """
    stops: list[str] = []
    was_engaged = False

    def watch(play: Play) -> None:
        nonlocal was_engaged
        is_engaged = bool(play.gateway.state.get("engaged"))
        is_misled = play.rig.now_ns - play.rig.bus.passed_ns < DAMAGE_SHOWS_S * 1e9
        if was_engaged and not is_engaged and not is_misled:
            stops.append(f"{play.rig.now_s:.2f} s: {play.gateway.state['stop_reason']}")
        was_engaged = is_engaged

    random = Random(seed)  # noqa: S311 - scenarios keep no secrets
    plan = Scenario(
        seed=seed,
        build=Build(fine=seed % 2 == 0),
        slope_deg=random.choice((-5.0, 0.0, 5.0)),
        pedal_gain=0.0,
        command=CommandSettings(),
        link_s=0.02,
        loss=LOSS,
        corruption=CORRUPTION,
        legs=_legs(random, seconds),
        gives_up_s=1.0,
        recovers=True,
        acts=[],
        disturbances=[],
        limit_s=seconds,
    )
    result = Play(plan, keeps=False, watch=watch).run()
    assert result.driven_m > 0.3 * seconds
    assert result.violations == []
    return stops


def _legs(random: Random, seconds: float) -> list[Leg]:
    """Speeds and angles to and fro, until after the drive: that the operator falls silent is a cause to stop."""
    legs: list[Leg] = []
    while sum(leg.lasts_s for leg in legs) < seconds:
        speed_mps = random.choice((-1, 1)) * random.choice((0.1, 0.3, 0.5, 1.0, 2.0))
        angle_deg = random.choice((0.0, 0.0, random.uniform(-20, 20)))
        legs += [
            Leg(random.uniform(2.0, 15.0), speed_mps, angle_deg),
            Leg(random.uniform(0.5, 5.0), 0.0, angle_deg),
        ]
    return legs


def test_lost_and_damaged_frames_are_no_cause_to_stop() -> None:
    """What is lost is ridden out, and what is damaged is not believed."""
    assert causeless_stops(1, SECONDS) == []

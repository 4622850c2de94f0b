"""Deaths of the gateway, at each stage of a short drive, in each of some circumstances."""

from __future__ import annotations

from typing import Any, Final

from msgspec.structs import replace

from schemas.settings import CommandSettings
from tests.system.scenarios.plant import BODY, DRIVE, PARKING, WHEELS, Build
from tests.system.scenarios.rig import Leg
from tests.system.scenarios.scenario import FOREVER_S, SHOWS_S, Act, Scenario

# Standby, just engaged, setting off, driving, in a bend, in reverse, in the deadman's stop, parked by it.
AT_S: Final = (0.8, 1.2, 1.9, 3.0, 4.4, 7.0, 8.1, 9.0)
LASTS_S: Final = 7.0  # from the death to the end
DRIVE_OFF: Final = Scenario(
    seed=0,
    build=Build(),
    slope_deg=0.0,
    pedal_gain=0.0,
    command=CommandSettings(speed_limit_mps=1.0),
    link_s=0.02,
    loss=0.0,
    corruption=0.0,
    legs=[
        Leg(2.0, 1.0),
        Leg(1.5, 1.0, 15.0),
        Leg(2.5, -0.5, -10.0),
        Leg(2.0, streams=False),
        Leg(9.0, 0.3),
    ],
    gives_up_s=0.5,
    recovers=True,
    acts=[],
    disturbances=[],
    hangs_s=FOREVER_S,
)

Turns = tuple[tuple[float, str, Any], ...]  # knobs: when, counted from the death, which one, and its value
BUILT_FINE: Final = Build(fine=True, stop_mode="coasts", payload_kg=80.0)

CIRCUMSTANCES: Final[dict[str, tuple[dict[str, Any], Turns]]] = {
    "coarse": ({}, ()),
    "fine": ({"build": BUILT_FINE}, ()),
    "found-variant": ({"finds_variant": True, "build": replace(BUILT_FINE, is_noisy=True)}, ()),
    "parks": ({"build": Build(stop_mode="parks", parks_motor=True)}, ()),
    "slow-brake": ({"build": Build(brake_delay_s=0.15, drive_lag_s=0.4, steering_lag_s=0.2)}, ()),
    "uphill": ({"slope_deg": 12.0}, ()),
    "downhill": ({"slope_deg": -12.0, "build": BUILT_FINE}, ()),
    "brake-slips": ({"slope_deg": -9.0}, ((-0.5, "brake_grip", 0.2),)),
    "motor-dies": ({"slope_deg": -6.0}, ((0.0, "motor_strength", 0.0),)),
    "lossy": ({"loss": 0.05, "corruption": 0.01}, ()),
    "hangs-briefly": ({"hangs_s": 0.3}, ()),
    "hangs": ({"hangs_s": 2.0}, ()),
    "returns-at-once": ({"returns_s": 0.4}, ()),
    "returns": ({"returns_s": 4.0}, ()),
    "guard-dies-too": ({"guard_dies": True, "returns_s": 1.0}, ()),
    "remote-control": ({}, ((-0.1, "sticks", (0.3, 0.0)), (1.0, "sticks", None))),
    "bus-away": ({}, ((0.05, "away", True), (0.6, "away", False))),
    "part-of-a-burst": ({}, ((-0.02, "most", 3), (0.08, "most", 1), (0.3, "most", None))),
    "bumper": ({}, ((0.1, "touch", "front"),)),
    "silent": ({}, ((0.0, "silent", frozenset({BODY, DRIVE, PARKING, WHEELS})), (2.5, "silent", frozenset()))),
}


def _death(name: str, at_s: float) -> Scenario:
    changes, turns = CIRCUMSTANCES[name]
    acts = [Act(at_s + since_s, knob, value, FOREVER_S + SHOWS_S) for since_s, knob, value in turns]
    changes = {"disturbances": [name], "acts": acts, "fails_s": at_s, "limit_s": at_s + LASTS_S, **changes}
    return replace(DRIVE_OFF, **changes)


DEATHS: Final = {f"{name}@{at_s}": _death(name, at_s) for name in CIRCUMSTANCES for at_s in AT_S}

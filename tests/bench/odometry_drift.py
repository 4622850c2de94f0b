"""Drift of the odometry against the virtual chassis's true pose.

The virtual chassis follows the bicycle model without slip, so this is the error of rounding, sampling and
integration.
"""

from __future__ import annotations

from math import degrees, hypot, remainder, tau
from typing import Final

import msgspec

from schemas.messages import Odometry, Variant
from tests.bench.loads import Row
from tests.support.rigs.gateway import ready

# Parts of a trip: speed in m/s, steering angle in degrees, share of the time.
TRIPS: Final = {
    "straight": [(1.5, 0.0, 1.0)],
    "circle": [(1.0, 18.0, 1.0)],
    "slalom": [(1.0, 15.0, 0.5), (1.0, -15.0, 0.5)],
    "back and forth": [(1.0, 10.0, 0.5), (0.0, 10.0, 0.2), (-1.0, -10.0, 0.5), (0.0, -10.0, 0.2)],
}


class Drift(msgspec.Struct, frozen=True):
    """Drift of one trip: metres driven, metres off, degrees off."""

    way_m: float
    off_m: float
    off_deg: float


def measure(variant: Variant, trip: str, seconds: float) -> Drift:
    rig, operator = ready(variant)
    operator.engage()
    for speed_mps, angle_deg, share in TRIPS[trip]:
        operator.drive(speed_mps, angle_deg, share * seconds)
    operator.drive(0.0, seconds=3.0)
    payload = [sample.payload for _, sample in rig.recorded if sample.subject == "chassis/odometry"][-1]
    last, truth = msgspec.msgpack.decode(payload, type=Odometry), rig.chassis.state
    off_deg = degrees(abs(remainder(last.heading_rad - truth.yaw_rad, tau)))
    return Drift(last.distance_m, hypot(last.x_m - truth.x_m, last.y_m - truth.y_m), off_deg)


def rows(seconds: float) -> list[Row]:
    """The greatest drift of all trips per 100 m, by the scale of the speeds."""
    table = []
    for variant in (Variant.FINE, Variant.COARSE):
        trips = {trip: measure(variant, trip, seconds) for trip in TRIPS}
        name, worst = max(trips.items(), key=lambda one: one[1].off_m / one[1].way_m)
        turned = max(one.off_deg / one.way_m for one in trips.values()) * 100
        figure = f"odometry, {variant.value} speeds: drift in 100 m, of {len(trips)} trips, the most in {name}"
        table.append((figure, f"{worst.off_m / worst.way_m * 100:.2f} m, {turned:.2f} deg", ""))
    return table

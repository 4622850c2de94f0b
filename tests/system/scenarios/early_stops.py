"""Frozen frames of the early stop, byte for byte; ``--freeze`` writes them again.

Bursts that only repeat the one before are left to the hash at the end of their situation.
"""

from __future__ import annotations

from hashlib import blake2b
from pathlib import Path
from random import Random
from typing import Any, Final

from gateway.chassis.cruiser.early_stop import Command, EarlyStop
from gateway.chassis.frame import EXTENDED, IDENTIFIER_MASK
from tests.system.scenarios.plant import (
    BODY,
    DRIVE,
    GEAR,
    GEAR_D,
    GEAR_R,
    PARKING,
    PULSES,
    STEERING,
    STEP_NS,
    STEP_S,
    WHEELS,
    Build,
    Plant,
    orders,
)

FILE: Final = Path(__file__).parents[2] / "data" / "frozen" / "early_stops.txt"

LAST_STEP: Final = 1400  # seven seconds
ROLLS_S: Final = 1.0  # it drives for so long before its computer is up again
COASTS: Final = Build(stop_mode="coasts", brake_delay_s=0.15)
HEAVY: Final = Build(payload_kg=100.0, battery=0.6)

SITUATIONS: Final[dict[str, dict[str, Any]]] = {
    **{
        f"{'fine' if fine else 'coarse'} {'drive' if gear == GEAR_D else 'reverse'} {speed_mps}": {
            "build": Build(fine=fine),
            "found": (gear, speed_mps),
        }
        for fine in (False, True)
        for gear in (GEAR_D, GEAR_R)
        for speed_mps in (0.3, 1.5)
    },
    "in a bend": {"angle_deg": 17.0},
    "coasts": {"build": COASTS},
    "downhill": {"slope_deg": -15.0, "slope_target_deg": -15.0, "build": HEAVY},
    "the brake slips": {"slope_deg": -10.0, "slope_target_deg": -10.0, "brake_grip": 0.2, "build": COASTS},
    "the motor is dead": {"motor_strength": 0.0, "slope_deg": -4.0, "slope_target_deg": -4.0},
    "no drive feedback": {"silent": frozenset({DRIVE})},
    "no wheels": {"silent": frozenset({WHEELS, PULSES})},
    "pulses alone": {"silent": frozenset({WHEELS, DRIVE, BODY})},
    "no gear, no angle, no brake": {"silent": frozenset({GEAR, STEERING, PARKING})},
    "frozen drive feedback": {"frozen": frozenset({DRIVE})},
    "the button": {"button": True},
    "three frames of each fourth burst": {"takes": (4, 3)},
    "nothing of each fifth burst": {"takes": (5, 0)},
    "the remote control takes it": {"at": (0.3, "sticks", (0.4, 0.0))},
    "the controller restarts": {"at": (0.3, "reboot", 0.5)},
    "another computer commanded it": {"heard": orders(GEAR_D, 1.0, fine=False)},
}


def told(name: str) -> str:
    """Each burst with new content, and a hash of all with their times."""
    knobs = dict(SITUATIONS[name])
    plant = Plant(knobs.pop("build", Build()), Random(0))  # noqa: S311 - scenes keep no secrets
    plant.found_driving(*knobs.pop("found", (GEAR_D, 1.0)))
    heard, takes = knobs.pop("heard", {}), knobs.pop("takes", (LAST_STEP, 0))
    at_s, knob, value = knobs.pop("at", (0.0, "button", plant.button))
    for _ in range(round(ROLLS_S / STEP_S)):
        plant.step()
    for each, setting in knobs.items():
        setattr(plant, each, setting)
    early, before = EarlyStop(0), dict[int, bytes]()
    for identifier, data in heard.items():
        early.chassis.receive(identifier | EXTENDED, data, 0)
    lines, says = [name], list[str]()
    for step in range(1, LAST_STEP):
        if step == round(at_s / STEP_S):
            plant.reboot(value) if knob == "reboot" else setattr(plant, knob, value)
        burst = _step(plant, early, step * STEP_NS, takes, len(says) + 1)
        if burst:
            says.append(f"{step * STEP_S:.3f} {' '.join(f'{can_id:08X}#{data.hex()}' for can_id, data in burst)}")
            now = {can_id: data[:6] for can_id, data in burst}
            if now != before:
                lines.append(says[-1])
            before = now
    digest = blake2b("\n".join(says).encode(), digest_size=8).hexdigest()
    return "\n".join([*lines, f"{len(says)} bursts, {digest}: {early.outcome or 'not ended'}", ""])


def _step(plant: Plant, early: EarlyStop, now_ns: int, takes: tuple[int, int], number: int) -> list[Command]:
    for identifier, data in plant.step():
        early.chassis.receive(identifier | EXTENDED, data, now_ns)
    if early.is_needed(now_ns):
        early.begin(now_ns)
    burst = early.tick(now_ns)
    every, part = takes
    taken = burst if number % every else burst[:part]
    early.sent(len(taken), now_ns)
    for can_id, data in taken:
        plant.receive(can_id & IDENTIFIER_MASK, data)
    return burst


def frozen() -> str:
    return "\n".join(map(told, SITUATIONS))

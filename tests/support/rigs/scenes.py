"""Scenes of a robot: what is asked of it, what fails, and how the gateway rules, a step after the other.

A scene is steps with ";" between them. The first one is how it begins: "driving 1", "ready". One that begins with
"=" claims something, or several things with "," between them. What is in no table here is a fault of the chassis.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import msgspec
import pytest

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import ERROR, Frame
from gateway.choice import CHASSIS
from gateway.sim.body import Conditions
from gateway.sim.model import VirtualChassis
from schemas.decisions import ArbiterState, EventKind, Severity, StopPhase
from schemas.messages import ParkingStatus, Variant
from schemas.settings import CommandSettings
from tests.support.rigs.gateway import GUARDED, MS, driving, ready

FAST: Final = CommandSettings(speed_limit_mps=2.222, travel_delay_m=3.0)
CONTROLLER: Final = {"off": 0x40, "active": 0x100}


class Scene:
    """A robot and its operator. What has gone out since "mark" is counted from there."""

    def __init__(self, begin: str, variant: Variant) -> None:
        how, _, what = begin.partition(" ")
        if how == "driving":
            self.rig, self.operator = driving(float(what), variant=variant)
        elif how == "hill":
            slope_deg, *delay_s = map(float, what.split())
            self.rig, self.operator = ready(variant)
            conditions = Conditions(slope_deg, parking_delay_s=delay_s[0] if delay_s else 0.05)
            self.rig.chassis = VirtualChassis(CHASSIS, variant, self.rig.now_ns, conditions=conditions)
            self.operator.engage()
        else:
            command = FAST if what == "fast" else None
            self.rig, self.operator = ready(variant, command, accept_unguarded=what == "unguarded")
        self.mark()

    def mark(self) -> None:
        self.from_m = self.rig.chassis.state.x_m
        self.burst, self.frame, self.speed = len(self.rig.bursts), len(self.rig.out), len(self.rig.heard)

    def links(self, *changes: str) -> None:
        """What the loop sees from now on of bus and guard."""
        made = {name: int(value) for name, value in (one.split(":") for one in changes)}
        made |= {name: bool(value) for name, value in made.items() if isinstance(getattr(GUARDED, name), bool)}
        self.rig.links = msgspec.structs.replace(GUARDED, **made)

    def bus(self, state: str) -> None:
        """Lost with all that is on it, there again, or there again and silent."""
        self.links(f"bus_up:{int(state != 'lost')}", "bus_losses:1")
        self.rig.chassis_hears = state != "lost"
        self.rig.corrupt = lambda frame: frame if state == "again" else None

    def late(self, late_ms: str) -> None:
        """A tick with a drive command begins so late."""
        self.rig.late_ns = int(late_ms) * MS
        self.rig.put(self.operator.name, "drive", self.operator.drive_payload(1.0))
        self.rig.tick()
        self.rig.late_ns = 0

    def drive_until(self, speed_mps: str, claim: str) -> None:
        self.operator.drive(float(speed_mps))
        while not self.claims()[claim]():
            self.operator.drive(float(speed_mps))

    def reply(self, verb: str, *reasons: str) -> None:
        """A verb gets one of these replies."""
        reason = self.operator.take_lease(verb) if verb in {"acquire", "take"} else self.operator.reason(verb)
        assert reason.value in reasons, (verb, reason)

    def play(self, steps: str) -> None:
        rig, operator = self.rig, self.operator
        table: dict[str, Callable[..., object]] = {
            "drive": lambda *numbers: operator.drive(*map(float, numbers)),
            "wait": lambda seconds: rig.run(float(seconds)),
            "tick": lambda count: rig.tick(int(count)),
            "rest": lambda: rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 10),
            "hold": lambda: rig.until(lambda: rig.says.stop_phase is StopPhase.HOLD),
            "ask": operator.ask,
            "reply": self.reply,
            "engage": lambda limit="": operator.engage(**({"speed_limit_mps": float(limit)} if limit else {})),
            "takes": lambda count: setattr(rig, "takes", None if count == "all" else int(count)),
            "stands": lambda: rig.until(lambda: abs(rig.speed_mps) < 0.01),
            "parks": lambda speed_mps: self.drive_until(speed_mps, "parking"),
            "neutral": lambda speed_mps: self.drive_until(speed_mps, "neutral"),
            "forget": rig.chassis._commands.clear,
            "deaf": lambda: setattr(rig, "chassis_hears", False),
            "hears": lambda: setattr(rig, "chassis_hears", True),
            "unset": lambda name: rig.chassis.receive(
                Frame(load(Variant.COARSE).messages[name].can_id, bytes(8)), rig.now_ns
            ),
            "controller": lambda word: rig.core.receive_frame(
                Frame(ERROR | CONTROLLER[word], bytes(8)), rig.now_ns
            ),
            "links": self.links,
            "bus": self.bus,
            "late": self.late,
            "mark": self.mark,
        }
        for step in map(str.strip, steps.split(";")):
            word, *words = step.split()
            if word == "=":
                for claim in step[1:].split(","):
                    name, *of = claim.split()
                    assert self.claims()[name](*of), (claim, rig.says, rig.speed_mps, rig.told)
            elif word in table:
                table[word](*words)
            else:
                rig.fault(step)

    def denies(self, claim: str, *of: str) -> bool:
        return not self.claims()[claim](*of)

    def claims(self) -> dict[str, Callable[..., object]]:
        rig, says, told = self.rig, self.rig.says, self.rig.told
        since = [burst for _, burst in rig.bursts[self.burst :]]
        way_m = abs(rig.chassis.state.x_m - self.from_m)

        severities: dict[tuple[str, str], list[Severity]] = {}
        for event in rig.events:
            severities.setdefault((event.kind.value, event.reason.value), []).append(event.severity)

        def values(ones: Any) -> list[str]:  # noqa: ANN401 - of any enumeration
            return [one.value for one in ones]

        return {
            **{state.value: lambda state=state: says.state is state for state in ArbiterState},
            "stopped": lambda: not says.engaged,
            "for": lambda *reasons: says.stop_reason.value in reasons,
            "latched": lambda *reasons: {*values(says.latched)} == {*reasons},
            "has": lambda reason: reason in values(says.latched),
            "first": lambda *reasons: says.latched[0].value in reasons,
            "phase": lambda phase: says.stop_phase.value == phase,
            "limit": lambda speed_mps: says.speed_limit_mps == float(speed_mps),
            "mute": lambda: rig.core.command is not None and rig.core.command.is_mute,
            "ruled": lambda reason: rig.ruled().value == reason,
            "bound": lambda *by: values(rig.decided[-1].bound_by) == [*by],
            "events": lambda kind, *reasons: values(rig.event_reasons(EventKind(kind))) == [*reasons],
            "event": lambda kind, reason: reason in values(rig.event_reasons(EventKind(kind))),
            "error": lambda *of: severities.get(of) == [Severity.ERROR],
            "says": lambda *words: any(event.text.endswith(" ".join(words)) for event in rig.events),
            "rests": lambda: rig.speed_mps == 0,
            "moves": lambda speed_mps: rig.speed_mps == pytest.approx(float(speed_mps), abs=0.05),
            "parked": lambda: rig.chassis.state.parking_status is ParkingStatus.APPLIED,
            "way": lambda most_m, least_m="0": float(least_m) <= way_m < float(most_m),
            "told": lambda speed_mps: told and rig.told_mps == pytest.approx(float(speed_mps), abs=0.04),
            "below": lambda speed_mps: told and rig.told_mps < float(speed_mps),
            "mode": lambda mode: rig.chassis.state.mode.value == mode,
            "neutral": lambda: told["Auto_GearCmd"]["TargetGear"] == "neutral",
            "gear": lambda gear: told["Auto_GearCmd"]["TargetGear"] == gear,
            "parking": lambda: told["Auto_ParkingCmd"]["ParkingRequest"],
            "spoken": lambda: since,
            "silent": lambda: len(rig.out) == self.frame,
            "speechless": lambda: not any(burst["Auto_DriveCmd"]["TargetVelocity"] for burst in since),
            "braked": lambda: all(burst["Auto_ParkingCmd"]["ParkingRequest"] for burst in since),
            "falling": lambda: rig.heard[self.speed :] == sorted(rig.heard[self.speed :], reverse=True),
            **{
                f"un{name}": partial(self.denies, name) for name in ("parked", "parking", "event", "spoken", "has")
            },
        }


def play(scene: str, variant: Variant = Variant.COARSE) -> None:
    """Act a scene out."""
    begin, _, steps = scene.partition(";")
    Scene(begin.strip(), variant).play(steps)

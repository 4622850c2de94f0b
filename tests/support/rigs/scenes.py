"""Scenes of a robot: requests, faults and rulings, a step after the other.

The first step is how it begins: "driving 1", "ready", with settings as "name:value"; "hill DEGREES", with
conditions of the body; "new", which has seen nothing yet. A step in no table is a fault of the chassis. What has
gone out since "mark" is counted from there.
"""

from typing import Any, Final

import msgspec

from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import ERROR, FD, Frame, GateFault
from gateway.chassis.layout import Encoder
from gateway.chassis.port import Actuation
from gateway.choice.chassis import CHASSIS
from gateway.command.restart import Carried, is_at_rest
from gateway.core import Core
from gateway.sim.body import Conditions
from gateway.sim.model import VirtualChassis
from schemas.cruiser import SPEED_TOP_MPS
from schemas.decisions import ArbiterState, EventKind, Severity, StopPhase
from schemas.messages import GearPosition, ParkingStatus, Variant
from schemas.settings import HOLD_NS, YIELD_BURSTS, CommandSettings
from tests.support.rigs.gateway import GUARDED, MS, GatewayRig, Operator, driving, ready
from tests.support.rigs.steps import Acted, Doing, fields_of, near
from tests.support.strategies import with_checksum

FAST: Final = {"speed_limit_mps": SPEED_TOP_MPS, "travel_delay_m": 3.0}
CONTROLLER: Final = {"off": 0x40, "active": 0x100}
CAN_IDS: Final = {message.name: message.can_id for message in load(Variant.COARSE).feedback}
LAMPS: Final = {"Headlamp": "head", "LeftIndicator": "left", "RightIndicator": "right"}


def flipped(data: bytes, *bits: int) -> bytes:
    word = int.from_bytes(data, "little")
    for bit in bits:
        word ^= 1 << bit
    return word.to_bytes(8, "little")


def spoilt(frame: Frame, how: str, *of: str) -> Frame | None:
    match how:
        case "zeros":
            return Frame(frame.can_id, bytes(8))
        case "reversed":
            return Frame(frame.can_id, with_checksum(frame.data[6::-1] + b"\0"))
        case "length":
            length = int(of[0])
            return Frame(frame.can_id, (frame.data * 8)[:length], fd_flags=FD if length > 8 else 0)
        case "flipped":
            return Frame(frame.can_id, with_checksum(flipped(frame.data, *map(int, of))), frame.wall_ns)
        case "askew":
            values = {"Active": True, "Angle": 1.5}
            return Encoder(load(Variant.COARSE)).encode("Auto_SteeringFeedBack", values, frame.data[6] >> 4)
    return None


class Scene(Acted):
    def __init__(self, begin: str, variant: Variant = Variant.COARSE) -> None:
        how, *words = begin.split()
        fields = fields_of(tuple(words))
        variant = fields.pop("variant", variant)
        conditions = {name: fields.pop(name) for name in Conditions.__struct_fields__ if name in fields}
        if "fast" in words:
            fields = FAST | fields
        command = CommandSettings(**({"speed_limit_mps": SPEED_TOP_MPS} | fields)) if fields else None
        if how == "driving":
            self.rig, self.operator = driving(float(words[0]), variant=variant)
        elif how == "new":
            self.rig = GatewayRig(variant, command)
            self.operator = Operator(self.rig)
        else:
            self.rig, self.operator = ready(variant, command, accept_unguarded="unguarded" in words)
        if how == "hill":
            conditions = {"slope_deg": float(words[0])} | conditions
            self.rig.chassis = VirtualChassis(
                CHASSIS, variant, self.rig.now_ns, conditions=Conditions(**conditions)
            )
            self.operator.engage()
        self.variant = variant
        self.said = ""
        self.mark()

    def mark(self) -> None:
        rig = self.rig
        self.from_m, self.from_ns = rig.chassis.state.x_m, rig.now_ns
        self.was_mps, self.was_engaged = rig.told_mps, rig.state is not None and rig.says.engaged
        self.burst, self.frame, self.speed, self.tick = (
            len(rig.bursts),
            len(rig.out),
            len(rig.heard),
            len(rig.lived),
        )

    def links(self, *changes: str) -> None:
        """The state of bus and guard from now on."""
        made: dict[str, Any] = {}
        for name, _, value in (one.partition(":") for one in changes):
            kind = type(getattr(GUARDED, name))
            made[name] = value.replace("_", " ") if kind is str else kind(int(value))
        self.rig.links = msgspec.structs.replace(GUARDED, **made)

    def bus(self, state: str) -> None:
        self.links(f"bus_up:{int(state != 'lost')}", "bus_losses:1")
        self.rig.chassis_hears = state != "lost"
        self.rig.corrupt = lambda frame: frame if state == "again" else None

    def spoil(self, name: str, how: str, *of: str) -> None:
        """Each frame of this name; "once" and its name: only the next; "last": only that one, then none."""
        if name not in {"once", "last"}:
            self.rig.corrupt = lambda frame: spoilt(frame, how, *of) if name in {"all", *_named(frame)} else frame
            return
        left = [1]

        def once(frame: Frame) -> Frame | None:
            if how not in _named(frame) or (name == "once" and not left):
                return frame
            return spoilt(frame, *of) if left and left.pop() else None

        self.rig.corrupt = once

    def bounce(self, chatter_ms: str) -> None:
        """The front bumper's contact opens and closes."""

        def corrupt(frame: Frame) -> Frame | None:
            is_open = not self.rig.now_ns // MS // int(chatter_ms) % 2
            return (
                spoilt(frame, "flipped", "32")
                if is_open and "Auto_MileageAndBodyFeedback" in _named(frame)
                else frame
            )

        self.rig.corrupt = corrupt

    def once(self, speed_mps: str, angle_deg: str = "0", late_ms: str = "0") -> None:
        self.rig.late_ns = int(late_ms) * MS
        self.rig.put(self.operator.name, "drive", self.operator.drive_payload(float(speed_mps), float(angle_deg)))
        self.rig.tick()
        self.rig.late_ns = 0

    def driven(self, speed_mps: str, *claim: str) -> None:
        self.operator.drive(float(speed_mps))
        while not self.holds(*claim):
            self.operator.drive(float(speed_mps))

    def older(self, back: str) -> None:
        """Drive for a second with old challenges."""
        for _ in range(50):
            echoed = self.rig.published[-int(back)]
            self.rig.put("first", "drive", self.operator.drive_payload(2.0, challenge=echoed))
            self.rig.tick(2)

    def follows(self, speed_mps: str) -> None:
        """Drive for four seconds: the command is never more than 0.5 m/s above the true speed."""
        for _ in range(200):
            self.operator.drive(float(speed_mps))
            assert self.rig.told_mps <= max(0.5, self.rig.speed_mps + 0.5 + 0.04)

    def reply(self, verb: str, *words: str) -> None:
        """The verb's reply has one of these reasons."""
        fields, reasons = fields_of(words), [word for word in words if ":" not in word]
        if verb in {"acquire", "take"}:
            reason = self.operator.take_lease(verb, **fields)
        else:
            handle = self.operator.ask(verb, **fields)
            self.rig.tick()
            self.said, reason = self.rig.replies[handle].detail, self.rig.replies[handle].reason
        assert reason.value in reasons, (verb, reason)

    def detail(self, *words: str) -> None:
        assert " ".join(words) in self.said.replace(";", "|"), self.said

    def text(self, kind: str, *words: str) -> None:
        texts = [event.text.replace(";", "|") for event in self.rig.events if event.kind is EventKind(kind)]
        assert any(" ".join(words) in text for text in texts), texts

    def succeed(self, configured: str = "auto") -> None:
        """Another gateway begins beside the chassis as it is."""
        before = self.rig
        self.rig = GatewayRig(self.variant, configured=configured, now_ns=before.now_ns)
        self.rig.chassis = before.chassis
        self.operator = Operator(self.rig)
        self.mark()

    def restart(self) -> None:
        """Restart the gateway as the command does: another core begins with the note of latches."""
        rig = self.rig
        rig.core.shut_down(rig.now_ns)
        rig.tick()
        latches = rig.core.command.arbiter.latches  # type: ignore[union-attr]
        carried = Carried({reason.value: detail for reason, detail in latches.details.items()})
        rig.core = Core(CHASSIS, rig.settings, "1.2.3", rig.now_ns, 8)
        rig.core.take_over(carried, rig.now_ns)
        rig.events.clear()
        rig.recorded.clear()
        rig._counters.clear()
        rig.run(1)

    def refuse(self, count: str) -> None:
        """The gate refuses this many of the next bursts."""
        self.rig.gate_refuses = True
        gate = self.rig.core.command.gate  # type: ignore[union-attr]
        admit = type(gate).admit
        left = [GateFault(0x98C4D3D0, "because")] * int(count)
        gate.admit = lambda *burst, **how: left.pop() if left else admit(gate, *burst, **how)  # type: ignore[method-assign]

    def slip(self) -> None:
        self.rig.gate_refuses = True
        counters = self.rig.core.command.maker.counters  # type: ignore[union-attr]
        counters["Auto_DriveCmd"] = (counters["Auto_DriveCmd"] + 15) % 16

    def doubt(self) -> None:
        """There is evidence against the variant in force."""
        self.rig.core._detector.contradicted = True
        self.rig.core._apply_variant()

    def echo(self) -> None:
        """Frames of the guard are received."""
        for frame in FrameMaker().make(Actuation(enabled=True), [], Variant.COARSE):
            self.rig.core.receive_frame(frame, self.rig.now_ns)

    def steps(self) -> Doing:
        rig, operator = self.rig, self.operator
        body: Any = rig.chassis
        engagement: Any = rig.core.command.arbiter.engagement if rig.core.command is not None else None
        return {
            # Operators.
            "drive": lambda *numbers: operator.drive(*map(float, numbers)),
            "once": self.once,
            "driven": self.driven,
            "parks": lambda speed_mps: self.driven(speed_mps, "parking"),
            "neutral": lambda speed_mps: self.driven(speed_mps, "gear", "neutral"),
            "follows": self.follows,
            "older": self.older,
            "ask": lambda verb, *words: operator.ask(verb, **fields_of(words)),
            "reply": self.reply,
            "detail": self.detail,
            "text": self.text,
            "engage": lambda *words: operator.engage(**fields_of(words)),
            "renewing": lambda count: [operator.reason("renew") for _ in range(int(count))],
            "operator": lambda name: setattr(self, "operator", Operator(self.rig, name)),
            "stop": lambda: rig.put("anyone", "stop", b""),
            "send": lambda verb, name, payload="": rig.put(name.strip("-"), verb, bytes.fromhex(payload)),
            # Time.
            "wait": lambda seconds: rig.run(float(seconds)),
            "tick": lambda count: rig.tick(int(count)),
            "rest": lambda: rig.until(lambda: rig.says.state is ArbiterState.STANDBY, 10),
            "hold": lambda: rig.until(lambda: rig.says.stop_phase is StopPhase.HOLD),
            "stands": lambda: rig.until(lambda: abs(rig.speed_mps) < 0.01),
            "late": lambda late_ms: self.once("1", late_ms=late_ms),
            "lag": lambda late_ms: setattr(rig, "late_ns", int(late_ms) * MS),
            "wall": lambda seconds: setattr(rig, "wall_ns", rig.wall_ns + int(seconds) * 10**9),
            "mark": self.mark,
            # The chassis and its bus.
            "takes": lambda count: setattr(rig, "takes", None if count == "all" else int(count)),
            "forget": body._commands.clear,
            "shine": lambda: body._commands.update(
                Auto_LightCmd=dict.fromkeys(("LeftIndicator", "RightIndicator"), True)
            ),
            "deaf": lambda: setattr(rig, "chassis_hears", False),
            "hears": lambda: setattr(rig, "chassis_hears", True),
            "unset": lambda name: body.receive(
                Frame(load(Variant.COARSE).messages[name].can_id, bytes(8)), rig.now_ns
            ),
            "exchange": lambda: setattr(rig, "chassis", VirtualChassis(CHASSIS, self.variant, rig.now_ns)),
            "adopt": lambda speed_mps: body.adopt(
                speed_mps=float(speed_mps), angle_deg=0.0, gear=GearPosition.DRIVE, parked=False
            ),
            "corrupt": self.spoil,
            "bounce": self.bounce,
            "whole": lambda: setattr(rig, "corrupt", lambda frame: frame),
            "controller": lambda word: rig.core.receive_frame(
                Frame(ERROR | CONTROLLER[word], bytes(8)), rig.now_ns
            ),
            "links": self.links,
            "bus": self.bus,
            "echo": self.echo,
            # The gateway itself.
            "note": lambda *words: rig.core.latch_guard_stop(" ".join(words), rig.now_ns),
            "crash": lambda: rig.core.note_crash(rig.now_ns),
            "shutdown": lambda: rig.core.shut_down(rig.now_ns),
            "owe": lambda: setattr(engagement, "owes_stop", True),
            "sound": lambda: engagement.auxiliary.restore({}, horn=True),
            "doubt": self.doubt,
            "refuse": self.refuse,
            "slip": self.slip,
            "succeed": self.succeed,
            "restart": self.restart,
        }

    def other(self, step: str) -> None:
        self.rig.fault(step)

    def shown(self) -> object:
        return self.rig.state, self.rig.speed_mps, self.rig.told, self.rig.events[-3:]

    def _way_back_m(self, sign: float) -> float:
        """How far it has rolled back from its furthest place."""
        furthest_m, most_m = sign * self.from_m, 0.0
        for _, x_m, _, _ in self.rig.lived[self.tick :]:
            furthest_m = max(furthest_m, sign * x_m)
            most_m = max(most_m, furthest_m - sign * x_m)
        return most_m

    def _is_in_order(self) -> bool:
        """Zero speed in gear, parking brake, neutral, disabled: in this order, and never back."""
        reached, done = 0, 0
        for _, burst in self.rig.bursts[self.burst :]:
            marks = (
                not burst["Auto_DriveCmd"]["TargetVelocity"],
                bool(burst["Auto_ParkingCmd"]["ParkingRequest"]),
                burst["Auto_GearCmd"]["TargetGear"] == "neutral",
                not burst["Auto_ParkingCmd"]["Enable"],
            )
            done = marks.index(False) if False in marks else len(marks)
            if done < reached:
                return False
            reached = done
        return done == 4

    def _is_held(self) -> bool:
        """The brake is commanded at standstill; the gear stays until a second after the brake reads applied."""
        if not self.was_engaged:
            return True  # Loaded, it does not climb so steep a slope, and was stopped as it set off.
        lived, told = self.rig.lived[self.tick :], self.rig.bursts[self.burst :]
        stood_ns = next(at_ns for at_ns, _, speed_mps, _ in lived if not speed_mps)
        braked_ns = next(at_ns for at_ns, _, _, is_braked in lived if is_braked)
        parked_ns = next(at_ns for at_ns, burst in told if burst["Auto_ParkingCmd"]["ParkingRequest"])
        disabled_ns = next(at_ns for at_ns, burst in told if not burst["Auto_GearCmd"]["Enable"])
        gears = {burst["Auto_GearCmd"]["TargetGear"] for at_ns, burst in told if at_ns < disabled_ns}
        return parked_ns - stood_ns <= 100 * MS and disabled_ns - braked_ns >= HOLD_NS and gears == {"drive"}

    def _parks_as_it_stops(self) -> bool:
        rig = self.rig
        [stop] = [one for one in rig.events if one.kind is EventKind.STOP and one.reason is rig.says.latched[0]]
        return next(
            bool(burst["Auto_ParkingCmd"]["ParkingRequest"])
            for at_ns, burst in rig.bursts
            if rig.wall_ns - rig.now_ns + at_ns >= stop.time_ns
        )

    def _has_parted(self) -> bool:
        """The last bursts have zero speed, the same gear and the parking brake; the one before had a speed."""
        before, *last = [burst for _, burst in self.rig.bursts[-YIELD_BURSTS - 1 :]]
        return bool(before["Auto_DriveCmd"]["TargetVelocity"]) and all(
            not one["Auto_DriveCmd"]["TargetVelocity"]
            and one["Auto_GearCmd"]["TargetGear"] == "drive"
            and one["Auto_ParkingCmd"]["ParkingRequest"]
            for one in last
        )

    def claims(self) -> Doing:
        rig, says, told = self.rig, self.rig.says, self.rig.told
        flow: Any = rig.core.command
        since = [burst for _, burst in rig.bursts[self.burst :]]
        way_m = abs(rig.chassis.state.x_m - self.from_m)
        severities: dict[tuple[str, str], list[Severity]] = {}
        for event in rig.events:
            severities.setdefault((event.kind.value, event.reason.value), []).append(event.severity)

        def values(ones: Any) -> list[str]:  # noqa: ANN401 - of any enumeration
            return [one.value for one in ones]

        def lamps() -> set[str]:
            command: dict[str, Any] = rig.chassis._commands.get("Auto_LightCmd", {})
            return {short for name, short in LAMPS.items() if command.get(name)}

        return {
            **{state.value: lambda state=state: says.state is state for state in ArbiterState},
            "stopped": lambda: not says.engaged,
            "for": lambda *reasons: says.stop_reason.value in reasons,
            "latched": lambda *reasons: {*values(says.latched)} == {*reasons},
            "has": lambda reason: reason in values(says.latched),
            "first": lambda *reasons: says.latched[0].value in reasons,
            "blocked": lambda reason: reason in values(says.blocked_by),
            "holder": lambda name: says.lease_holder == name,
            "phase": lambda phase: says.stop_phase.value == phase,
            "limit": lambda speed_mps: says.speed_limit_mps == float(speed_mps),
            "target": lambda speed_mps: says.target_speed_mps == float(speed_mps),
            "confirmed": lambda: says.rest_confirmed,
            "mute": lambda: flow.is_mute,
            "whole": lambda: flow.arbiter.output.told_ns == rig.now_ns,
            "at_rest": lambda: is_at_rest(flow, rig.now_ns),
            "may_restart": lambda: rig.core.may_start_again(rig.now_ns),
            "ruled": lambda reason: rig.ruled().value == reason,
            "bound": lambda *by: values(rig.decided[-1].bound_by) == [*by],
            "events": lambda kind, *reasons: values(rig.event_reasons(EventKind(kind))) == [*reasons],
            "event": lambda kind, reason: reason in values(rig.event_reasons(EventKind(kind))),
            "error": lambda *of: severities.get(of) == [Severity.ERROR],
            "says": lambda *words: any(event.text.endswith(" ".join(words)) for event in rig.events),
            # The robot.
            "rests": lambda: rig.speed_mps == 0,
            "moves": lambda speed_mps: near(rig.speed_mps, speed_mps, 0.05),
            "faster": lambda speed_mps: abs(rig.speed_mps) > float(speed_mps),
            "parked": lambda: rig.chassis.state.parking_status is ParkingStatus.APPLIED,
            "way": lambda most_m, least_m="0": float(least_m) <= way_m < float(most_m),
            "back": lambda most_m, sign="1": self._way_back_m(float(sign)) < float(most_m),
            "mode": lambda mode: rig.chassis.state.mode.value == mode,
            "lamps": lambda *which: lamps() == {*which},
            # Its commands, now and since "mark".
            "told": lambda speed_mps: told and near(rig.told_mps, speed_mps, 0.04),
            "below": lambda speed_mps: told and rig.told_mps < float(speed_mps),
            "slower": lambda by_mps: near(self.was_mps - rig.told_mps, by_mps, 0.06),
            "gear": lambda gear: told and told["Auto_GearCmd"]["TargetGear"] == gear,
            "parking": lambda: told and told["Auto_ParkingCmd"]["ParkingRequest"],
            "spoken": lambda: since,
            "silent": lambda: len(rig.out) == self.frame,
            "frames": lambda count: len(rig.out) - self.frame == int(count),
            "speechless": lambda: not any(burst["Auto_DriveCmd"]["TargetVelocity"] for burst in since),
            "most": lambda speed_mps: near(
                max(float(burst["Auto_DriveCmd"]["TargetVelocity"]) for burst in since), speed_mps, 1e-3
            ),
            "braked": lambda: all(burst["Auto_ParkingCmd"]["ParkingRequest"] for burst in since),
            "falling": lambda: rig.heard[self.speed :] == sorted(rig.heard[self.speed :], reverse=True),
            "heard": lambda raw: rig.heard[-1] == int(raw),
            "in_order": self._is_in_order,
            "held": self._is_held,
            "parks_as_it_stops": self._parks_as_it_stops,
            "parted": self._has_parted,
        }


def _named(frame: Frame) -> set[str]:
    return {name for name, can_id in CAN_IDS.items() if can_id == frame.can_id}


def play(scene: str, variant: Variant = Variant.COARSE) -> None:
    begin, _, steps = scene.partition(";")
    Scene(begin.strip(), variant).play(steps)

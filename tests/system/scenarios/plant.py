"""A model of the chassis written from the manual alone: bytes in, motion, bytes out.

What the manual leaves open is a parameter of ``Build`` or a knob of ``Plant``, drawn at random. Forward, left and
uphill are positive.
"""

from __future__ import annotations

from math import copysign, cos, radians, sin, tan
from random import Random
from typing import Final

import msgspec

STEP_NS: Final = 5_000_000
STEP_S: Final = STEP_NS / 1e9
GRAVITY_MPS2: Final = 9.81
EMPTY_KG: Final = 116.0
WHEELBASE_M: Final = 0.660
TRACK_M: Final = 0.606
TOP_SPEED_MPS: Final = 8 / 3.6
STEERING_LIMIT_DEG: Final = 24.0

MOTOR_N: Final = 650.0  # climbs 20 deg empty (389 N) and 15 deg loaded (548 N); cannot hold 20 deg loaded (725 N)
ROLLING_MPS2: Final = 0.2  # from 1.2 deg on a robot in neutral rolls
PARKING_MPS2: Final = 7.0  # grip of the locked wheels; 20 deg need 3.4 m/s2
BLOCKED_MPS2: Final = 30.0  # stronger than any motor
PEDAL_MPS2: Final = 3.0  # service brake at full pedal and a gain of 1
MOTOR_UP_MPS2, MOTOR_DOWN_MPS2 = 1.5, 2.5
STEERING_RATE_DEGPS: Final = 90.0
SHIFT_MPS: Final = 0.1  # the other direction's gear engages below this speed; until then neutral
HAND_NPM: Final = 4000.0  # force of a push per m/s below its speed
GEAR_P, GEAR_R, GEAR_N, GEAR_D = 1, 2, 3, 4
AUTO, REMOTE, STOP = 0, 1, 2

GEAR_CMD, STEERING_CMD, DRIVE_CMD, BRAKING_CMD, PARKING_CMD = (0x18C4D0D0 + (n << 8) for n in range(1, 6))
MOTION_CMDS: Final = (GEAR_CMD, STEERING_CMD, DRIVE_CMD, BRAKING_CMD, PARKING_CMD)
LIGHT_CMD, SPEAKER_CMD = 0x18C4D7D0, 0x18C4D8D0
GEAR, STEERING, DRIVE, BRAKING, PARKING = (0x18C4D0EF + (n << 8) for n in range(1, 6))
WHEELS, PULSES, BODY, LIGHT, SPEAKER = (0x18C4D0EF + (n << 8) for n in (7, 8, 9, 0xA, 0xB))
PERIOD_STEPS: Final = {
    **dict.fromkeys((GEAR, STEERING, DRIVE, BRAKING, PARKING), 2),
    BODY: 4,
    **dict.fromkeys((WHEELS, PULSES, LIGHT, SPEAKER), 10),
}
SIGN: Final = {GEAR_D: 1.0, GEAR_R: -1.0}

CanFrame = tuple[int, bytes]


def checksum(data: bytes) -> int:
    result = 0
    for byte in data[:7]:
        result ^= byte
    return result


class Told(msgspec.Struct):
    """The command in the five motion frames; ``enabled`` needs all five enables, ``any_enabled`` one."""

    enabled: bool
    any_enabled: bool
    gear: int
    speed_mps: float
    angle_deg: float
    pedal: float
    parking: bool

    @property
    def signed_mps(self) -> float:
        return self.speed_mps * SIGN.get(self.gear, 0.0)


def orders(gear: int, speed_mps: float, *, fine: bool) -> dict[int, bytes]:
    """The five motion frames that drive straight on."""
    speed = round(speed_mps / (0.001 if fine else 0.04)).to_bytes(2, "little")
    bodies = {
        GEAR_CMD: bytes([1, gear, 0]),
        STEERING_CMD: b"\x01" + (2048).to_bytes(2, "little"),
        DRIVE_CMD: b"\x01" + speed,
        BRAKING_CMD: b"\x01\x00\x00",
        PARKING_CMD: b"\x01\x00\x00",
    }
    whole = {identifier: body + bytes(4) for identifier, body in bodies.items()}
    return {identifier: data + bytes([checksum(data)]) for identifier, data in whole.items()}


def told(frames: dict[int, bytes], *, fine: bool) -> Told:
    enables = [bool(frames[identifier][0] & 1) for identifier in MOTION_CMDS]
    return Told(
        enabled=all(enables),
        any_enabled=any(enables),
        gear=frames[GEAR_CMD][1] & 7,
        speed_mps=int.from_bytes(frames[DRIVE_CMD][1:3], "little") * (0.001 if fine else 0.04),
        angle_deg=(int.from_bytes(frames[STEERING_CMD][1:3], "little") & 0xFFF) * 0.043945 - 90,
        pedal=frames[BRAKING_CMD][1] * 0.00390625,
        parking=bool(frames[PARKING_CMD][1] & 1),
    )


class Build(msgspec.Struct, frozen=True, kw_only=True):
    """A chassis as built and loaded.

    Attributes:
        fine: speeds in 0.001 m/s a bit, else in 0.04 m/s.
        stop_mode: outside auto it "brakes" with the motor, "coasts" in neutral or "parks".
        brake_delay_s: until the parking brake has closed or opened.
        battery: share of the motor's force and of its highest speed that the voltage leaves.
        parks_motor: behind the parking brake the motor is off; else it holds the robot too.
        is_noisy: measured values flicker by one bit.
        missing: feedback frames that it never sends.
    """

    fine: bool = False
    payload_kg: float = 0.0
    stop_mode: str = "brakes"
    drive_lag_s: float = 0.15
    steering_lag_s: float = 0.1
    brake_delay_s: float = 0.05
    battery: float = 1.0
    parks_motor: bool = False
    pulses_per_m: float = 776.0
    is_noisy: bool = False
    missing: frozenset[int] = frozenset()

    @property
    def mass_kg(self) -> float:
        return EMPTY_KG + self.payload_kg


class Plant:
    """The chassis, its hill and all that acts on it.

    Attributes:
        slope_deg: now; it goes to ``slope_target_deg`` at ``slope_rate_degps``.
        pedal_gain, motor_strength, speed_gain: factors that may change at any time.
        brake_grip: share of the parking brake's grip, whatever it reads; ``brake_creep_mps`` even if it holds.
        hand: somebody pushes: at which speed, and with how many newtons at most.
        button: mode stop, whatever is enabled.
        sticks: speed and angle of the remote control; None gives the robot back.
        frozen, silent: frames whose values repeat, and frames that are not sent.
        wall: the touching bumper, and the robot's place then.
        is_away: the controller restarts.
        shown: the newest payload of each feedback frame.
    """

    def __init__(self, build: Build, random: Random, slope_deg: float = 0.0) -> None:
        self.build = build
        self.slope_deg = self.slope_target_deg = slope_deg
        self.slope_rate_degps = 5.0
        self.pedal_gain = 0.0
        self.motor_strength = self.speed_gain = 1.0
        self.stuck = self.button = self.blocked = False
        self.brake_grip, self.brake_creep_mps = 1.0, 0.0
        self.hand: tuple[float, float] | None = None
        self.sticks: tuple[float, float] | None = None
        self.frozen: frozenset[int] = frozenset()
        self.silent: frozenset[int] = frozenset()
        self.wall: tuple[str, float] | None = None
        self.speed_mps = self.x_m = self.angle_deg = 0.0
        self.travelled_m = 12_345.0
        self.gear = GEAR_N
        self.mode = STOP
        self.braked = True
        self.shown: dict[int, bytes] = {}
        self.step_count = 0
        self._wheels_m = [0.0, 0.0]
        self._commands: dict[int, bytes] = {}
        self._counters = dict.fromkeys(PERIOD_STEPS, 0)
        self._brake_since = 0.0
        self._away_s = 0.0
        self._contact_s = 0.0
        self._random = random

    @property
    def is_away(self) -> bool:
        return self._away_s > 0

    @property
    def load_mps2(self) -> float:
        """Gravity along the robot's axis; positive pulls it back."""
        return GRAVITY_MPS2 * sin(radians(self.slope_deg))

    @property
    def motor_n(self) -> float:
        return MOTOR_N * self.motor_strength * self.build.battery

    @property
    def can_hold(self) -> bool:
        """The motor can hold the robot on this hill."""
        return self.build.mass_kg * (abs(self.load_mps2) - ROLLING_MPS2) < self.motor_n

    @property
    def brake_holds(self) -> bool:
        """The parking brake, if applied, holds the robot on this hill."""
        pull = abs(self.load_mps2) - ROLLING_MPS2
        return pull <= 0 or (not self.brake_creep_mps and pull <= self._grip_mps2)

    @property
    def creeps_slowly(self) -> bool:
        """So slowly that the speeds read zero, and that not each 50 ms bring a pulse of either wheel."""
        return 0 < self.brake_creep_mps * self.build.pulses_per_m * 0.05 < 1

    @property
    def creeps_unseen(self) -> bool:
        """So slowly that one wheel alone, at half the speed, does not bring a pulse in 450 ms."""
        return 0 < self.brake_creep_mps / 2 * self.build.pulses_per_m * 0.45 < 1

    @property
    def brake_slows_mps2(self) -> float:
        """Deceleration by the parking brake, going down this hill."""
        return self._grip_mps2 + ROLLING_MPS2 - abs(self.load_mps2)

    @property
    def _grip_mps2(self) -> float:
        return PARKING_MPS2 * self.brake_grip * cos(radians(self.slope_deg))

    @property
    def slows_mps2(self) -> float:
        """Deceleration by the motor, going down this hill."""
        return self.motor_n / self.build.mass_kg + ROLLING_MPS2 - abs(self.load_mps2)

    @property
    def can_climb(self) -> bool:
        """The motor can start the robot up this hill."""
        needed = abs(self.load_mps2) + ROLLING_MPS2 + 0.3
        return self.build.mass_kg * needed < self.motor_n

    def reboot(self, seconds: float) -> None:
        self._away_s = seconds
        self._commands.clear()

    def touch(self, side: str) -> None:
        self.wall = (side, self.x_m)
        self._contact_s = 0.0

    def found_driving(self, gear: int, speed_mps: float) -> None:
        """Begin in a drive whose commands have ceased."""
        self._commands = orders(gear, speed_mps, fine=self.build.fine)
        self.speed_mps = speed_mps * SIGN[gear]
        self.mode, self.braked, self.gear = AUTO, False, gear

    def receive(self, identifier: int, data: bytes) -> None:
        if not self.is_away and len(data) == 8 and data[7] == checksum(data):
            self._commands[identifier] = data

    def step(self) -> list[CanFrame]:
        """Five milliseconds pass. Returns the feedback frames that are due."""
        self.step_count += 1
        change = STEP_S * self.slope_rate_degps
        self.slope_deg += max(-change, min(change, self.slope_target_deg - self.slope_deg))
        if self.is_away:
            self._away_s -= STEP_S
            if not self.is_away:
                self._counters = dict.fromkeys(PERIOD_STEPS, 0)
            self._move(GEAR_N, 0.0, None, 0.0)
            return []
        self._obey()
        return [
            self._frame(identifier)
            for offset, (identifier, period) in enumerate(PERIOD_STEPS.items())
            if (self.step_count + offset) % period == 0 and identifier not in self.build.missing | self.silent
        ]

    # What is asked of it.

    def _obey(self) -> None:
        order = told(self._commands, fine=self.build.fine) if set(MOTION_CMDS) <= self._commands.keys() else None
        if self.sticks is not None:
            self.mode = REMOTE
            speed_mps, angle_deg = self.sticks
            self._apply_brake(wanted=False)
            self._move(GEAR_R if speed_mps < 0 else GEAR_D, abs(speed_mps), angle_deg, 0.0)
        elif order is not None and order.enabled and not self.button:
            self.mode = AUTO
            self._apply_brake(wanted=order.parking)
            self._move(order.gear, order.speed_mps * self.speed_gain, order.angle_deg, order.pedal)
        else:
            self.mode = STOP
            # The brake keeps what it was last told, unless this chassis parks by itself.
            self._apply_brake(wanted=self.build.stop_mode == "parks" or self.braked)
            braking = GEAR_R if self.speed_mps < 0 else GEAR_D
            self._move(braking if self.build.stop_mode == "brakes" else GEAR_N, 0.0, None, 0.0)

    def _apply_brake(self, *, wanted: bool) -> None:
        self._brake_since = 0.0 if wanted is self.braked else self._brake_since + STEP_S
        if self._brake_since > self.build.brake_delay_s:
            self.braked = wanted

    # How it moves.

    def _move(self, gear: int, speed_mps: float, angle_deg: float | None, pedal: float) -> None:
        wanted = SIGN.get(gear, 0.0)
        if gear == self.gear or not wanted or wanted * self.speed_mps > -SHIFT_MPS:
            self.gear = gear if gear in (GEAR_R, GEAR_N, GEAR_D) else GEAR_N
        elif wanted:
            self.gear = GEAR_N
        mass_kg = self.build.mass_kg
        resisted = self._resistance(pedal)
        pull = -self.load_mps2
        is_driven = self.gear in SIGN and not self.is_away and not (self.braked and self.build.parks_motor)
        if is_driven and pedal == 0:
            most_mps = TOP_SPEED_MPS * 1.5 * self.build.battery
            pull += self._motor_n(min(speed_mps, most_mps) * SIGN[self.gear]) / mass_kg
        elif is_driven:
            pull += self._motor_n(0.0) / mass_kg
        if self.hand is not None:
            at_mps, most_n = self.hand
            pull += max(-most_n, min(most_n, HAND_NPM * (at_mps - self.speed_mps))) / mass_kg
        before = self.speed_mps
        self.speed_mps = after = self._next_mps(pull, resisted)
        if angle_deg is not None and not self.stuck:
            goal = max(-STEERING_LIMIT_DEG, min(STEERING_LIMIT_DEG, angle_deg))
            most = STEERING_RATE_DEGPS * STEP_S
            self.angle_deg += max(-most, min(most, (goal - self.angle_deg) * STEP_S / self.build.steering_lag_s))
        moved = (before + after) / 2 * STEP_S
        self.x_m += moved
        self.travelled_m += abs(moved)
        turn = moved * tan(radians(self.angle_deg)) / WHEELBASE_M * TRACK_M / 2
        self._wheels_m[0] += moved - turn
        self._wheels_m[1] += moved + turn

    def _next_mps(self, pull: float, resisted: float) -> float:
        before = self.speed_mps
        if before == 0:
            after = 0.0 if abs(pull) <= resisted else (pull - copysign(resisted, pull)) * STEP_S
        else:
            after = before + (pull - copysign(resisted, before)) * STEP_S
            if after * before < 0:
                after = 0.0
        if self.braked and not after and self.brake_creep_mps and abs(pull) > ROLLING_MPS2:
            after = copysign(self.brake_creep_mps, pull)
        return after

    def _resistance(self, pedal: float) -> float:
        """Deceleration by all but the motor."""
        held = (self._grip_mps2 if self.braked else 0.0) + (BLOCKED_MPS2 if self.blocked else 0.0)
        return ROLLING_MPS2 + pedal * self.pedal_gain * PEDAL_MPS2 + held

    def _motor_n(self, goal_mps: float) -> float:
        """The motor's force: it approaches the speed with a lag, and holds it against the hill if it can."""
        wanted = (goal_mps - self.speed_mps) / self.build.drive_lag_s
        slows = wanted * self.speed_mps < 0
        most = MOTOR_DOWN_MPS2 if slows else MOTOR_UP_MPS2
        wanted = max(-most, min(most, wanted))
        moves = self.speed_mps or goal_mps
        against = self.load_mps2 + (copysign(ROLLING_MPS2, moves) if moves else 0.0)
        most_n = self.motor_n
        return max(-most_n, min(most_n, self.build.mass_kg * (wanted + against)))

    # What it says.

    def _frame(self, identifier: int) -> CanFrame:
        counter = self._counters[identifier]
        self._counters[identifier] = (counter + 1) % 16
        if identifier not in self.frozen or identifier not in self.shown:
            self.shown[identifier] = self._payload(identifier)
        data = self.shown[identifier] + bytes([counter << 4])
        return identifier, data + bytes([checksum(data)])

    def _payload(self, identifier: int) -> bytes:  # noqa: PLR0911 - ten frames
        fine = self.build.fine
        bit_mps = 0.001 if fine else 0.04
        match identifier:
            case 0x18C4D1EF:
                return bytes([1, GEAR_P if self.braked else self.gear, 0, 0, 0, 0])
            case 0x18C4D2EF:
                raw = self._measured((self.angle_deg + 90) / 0.043945)
                return bytes([1]) + raw.to_bytes(2, "little") + bytes(3)
            case 0x18C4D3EF:
                raw = min(0xFFFF, max(0, self._measured(abs(self.speed_mps) / bit_mps)))
                return bytes([1]) + raw.to_bytes(2, "little") + bytes(3)
            case 0x18C4D4EF:
                return bytes([1, 0, (1 if self.braked else 0) << 4, 0, 0, 0])
            case 0x18C4D5EF:
                return bytes([1, 1 if self.braked else 3, 0, 0, 0, 0])
            case 0x18C4D7EF:
                turn = self.speed_mps * tan(radians(self.angle_deg)) / WHEELBASE_M * TRACK_M / 2
                zero = 32768 if fine else 200
                most = 0xFFFF if fine else 0x1FF
                left = max(0, min(most, self._measured((self.speed_mps - turn) / bit_mps) + zero))
                right = max(0, min(most, self._measured((self.speed_mps + turn) / bit_mps) + zero))
                return bytes([1]) + left.to_bytes(2, "little") + right.to_bytes(2, "little") + bytes(1)
            case 0x18C4D8EF:
                counts = [int(metres * self.build.pulses_per_m // 1) & 0xFFFF for metres in self._wheels_m]
                return bytes([1]) + b"".join(count.to_bytes(2, "little") for count in counts) + bytes(1)
            case 0x18C4D9EF:
                front, rear = self._touches()
                mileage = int(self.travelled_m).to_bytes(3, "little")
                return bytes([1]) + mileage + bytes([front | rear << 4, self.mode])
            case 0x18C4DAEF:
                lamps = self._commands.get(LIGHT_CMD, bytes(8))
                return lamps[:3] + bytes(3)
            case _:
                return self._commands.get(SPEAKER_CMD, bytes(8))[:1] + bytes(5)

    def _measured(self, value: float) -> int:
        return round(value) + (self._random.choice((-1, 0, 0, 1)) if self.build.is_noisy else 0)

    def _touches(self) -> tuple[int, int]:
        """The two bumpers. A contact chatters for 80 ms, and while it only just touches."""
        if self.wall is None:
            return 0, 0
        side, at_m = self.wall
        self._contact_s += STEP_S * PERIOD_STEPS[BODY]
        deep_m = (self.x_m - at_m) * (1.0 if side == "front" else -1.0)
        if deep_m < -0.3:
            self.wall = None
        chatters = abs(deep_m) < 0.005 or self._contact_s < 0.08 or -0.02 < deep_m < 0
        first = self._contact_s <= STEP_S * PERIOD_STEPS[BODY]
        pressed = first or (self._random.random() < 0.5 if chatters else deep_m >= 0)
        return int(pressed and side == "front"), int(pressed and side == "rear")

"""A second statement of the gate's rules, to judge the gate by.

Written from the manual (V2.0, 4.3.1 and 5) and from the command rules, not from the gate's code. A frame is a
picture of its bits; a burst's values are exact, in micrometres a second and microdegrees.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Final, NamedTuple

from gateway.chassis.frame import EXTENDED, Frame

PICTURES: Final = {
    0x18C4D1D0: "e....... ggg..... ........ ........ ........ ........ ....cccc xxxxxxxx",
    0x18C4D2D0: "e....... aaaaaaaa aaaa.... ........ ........ ........ ....cccc xxxxxxxx",
    0x18C4D3D0: "e....... vvvvvvvv vvvvvvvv ........ ........ ........ ....cccc xxxxxxxx",
    0x18C4D4D0: "e....... bbbbbbbb ........ ........ ........ ........ ....cccc xxxxxxxx",
    0x18C4D5D0: "e....... p....... ........ ........ ........ ........ ....cccc xxxxxxxx",
    0x18C4D6D0: "e....... ........ z....... ........ ........ ........ ....cccc xxxxxxxx",
    0x18C4D7D0: "h....... r....... l....... ........ ........ ........ ....cccc xxxxxxxx",
    0x18C4D8D0: "h....... ........ ........ ........ ........ ........ ....cccc xxxxxxxx",
}
"""Every command frame, byte by byte, in each the least significant bit first; a dot is a bit without a meaning.

Enable, gear, angle, speed (v), brake pedal, parking request, zeroing of the mileage; headlamp or horn, right,
left; the alive counter, and the checksum (x).
"""

GEAR, STEERING, DRIVE, BRAKING, PARKING, ODOMETER, LIGHT, SPEAKER = PICTURES
# The speed first: a bus that accepts only a part still brings the robot to rest.
BURST: Final = (DRIVE, GEAR, STEERING, BRAKING, PARKING)
# After such a part, at zero speed, the parking brake gets through too.
BRAKE_FIRST: Final = (DRIVE, PARKING, GEAR, STEERING, BRAKING)
GEARS: Final = {2: "R", 3: "N", 4: "D"}  # P, 1, is reserved; the others have no meaning
# A bit of speed in the manual's section on target speed, and in its frame table.
COARSE_UMPS, FINE_UMPS = 40_000, 1_000
TOP_SPEED_UMPS: Final = 8_000_000_000 // 3_600  # 8 km/h
TOP_ANGLE_UDEG: Final = 24_000_000
ANGLE_BIT_UDEG: Final = 43_945
ANGLE_OFFSET_UDEG: Final = -90_000_000

MS: Final = 1_000_000
# The greatest acceleration of the settings, 1.5 m/s2, for a tick of 10 ms; speeds are rounded to a bit.
GAIN_UMPS: Final = 15_000
# 60 deg/s for a tick of 10 ms, each of the two angles rounded by up to a bit.
TURN_UDEG: Final = 600_000 + 2 * ANGLE_BIT_UDEG
Values = Mapping[str, int]  # raw values of a frame's signals, by their letters


class Told(NamedTuple):
    enables: str
    gear: str
    angle_udeg: int
    speed_umps: int
    has_pedal: bool
    is_parked: bool


@cache
def _places(identifier: int, letter: str) -> tuple[int, ...]:
    picture = PICTURES[identifier].replace(" ", "")
    return tuple(place for place, mark in enumerate(picture) if mark == letter)


def bit_string(data: bytes) -> str:
    """The bits as the manual counts them: bit 0 of byte 0 first."""
    return f"{int.from_bytes(data, 'little'):0{8 * len(data)}b}"[::-1]


def compose(identifier: int, values: Values, counter: int) -> bytes:
    bits = ["0"] * 64
    for letter, value in {**values, "c": counter}.items():
        for index, place in enumerate(_places(identifier, letter)):
            bits[place] = "01"[value >> index & 1]
    for column in range(8):
        bits[56 + column] = "01"[bits[column:56:8].count("1") % 2]
    text = "".join(bits)
    return bytes(int(text[first : first + 8][::-1], 2) for first in range(0, 64, 8))


def value(identifier: int, letter: str, data: bytes) -> int:
    bits = bit_string(data)
    return int("".join(bits[place] for place in reversed(_places(identifier, letter))), 2)


def is_well_formed(identifier: int, data: bytes) -> bool:
    """Eight bytes, no bit without a meaning, an even number of ones in each of the eight columns of bits."""
    if len(data) != 8:
        return False
    bits = bit_string(data)
    return all(bits[place] == "0" for place in _places(identifier, ".")) and all(
        bits[column::8].count("1") % 2 == 0 for column in range(8)
    )


def read(burst: Sequence[Frame], bit_umps: int | None) -> Told:
    """Read the first five frames of a burst; in an unknown scale every speed but zero is out of range."""
    drive, gear, steering, braking, parking = (
        next(frame.data for frame in burst[:5] if frame.identifier == identifier) for identifier in BURST
    )
    raw = value(DRIVE, "v", drive)
    return Told(
        enables="".join(bit_string(frame.data)[0] for frame in burst[:5]),
        gear=GEARS.get(value(GEAR, "g", gear), "?"),
        angle_udeg=value(STEERING, "a", steering) * ANGLE_BIT_UDEG + ANGLE_OFFSET_UDEG,
        speed_umps=raw * bit_umps if bit_umps else raw and TOP_SPEED_UMPS + 1,
        has_pedal=value(BRAKING, "b", braking) != 0,
        is_parked=value(PARKING, "p", parking) == 1,
    )


def may_be_told(told: Told) -> bool:
    """The burst is admissible on its own."""
    if abs(told.angle_udeg) > TOP_ANGLE_UDEG or told.has_pedal:
        return False
    is_at_rest = told.is_parked and told.speed_umps == 0
    if told.enables == "00000":
        return is_at_rest and told.gear == "N"
    if told.enables != "11111":
        return False
    if told.gear == "N":
        return is_at_rest
    if told.gear not in {"R", "D"} or told.speed_umps > TOP_SPEED_UMPS:
        return False
    return told.speed_umps == 0 or not told.is_parked


def may_follow(
    told: Told, before: Told | None, bit_umps: int | None, *, is_stop: bool, may_let_go: bool = False
) -> bool:
    """The burst is admissible after that one; None after silence, or where others may command.

    ``may_let_go``: this stop may still return the robot to its motor.
    """
    if before is None:
        return is_stop or told.is_parked
    gain_umps = 0 if is_stop else GAIN_UMPS + (bit_umps or 0)
    if told.speed_umps > before.speed_umps + gain_umps:
        return False
    if not -TURN_UDEG <= told.angle_udeg - before.angle_udeg <= TURN_UDEG:
        return False
    if told.gear != before.gear:
        through_neutral = told.gear == "N" or before.gear == "N"
        at_rest = told.speed_umps == before.speed_umps == 0
        return through_neutral and at_rest and told.is_parked and before.is_parked
    if before.is_parked and not told.is_parked:
        return (not is_stop or may_let_go) and told.gear in {"R", "D"} and told.speed_umps == 0
    return True


class Bus:
    """Everything that was sent, and what may be sent next."""

    def __init__(self) -> None:
        # Of each identifier the last twelve.
        self.sent_ns: dict[int, list[int]] = {identifier: [] for identifier in PICTURES}
        self.counters: dict[int, int] = {}
        self.before: tuple[Frame, ...] = ()
        self.before_ns = 0
        self.is_torn = self.may_let_go = self.was_stop = False

    def may_send(self, burst: Sequence[Frame], bit_umps: int | None, now_ns: int, *, is_stop: bool) -> bool:
        """The whole burst is admissible now."""
        identifiers = [self._identifier(frame) for frame in burst]
        is_brake_first = tuple(identifiers[:5]) == BRAKE_FIRST and self.is_torn
        if not (tuple(identifiers[:5]) == BURST or is_brake_first) or len(set(identifiers)) != len(identifiers):
            return False
        if not all(map(self._may_send_frame, burst, identifiers, [now_ns] * len(burst))):
            return False
        is_fresh = self.before and now_ns - self.before_ns < 200 * MS
        before = read(self.before, bit_umps) if is_fresh else None
        told = read(burst, bit_umps)
        self.was_stop = is_stop
        if is_brake_first and told.speed_umps:
            return False
        follows = may_follow(told, before, bit_umps, is_stop=is_stop, may_let_go=self.may_let_go)
        return may_be_told(told) and follows

    def sent(self, burst: Sequence[Frame], now_ns: int) -> None:
        """The bus accepted so many frames; only a whole burst counts as commanded."""
        for frame in burst:
            self.sent_ns[frame.identifier] = [*self.sent_ns[frame.identifier][-11:], now_ns]
            self.counters[frame.identifier] = value(frame.identifier, "c", frame.data)
        if burst:
            self.is_torn = len(burst) < 5
        if len(burst) >= 5:
            was_parked = self.before != () and read(self.before, None).is_parked
            if not self.was_stop:
                self.may_let_go = True
            elif was_parked and not read(burst, None).is_parked:
                self.may_let_go = False
            self.before, self.before_ns = tuple(burst), now_ns

    def pause(self) -> None:
        self.before = ()

    def _identifier(self, frame: Frame) -> int | None:
        """The identifier of a classic data frame that the manual lists as a command."""
        is_known = frame.can_id in {identifier | EXTENDED for identifier in PICTURES}
        return frame.identifier if is_known and frame.fd_flags == 0 == frame.remote_length else None

    def _may_send_frame(self, frame: Frame, identifier: int | None, now_ns: int) -> bool:
        """Well-formed, counter up by one (15 wraps to 0), at most 12 in 100 ms."""
        if identifier is None or not is_well_formed(identifier, frame.data):
            return False
        counter = self.counters.get(identifier)
        if counter is not None and value(identifier, "c", frame.data) != (*range(1, 16), 0)[counter]:
            return False
        return sum(sent_ns > now_ns - 100 * MS for sent_ns in self.sent_ns[identifier]) < 12

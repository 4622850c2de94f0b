"""The early stop: the first program that reads a CAN interface after the robot's computer has started.

    python3 -I -S -E early_stop.py can0              watches until a gateway starts; stops uncommanded motion
    python3 -I -S -E early_stop.py --look can0 can1  looks for half a second; exit code 5: a robot moves

After a power cut the chassis executes its last command until another one comes, and a gateway takes seconds to
start. This file imports only small modules of the standard library, so that it runs within tens of milliseconds.
It applies the guard's rules, and sends the frames of the guard's stop for an unknown speed scale and command: zero
speed at once, the parking brake, disabled frames, silence. A test compares its frames, byte for byte, with those
of ``gateway.guard.stopper``.
"""

from __future__ import annotations

import _thread
import errno
import fcntl
import os
import socket
import struct
import sys
import time

MS = 1_000_000

# The layout of the DBC files; a test compares it with them. Identifiers are those of extended frames.
EXTENDED = 0x8000_0000
GEAR, STEERING, DRIVE, PARKING, WHEEL_SPEED, WHEEL_PULSE, BODY = (
    0x98C400EF | number << 8 for number in (0xD1, 0xD2, 0xD3, 0xD5, 0xD7, 0xD8, 0xD9)
)
GEAR_COMMAND, STEERING_COMMAND, DRIVE_COMMAND, BRAKING_COMMAND, PARKING_COMMAND = (
    0x98C400D0 | number << 8 for number in range(0xD1, 0xD6)
)
ODOMETER_COMMAND, LIGHT_COMMAND, SPEAKER_COMMAND = (0x98C400D0 | number << 8 for number in range(0xD6, 0xD9))
MOTION = (DRIVE_COMMAND, GEAR_COMMAND, STEERING_COMMAND, BRAKING_COMMAND, PARKING_COMMAND)
BRAKE_FIRST = (DRIVE_COMMAND, PARKING_COMMAND, GEAR_COMMAND, STEERING_COMMAND, BRAKING_COMMAND)
"""After a partly accepted burst."""

EXTRAS = (LIGHT_COMMAND, SPEAKER_COMMAND, ODOMETER_COMMAND)
"""Lamps, horn and odometer: the chassis keeps these forever too."""

HAZARD = 1 << 8 | 1 << 16
"""The lamps' bits: both indicators on, because the stop is latched. Horn and odometer get no bit."""

SILENCE_NS = {
    GEAR: 100 * MS,
    STEERING: 100 * MS,
    DRIVE: 100 * MS,
    PARKING: 100 * MS,
    BODY: 200 * MS,
    WHEEL_SPEED: 500 * MS,
    WHEEL_PULSE: 500 * MS,
}
AUTO, REMOTE, STOP, UNDEFINED = 0, 1, 2, 3
REVERSE, NEUTRAL, FORWARD = 2, 3, 4
APPLIED = 1
ANGLE_SCALE_DEG, ANGLE_OFFSET_DEG, ANGLE_TOP_DEG = 0.043945, -90.0, 24.0
TURNING_RAW_MIN = 2
STANDING_COARSE, STANDING_FINE = range(199, 202), range(32718, 32819)
"""Wheel speeds of a standing robot, raw: standstill in one variant is many m/s in the other."""

# As in schemas.settings; a test compares them.
TICK_NS = 10 * MS
COMMANDER_NS = 100 * MS
GUARD_LOOK_NS = 100 * MS
GUARD_SILENT_NS = 200 * MS
NOT_SLOWING_NS = 300 * MS
BRAKE_UNSEEN_NS = 3_000 * MS
HOLD_NS = 1_000 * MS
DISABLE_NS = 500 * MS
STANDS_NS = 50 * MS
GIVES_UP_NS = 30_000 * MS
REMOTE_FRAMES = 2
OFF_BURSTS = 10
BRAKE_RETURNS = 2

MOVING_FRAMES = {DRIVE: 3, WHEEL_SPEED: 3, WHEEL_PULSE: 6}
"""Consecutive frames that prove motion; for pulses, with counts in one direction."""

WATCH_NS = 120_000 * MS
"""Time to watch after the interface is up, if no gateway starts."""

LOOKS = 25
MOVES = 5
"""Exit code if a robot moves or is being commanded."""

LINK_POLL_S = 0.02
APPEAR_S = 60.0
"""Time to wait for a missing interface."""

CLAIM_POLL_NS = 200 * MS
POLL_S = 0.005
WATCH_POLL_S = 0.02
"""Period while nothing is sent: a shorter one would load a processor that others need to start."""

WAITING_MAX_FRAMES = 10_000
FRAME = struct.Struct("=IB3x8s")
SEND_BUFFER_BYTES = 3_400
SETTINGS_FILE = "/etc/cruiser/cruiser.toml"
FOUND = "early stop: uncommanded motion in mode auto: stopping the robot"

Command = tuple[int, bytes]


class Chassis:
    """The newest feedback and commands on the bus. Pure.

    Attributes:
        commander_ns: when a motion command was last received; None if never.
        next_counters: the next alive counter of each command frame, by identifier.
        moving: consecutive frames that show motion, by identifier.
    """

    def __init__(self) -> None:
        self.commander_ns: int | None = None
        self.next_counters: dict[int, int] = {}
        self.moving = dict.fromkeys(MOVING_FRAMES, 0)
        self._way = 0
        self._latest: dict[int, tuple[bytes, int]] = {}
        self._remote_frames = 0
        self._slow_since_ns: int | None = None

    def receive(self, can_id: int, data: bytes, now_ns: int) -> None:
        if len(data) != 8 or data[0] ^ data[1] ^ data[2] ^ data[3] ^ data[4] ^ data[5] ^ data[6] != data[7]:
            return
        if can_id in MOTION or can_id in EXTRAS:
            self.next_counters[can_id] = (data[6] >> 4) + 1 & 0xF
            if can_id in MOTION:
                self.commander_ns = now_ns
        elif can_id in SILENCE_NS:
            before = self._latest.get(can_id)
            if before is not None and before[0][6] >> 4 == data[6] >> 4:
                return  # It repeats its counter, and carries no news.
            self._latest[can_id] = (data, now_ns)
            if can_id in self.moving:
                self.moving[can_id] = self.moving[can_id] + 1 if self._shows_motion(can_id, data, before) else 0
            elif can_id == BODY:
                self._remote_frames = self._remote_frames + 1 if _mode(data) == REMOTE else 0

    def _shows_motion(self, can_id: int, data: bytes, before: tuple[bytes, int] | None) -> bool:
        if can_id == DRIVE:
            return _raw(data) >= TURNING_RAW_MIN
        if not data[0] & 1:
            return False  # marked as not valid
        if can_id == WHEEL_SPEED:
            return not _wheels_stand(data)
        counted = 0 if before is None else _counted(data, before[0])
        way, self._way = self._way, (counted > 0) - (counted < 0)
        return bool(counted) and way in {0, self._way}

    def is_moving(self, now_ns: int) -> bool:
        """Drive feedback, wheels or pulses have shown motion for long enough."""
        return any(
            self.moving[can_id] >= frames and self.fresh(can_id, now_ns) is not None
            for can_id, frames in MOVING_FRAMES.items()
        )

    def fresh(self, can_id: int, now_ns: int) -> bytes | None:
        """The newest frame; None if it is old."""
        data, received_ns = self._latest.get(can_id, (b"", -SILENCE_NS[can_id] - 1 + now_ns))
        return None if now_ns - received_ns > SILENCE_NS[can_id] else data

    def is_commanded(self, now_ns: int) -> bool:
        """Another computer or a guard commands the chassis."""
        return self.commander_ns is not None and now_ns - self.commander_ns < COMMANDER_NS

    def mode(self, now_ns: int) -> int:
        """The mode; UNDEFINED if unknown, or remote in a single frame."""
        data = self.fresh(BODY, now_ns)
        mode = UNDEFINED if data is None else _mode(data)
        return UNDEFINED if mode == REMOTE and self._remote_frames < REMOTE_FRAMES else mode

    def moves(self, now_ns: int) -> bool:
        """Drive feedback or wheels show motion, in either speed scale."""
        drive, wheels = self.fresh(DRIVE, now_ns), self.fresh(WHEEL_SPEED, now_ns)
        return (drive is not None and _raw(drive) >= TURNING_RAW_MIN) or (
            wheels is not None and bool(wheels[0] & 1) and not _wheels_stand(wheels)
        )

    def stands(self, now_ns: int) -> bool:
        """It was seen to stand at every call in the last 50 ms."""
        wheels, drive = self.fresh(WHEEL_SPEED, now_ns), self.fresh(DRIVE, now_ns)
        if wheels is None or drive is None or _raw(drive) or not _wheels_stand(wheels):
            self._slow_since_ns = None
            return False
        if self._slow_since_ns is None:
            self._slow_since_ns = now_ns
        return now_ns - self._slow_since_ns >= STANDS_NS

    def is_braked(self, now_ns: int) -> bool | None:
        """The parking brake reads applied; None if unknown."""
        data = self.fresh(PARKING, now_ns)
        return None if data is None else data[1] == APPLIED

    def gear(self, now_ns: int) -> int:
        """The gear, raw; 0 if unknown."""
        data = self.fresh(GEAR, now_ns)
        return 0 if data is None else data[1] & 7

    def angle_raw(self, now_ns: int) -> int:
        """The steering angle, raw as in a command, within the chassis's limit; straight ahead if unknown."""
        data = self.fresh(STEERING, now_ns)
        angle_deg = 0.0 if data is None else (_raw(data) & 0xFFF) * ANGLE_SCALE_DEG + ANGLE_OFFSET_DEG
        bits = int(min(abs(angle_deg), ANGLE_TOP_DEG) / ANGLE_SCALE_DEG + 1e-6)
        return round((bits * (-1 if angle_deg < 0 else 1) * ANGLE_SCALE_DEG - ANGLE_OFFSET_DEG) / ANGLE_SCALE_DEG)

    def is_complete(self, now_ns: int) -> bool:
        """All feedback that a stop begins from is known."""
        return all(self.fresh(can_id, now_ns) is not None for can_id in (GEAR, STEERING, DRIVE, BODY))


class EarlyStop:
    """Watches the chassis, and stops uncommanded motion in mode auto. Pure.

    Attributes:
        frames: number of frames that the bus accepted in this stop.
        outcome: how the last stop ended, in the guard's words; empty before.
    """

    def __init__(self, now_ns: int) -> None:
        self.chassis = Chassis()
        self.is_sending = False
        self.frames = 0
        self.outcome = ""
        self._since_ns = now_ns
        self._counters = dict.fromkeys((*MOTION, *EXTRAS), 0)
        self._phase = ""
        self._before = ("", 0)
        self._is_torn = False
        self._returns = 0
        self._gear = self._angle_raw = self._bursts = 0
        self._due_ns = self._look_until_ns = self._entered_ns = self._told_ns = self._begun_ns = 0
        self._offered: list[Command] = []

    def is_needed(self, now_ns: int) -> bool:
        """The chassis moves in auto or an unknown mode, and no command was received since the start."""
        chassis = self.chassis
        is_auto = chassis.mode(now_ns) == AUTO or chassis.fresh(BODY, now_ns) is None
        return (
            not self.is_sending
            and chassis.is_moving(now_ns)
            and is_auto
            and now_ns - self._since_ns >= COMMANDER_NS
            and not chassis.is_commanded(now_ns)
        )

    def begin(self, now_ns: int) -> None:
        self.is_sending = True
        self.outcome = ""
        self.frames = 0
        self._counters |= self.chassis.next_counters
        self._begun_ns = self._due_ns = now_ns
        self._is_torn = False
        self._returns = 0
        self._look(now_ns)

    def tick(self, now_ns: int) -> list[Command]:
        """The frames that are due now; none between two ticks, and none without a stop."""
        if not self.is_sending:
            return []
        stands = self.chassis.stands(now_ns)
        if self.chassis.mode(now_ns) == REMOTE:
            return self._end("the remote control has the robot")
        if now_ns - self._begun_ns > GIVES_UP_NS:
            return self._end("given up: no response to zero speed and the parking brake")
        if now_ns < self._due_ns:
            return []
        self._due_ns += TICK_NS * (1 + (now_ns - self._due_ns) // TICK_NS)
        if self._phase and now_ns - self._told_ns > GUARD_SILENT_NS:
            # This process was paused, or the bus was away: look again.
            self._look(now_ns)
        if not self._phase and not self._start(now_ns):
            return []
        return self._burst(now_ns, stands=stands)

    def sent(self, count: int, now_ns: int) -> None:
        """Note how many frames of this tick the bus accepted."""
        if count >= len(MOTION):
            self._told_ns = now_ns
            self._is_torn = False
            self._bursts += count == len(self._offered)
        elif self._offered:
            # The chassis received only a part: the stop must not continue, except to the parking brake.
            if not count or self._phase not in {"zero", "park"}:
                self._phase, self._entered_ns = self._before
            self._is_torn |= count > 0
        for can_id, _ in self._offered[:count]:
            self._counters[can_id] = self._counters[can_id] + 1 & 0xF
        self._offered = []
        self.frames += count

    def _look(self, now_ns: int) -> None:
        """Begin, or begin again, once the feedback is known."""
        self._phase = ""
        self._look_until_ns = now_ns + GUARD_LOOK_NS
        self._bursts = 0

    def _start(self, now_ns: int) -> bool:
        chassis = self.chassis
        if not chassis.is_complete(now_ns) and now_ns < self._look_until_ns:
            return False
        gear = chassis.gear(now_ns)
        rolls = gear in {REVERSE, FORWARD}
        self._gear = gear if rolls else NEUTRAL
        self._angle_raw = chassis.angle_raw(now_ns)
        self._told_ns = now_ns
        self._enter("zero" if rolls else "park", now_ns)
        if chassis.mode(now_ns) == STOP and chassis.is_braked(now_ns) and not chassis.moves(now_ns):
            # It executes no command, and its brake holds: enables would only switch it back to auto.
            self._enter("disable", now_ns)
        return True

    def _burst(self, now_ns: int, *, stands: bool) -> list[Command]:
        chassis = self.chassis
        moves, brake = chassis.moves(now_ns), chassis.is_braked(now_ns)
        mode = chassis.mode(now_ns)
        if mode == STOP and moves and self._phase == "zero":
            # It executes no command, and nothing holds it: command the parking brake anyway.
            self._enter("park", now_ns)
        self._before = self._phase, self._entered_ns
        if mode != AUTO and not brake:
            brake = None  # In mode stop the chassis may ignore the request.
        if self._has_ended(now_ns, stands=stands, brake=brake):
            return self._end("the robot stands" if stands else "the robot is not seen to stand")
        self._offered = self._frames()
        return self._offered

    def _has_ended(self, now_ns: int, *, stands: bool, brake: bool | None) -> bool:
        """Go to the next phase, at most one a tick. Returns True at the end."""
        moves, age_ns = self.chassis.moves(now_ns), now_ns - self._entered_ns
        match self._phase:
            # Without a known scale its slowing down cannot be seen.
            case "zero" if stands or not moves or age_ns >= NOT_SLOWING_NS:
                self._enter("park", now_ns)
            case "park" if brake or (brake is None and age_ns >= BRAKE_UNSEEN_NS):
                self._enter("hold", now_ns)
            case "hold" if moves:
                self._entered_ns = now_ns
            case "hold" if age_ns >= HOLD_NS and self._returns < BRAKE_RETURNS:
                self._enter("disable", now_ns)
            # Its brake does not hold it without the enables.
            case "disable" if moves:
                self._returns += 1
                self._enter("park", now_ns)
            case "disable" if age_ns >= DISABLE_NS:
                return True
        return False

    def _frames(self) -> list[Command]:
        enable = self._phase != "disable"
        parks = self._phase != "zero"
        values = {
            DRIVE_COMMAND: 0,
            GEAR_COMMAND: self._gear if enable else NEUTRAL,
            STEERING_COMMAND: self._angle_raw,
            BRAKING_COMMAND: 0,
            PARKING_COMMAND: parks,
        }
        order = BRAKE_FIRST if self._is_torn else MOTION
        frames = [(can_id, _data(enable | values[can_id] << 8, self._counters[can_id])) for can_id in order]
        if self._bursts < OFF_BURSTS:
            frames += [
                (can_id, _data(HAZARD if can_id == LIGHT_COMMAND else 0, self._counters[can_id]))
                for can_id in EXTRAS
            ]
        return frames

    def _enter(self, phase: str, now_ns: int) -> None:
        self._phase, self._entered_ns = phase, now_ns

    def _end(self, outcome: str) -> list[Command]:
        self.is_sending = False
        self.outcome = outcome
        self.chassis.moving = dict.fromkeys(MOVING_FRAMES, 0)
        return []


def _data(word: int, counter: int) -> bytes:
    data = bytearray((word | counter << 52).to_bytes(8, "little"))
    for byte in data[:7]:
        data[7] ^= byte
    return bytes(data)


def _raw(data: bytes) -> int:
    return data[1] | data[2] << 8


def _counted(data: bytes, before: bytes) -> int:
    """Return the pulses of both wheels from one frame to the next, across the wrap of their 16 bits."""
    return sum(
        (int.from_bytes(data[at : at + 2], "little") - int.from_bytes(before[at : at + 2], "little") + 0x8000)
        % 0x1_0000
        - 0x8000
        for at in (1, 3)
    )


def _mode(body: bytes) -> int:
    """The mode in a body frame; eight zero bytes would read auto, but are not valid."""
    return body[5] & 3 if body[0] & 1 else UNDEFINED


def _wheels_stand(data: bytes) -> bool:
    """The wheel speeds are those of standstill in one of the scales."""
    word = int.from_bytes(data[:7], "little") & ~(0xF << 52)
    coarse, fine = (
        ((word >> 8 & mask, word >> 24 & mask), 1 | mask << 8 | mask << 24) for mask in (0x1FF, 0xFFFF)
    )
    return bool(word & 1) and any(
        all(wheel in standing for wheel in wheels) and not word & ~used
        for (wheels, used), standing in ((coarse, STANDING_COARSE), (fine, STANDING_FINE))
    )


class Interface:
    """A CAN interface of the kernel, which may go down or disappear."""

    def __init__(self, name: str) -> None:
        """Bind to it. Raises OSError: there is no such interface."""
        self._socket = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        mask = 0xDFFF_FFFF  # the omitted bit would make it a filter of error frames
        filters = b"".join(struct.pack("=II", can_id, mask) for can_id in (*SILENCE_NS, *MOTION, *EXTRAS))
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
        # Frames that are not sent at once must not wait.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._name = name
        self._socket.bind((name,))

    @property
    def is_up(self) -> bool:
        """The interface is up. Raises OSError: it has disappeared."""
        request = struct.pack("@16sh14x", self._name.encode(), 0)
        return bool(struct.unpack("@16sh14x", fcntl.ioctl(self._socket, 0x8913, request))[1] & 1)

    def waiting(self) -> list[Command]:
        """The waiting frames, a bounded number. Raises OSError: the interface is down or has disappeared."""
        frames: list[Command] = []
        try:
            while len(frames) < WAITING_MAX_FRAMES:
                content = self._socket.recv(72, socket.MSG_DONTWAIT)
                if len(content) == FRAME.size:
                    can_id, length, data = FRAME.unpack(content)
                    frames.append((can_id, data[:length]))
        except BlockingIOError:
            pass
        return frames

    def send(self, frames: list[Command]) -> int:
        """Send frames. Returns how many the interface accepted."""
        for count, (can_id, data) in enumerate(frames):
            try:
                self._socket.send(FRAME.pack(can_id, 8, data), socket.MSG_DONTWAIT)
            except OSError:
                return count
        return len(frames)


class EarlyNote:
    """The note of a stop, in the guard's format and place, which ``gateway.host.notes`` reads and latches.

    It is written on a thread, because a disk may stall.
    """

    def __init__(self, interface: str) -> None:
        self._interface = interface
        self._lines: list[str] = []
        self._is_done = _thread.allocate_lock()

    def add(self, line: str) -> None:
        """Write this line after the earlier ones."""
        self._lines.append(f"{_time_of_day()} guard: {line}\n")
        if self._is_done.acquire(blocking=False):
            _thread.start_new_thread(self._write, ())

    def close(self) -> None:
        """Wait for the disk, up to 5 s."""
        self._is_done.acquire(timeout=5.0)

    def _write(self) -> None:
        try:
            path = note_path(self._interface)
            while path and self._lines:
                descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW, 0o600)
                os.write(descriptor, self._lines.pop(0).encode())
                os.fsync(descriptor)
                os.close(descriptor)
        except OSError as error:
            say(f"the note cannot be written: {error}")
        finally:
            self._is_done.release()


def note_path(interface: str) -> str:
    """The path for the robot in the gateway's settings; empty if it uses another interface."""
    try:
        import tomllib  # noqa: PLC0415 - only when needed: it takes longer than all the rest
    except ImportError:
        return ""  # Python 3.10, on a system where the gateway runs in a container

    path = os.environ.get("CRUISER_CONFIG", SETTINGS_FILE)
    tables = {}
    try:
        with open(path, "rb") as file:  # noqa: PTH123 - pathlib takes longer still
            tables = tomllib.load(file)
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:
        say(f"{path}: {error}")
    robot, can, gateway = (tables.get(table, {}) for table in ("robot", "can", "gateway"))
    directory = gateway.get("state_dir", "auto")
    if directory == "auto":
        directory = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if can.get("channel", "can0") != interface or not directory:
        return ""
    name = f"{robot.get('root', 'fleet')}/{robot.get('name', 'cruiser-1')}".replace("/", ".")
    return f"{directory}/{name}.guard-stop"


def is_claimed(interface: str) -> bool:
    """A gateway on this machine commands this bus (``gateway.can.open_bus``)."""
    import hashlib  # noqa: PLC0415 - while the first frames are waited for

    digest = hashlib.sha256(f"socketcan {interface}".encode()).hexdigest()[:32]
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as asking:
        try:
            asking.connect(f"\0cruiser-gateway/{digest}")
        except OSError:
            return False
    return True


class Watch:
    """Watches one interface until a gateway is running, or the time is over."""

    def __init__(self, interface: Interface, name: str, note: EarlyNote, watch_ns: int = WATCH_NS) -> None:
        self._interface = interface
        self._name = name
        self._note = note
        self._looked_ns = self._asked_ns = time.monotonic_ns()
        self._end_ns = self._looked_ns + watch_ns
        self._stop = EarlyStop(self._looked_ns)
        self._is_announced = False

    def run(self) -> None:
        """Watch; complete a stop that has begun. Raises OSError: the interface is down or has disappeared."""
        while not self._is_over(time.monotonic_ns()):
            self._act(time.monotonic_ns())
            time.sleep(POLL_S if self._stop.is_sending else WATCH_POLL_S)
            now_ns = time.monotonic_ns()
            is_old = now_ns - self._looked_ns > GUARD_SILENT_NS
            self._looked_ns = now_ns
            for frame in self._interface.waiting():
                # Frames received during a pause of this process are old.
                if not is_old:
                    self._stop.chassis.receive(*frame, now_ns)

    def _is_over(self, now_ns: int) -> bool:
        if self._stop.is_sending:
            return False
        is_needed = self._stop.is_needed(now_ns)
        if is_needed or now_ns - self._asked_ns > CLAIM_POLL_NS:
            self._asked_ns = now_ns
            if is_claimed(self._name):
                say("a gateway is running")
                return True
        if is_needed:
            self._stop.begin(now_ns)
            self._is_announced = False
        elif now_ns > self._end_ns:
            say("no gateway has started; no longer watching")
            return True
        return False

    def _act(self, now_ns: int) -> None:
        stop = self._stop
        if not stop.is_sending:
            return
        frames = stop.tick(now_ns)
        if frames:
            stop.sent(self._interface.send(frames), now_ns)
        if not self._is_announced:
            # Send first: writing a line may block.
            self._is_announced = True
            self._announce(FOUND)
        if not stop.is_sending:
            self._announce(f"done: {stop.outcome}; {stop.frames} frames sent")

    def _announce(self, line: str) -> None:
        """Write a line to stderr and to the note."""
        say(line.removeprefix("early stop: "))
        self._note.add(line)


def look(names: list[str]) -> int:
    """Look at each interface for half a second. Returns MOVES if a robot moves or is commanded."""
    code = 0
    for name in names:
        chassis = Chassis()
        try:
            interface = Interface(name)
            for _ in range(LOOKS):
                time.sleep(WATCH_POLL_S)
                now_ns = time.monotonic_ns()
                for frame in interface.waiting():
                    chassis.receive(*frame, now_ns)
        except OSError:
            continue  # Down or missing: nothing can be known, and nothing is commanded from here.
        now_ns = time.monotonic_ns()
        is_moving = chassis.is_moving(now_ns) or chassis.moves(now_ns)
        if is_moving or chassis.is_commanded(now_ns):
            say(f"the robot on {name} {'moves' if is_moving else 'is being commanded'}")
            code = MOVES
    return code


def main(words: list[str]) -> int:
    """Watch, or look. Returns the exit code."""
    if words[:1] == ["--look"]:
        return look(words[1:])
    (name,) = words
    note = EarlyNote(name)
    try:
        interface = appeared(name)
        while interface is not None:
            while not interface.is_up:
                time.sleep(LINK_POLL_S)
            try:
                Watch(interface, name, note).run()
                break
            except OSError as error:
                if error.errno != errno.ENETDOWN:
                    raise
    except OSError as error:
        say(f"{name}: {error.strerror}")
    finally:
        note.close()
    return 0


def appeared(name: str) -> Interface | None:
    """Wait for the interface, which may appear later. None if it does not. Raises OSError."""
    end_s = time.monotonic() + APPEAR_S
    while time.monotonic() < end_s:
        try:
            return Interface(name)
        except OSError as error:
            if error.errno not in {errno.ENODEV, errno.EAFNOSUPPORT}:
                raise
        time.sleep(LINK_POLL_S)
    say(f"there is no {name}; udev starts this program again when it appears")
    return None


def say(line: str) -> None:
    sys.stderr.write(f"early stop: {line}\n")
    sys.stderr.flush()


def _time_of_day() -> str:
    now_ns = time.time_ns()
    whole = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(now_ns // 1_000_000_000))
    return f"{whole}.{now_ns // MS % 1000:03d}+00:00"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

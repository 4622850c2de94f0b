"""The early stop sends the frames of the guard's stop, byte for byte, and only to a robot without a commander."""

import ast
import random
import sys
from pathlib import Path

import pytest

from gateway.chassis.cruiser import early_stop
from gateway.chassis.cruiser import frames as names
from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.early_stop import AUTO, FOUND, Command, EarlyStop
from gateway.chassis.cruiser.frames import load
from gateway.chassis.cruiser.guard_view import ChassisView
from gateway.chassis.frame import EXTENDED, Frame
from gateway.chassis.layout import Value
from gateway.chassis.port import Actuation
from gateway.chassis.supervision import silence_ns
from gateway.choice.chassis import CHASSIS
from gateway.guard.stopper import Stopper
from gateway.host.notes import StopNote
from gateway.sim.body import Conditions
from gateway.sim.model import VirtualChassis
from schemas import settings
from schemas.cruiser import STEERING_TOP_DEG, TURNING_RAW_MIN
from schemas.messages import GearPosition, Mode, ParkingStatus, Variant
from tests.support.frames import MS, Feedback
from tests.support.nights import seeds
from tests.support.rigs.chassis import fault_line

FILE = Path(early_stop.__file__)
POLL_NS = 5 * MS
VARIANTS = [Variant.COARSE, Variant.FINE]


class Left:
    """A robot that was driven when the power of its computer went, and the early stop a little later."""

    def __init__(
        self,
        variant: Variant,
        speed_mps: float = 1.0,
        *,
        gear: GearPosition = GearPosition.DRIVE,
        angle_deg: float = 0.0,
        conditions: Conditions | None = None,
    ) -> None:
        self.now_ns = 0
        self.chassis = VirtualChassis(CHASSIS, variant, 0, conditions=conditions or Conditions())
        told = Actuation(enabled=True, gear=gear, speed_mps=speed_mps, angle_deg=angle_deg, parking=False)
        for frame in FrameMaker().make(told, [], variant):
            self.chassis.receive(frame, 0)
        self.chassis.advance(3_000 * MS)
        self.now_ns = 3_000 * MS
        self.early = EarlyStop(self.now_ns)

    def frames(self) -> list[Frame]:
        """Frames of the chassis since the last call."""
        return self.chassis.advance(self.now_ns)

    def step(self) -> list[Command]:
        """One look of the early stop; the chassis receives what it sends."""
        self.now_ns += POLL_NS
        for frame in self.frames():
            self.early.chassis.receive(frame.can_id, frame.data, self.now_ns)
        if self.early.is_needed(self.now_ns):
            self.early.begin(self.now_ns)
        sent = self.early.tick(self.now_ns)
        for can_id, data in sent:
            self.chassis.receive(Frame(can_id, data), self.now_ns)
        self.early.sent(len(sent), self.now_ns)
        return sent

    def until(self, seconds: float) -> list[tuple[int, list[Command]]]:
        """Bursts, each with its time since the start."""
        end_ns = self.now_ns + round(seconds * 1e9)
        bursts = []
        while self.now_ns < end_ns:
            burst = self.step()
            if burst:
                bursts.append((self.now_ns - 3_000 * MS, burst))
        return bursts


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("gear", [GearPosition.DRIVE, GearPosition.REVERSE])
@pytest.mark.parametrize("speed_mps", [0.2, 0.46, 2.2])
def test_a_robot_left_in_motion_is_told_zero_at_once_and_ends_parked(
    variant: Variant, gear: GearPosition, speed_mps: float
) -> None:
    """Zero 0.15 s after the first frame; then it stands behind its brake, without commands."""
    left = Left(variant, speed_mps, gear=gear, angle_deg=10.0)
    assert abs(left.chassis.state.speed_mps) == pytest.approx(speed_mps, abs=0.05)
    bursts = left.until(6)
    assert bursts[0][0] <= 150 * MS
    assert bursts[0][1][0][0] == early_stop.DRIVE_COMMAND
    assert all(burst[0][1][1:3] == b"\0\0" for _, burst in bursts)
    state = left.chassis.state
    assert (state.speed_mps, state.parking_status, state.mode) == (0.0, ParkingStatus.APPLIED, Mode.STOP)
    assert left.early.outcome == "the robot stands"
    assert left.until(1) == []


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    "silent",
    [
        (),
        ("Auto_DriveFeedBack",),
        ("Auto_MileageAndBodyFeedback",),
        ("Auto_DriveFeedBack", "Auto_MileageAndBodyFeedback"),
        ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback"),
        ("Auto_DriveFeedBack", "Auto_WheelSpdFeedback", "Auto_MileageAndBodyFeedback"),
        ("Auto_WheelSpdFeedback", "Auto_WheelPulseFeedback"),
    ],
)
def test_whatever_shows_the_motion_is_enough(silent: tuple[str, ...], variant: Variant) -> None:
    """Drive feedback, wheels or pulses, with or without body frames: who moves is stopped."""
    left = Left(variant)
    for name in silent:
        left.chassis.inject(fault_line(f"silence {name}"), left.now_ns)
    left.until(3.0)
    assert left.chassis.state.speed_mps == 0
    assert left.chassis.state.parking_status is ParkingStatus.APPLIED


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_robot_that_another_computer_commands_is_left_alone(variant: Variant) -> None:
    """A burst each 10 ms on the bus; also when it begins while the early stop listens."""
    left, maker = Left(variant), FrameMaker()
    told = Actuation(enabled=True, gear=GearPosition.DRIVE, speed_mps=1.0, parking=False)
    for _ in range(200):
        frames = maker.make(told, [], variant)
        maker.sent(frames)
        for frame in frames:
            left.early.chassis.receive(frame.can_id, frame.data, left.now_ns)
        assert left.step() == []
    assert left.chassis.state.speed_mps > 0.9


def test_a_robot_that_stands_is_left_alone() -> None:
    """In auto; and eight zero bytes, which are no valid frame, are no mode auto."""
    left = Left(Variant.COARSE, 0.0)
    assert left.chassis.state.mode is Mode.AUTO
    assert left.until(3) == []
    chassis = early_stop.Chassis()
    chassis.receive(early_stop.BODY, bytes(8), 0)
    assert chassis.mode(0) != AUTO


def test_a_robot_that_the_remote_control_has_is_left_alone() -> None:
    """Given back, it would execute its old command again, and is stopped then."""
    left = Left(Variant.COARSE)
    left.chassis.inject(fault_line("transmitter remote for 2s"), left.now_ns)
    assert left.until(1.9) == []
    assert left.early.outcome == "", "nor is it said to be stopped"
    assert left.until(8)
    assert left.chassis.state.speed_mps == 0.0


# The same as the guard's.


def test_every_constant_is_the_products() -> None:
    """Identifiers, times and scales."""
    layout = load(Variant.COARSE)
    for name in ("GEAR", "STEERING", "DRIVE", "PARKING", "WHEEL_SPEED", "BODY"):
        message = layout.messages[getattr(names, name)]
        assert getattr(early_stop, name) == message.can_id
        assert early_stop.SILENCE_NS[message.can_id] == silence_ns(message.period_ns)
    for name in ("DRIVE", "GEAR", "STEERING", "BRAKING", "PARKING", "LIGHT", "SPEAKER", "ODOMETER"):
        command = f"{name}_COMMAND"
        assert getattr(early_stop, command) == layout.messages[getattr(names, command)].can_id
    for name in (
        *("TICK_NS", "COMMANDER_NS", "GUARD_LOOK_NS", "GUARD_SILENT_NS", "NOT_SLOWING_NS", "BRAKE_UNSEEN_NS"),
        *("HOLD_NS", "DISABLE_NS", "REMOTE_FRAMES", "OFF_BURSTS"),
    ):
        assert getattr(early_stop, name) == getattr(settings, name), name
    assert early_stop.STANDS_NS == settings.STANDSTILL_TICKS * settings.TICK_NS
    assert early_stop.GIVES_UP_NS == settings.GUARD_GIVES_UP_NS
    assert (early_stop.TURNING_RAW_MIN, early_stop.ANGLE_TOP_DEG) == (TURNING_RAW_MIN, STEERING_TOP_DEG)
    angle = layout.messages[names.STEERING].signal("Angle")
    assert (angle.scale, angle.offset) == (early_stop.ANGLE_SCALE_DEG, early_stop.ANGLE_OFFSET_DEG)
    assert early_stop.EXTENDED == EXTENDED


def test_every_wheel_speed_stands_or_not_as_the_guard_says() -> None:
    """For every raw value of a wheel, and with unused bits set."""
    view = ChassisView()
    for raw in range(1 << 16):
        for other in (raw, 200, 32768):
            word = 1 | raw << 8 | other << 24
            data = early_stop._data(word, raw & 15)
            expected = view._evidence.of(data) is not Variant.UNKNOWN
            assert early_stop._wheels_stand(data) is expected, (raw, other)


class Pair:
    """The early stop and the guard's, which see the same and begin together: their frames must be the same."""

    def __init__(self, early: EarlyStop, chance: random.Random) -> None:
        self.early = early
        self.bursts = 0
        self._view = ChassisView()
        self._stopper = Stopper(CHASSIS, self._view, settings.CommandSettings())
        self._chance = chance

    def step(self, frames: list[Frame], now_ns: int) -> list[Frame]:
        """Receive these, and look. Returns what the bus took, which is now and then a part."""
        early, stopper = self.early, self._stopper
        for frame in frames:
            self._view.receive(frame, now_ns)
            early.chassis.receive(frame.can_id, frame.data, now_ns)
        if early.is_needed(now_ns):
            early.begin(now_ns)
            counters = bytes(early._counters[can_id] for can_id in ORDER)
            stopper.begin(None, Variant.UNKNOWN, counters, now_ns)
        sent, expected = early.tick(now_ns), stopper.tick(now_ns)
        if stopper.is_paused:
            stopper.give_up("the remote control has the robot")
        assert sent == [(frame.can_id, frame.data) for frame in expected], now_ns
        is_part = bool(sent) and self._chance.random() < 0.05
        count = self._chance.randrange(len(sent) + 1) if is_part else len(sent)
        early.sent(count, now_ns)
        stopper.sent(count, now_ns)
        assert early.is_sending is not stopper.is_over
        assert early.is_sending or early.outcome == stopper.outcome
        self.bursts += bool(sent)
        return expected[:count]


@pytest.mark.parametrize("seed", seeds(6, 60))
def test_its_frames_are_those_of_the_guards_stop(seed: int) -> None:
    """On slopes, with wrong frames, on a bus that accepts a part."""
    chance = random.Random(seed)  # noqa: S311 - a scene, no secret
    left = Left(
        chance.choice(VARIANTS),
        chance.uniform(0.2, 2.2),
        gear=chance.choice([GearPosition.DRIVE, GearPosition.REVERSE]),
        angle_deg=chance.uniform(-24, 24),
        conditions=Conditions(slope_deg=chance.choice([0.0, chance.uniform(-20, 20)])),
    )
    for _ in range(chance.randrange(3)):
        left.chassis.inject(fault_line(chance.choice(FAULTS)), left.now_ns + chance.randrange(4_000) * MS)
    pair = Pair(left.early, chance)
    for _ in range(8_000 // 5):
        left.now_ns += POLL_NS + (300 * MS if chance.random() < 0.001 else 0)
        for frame in pair.step(left.frames(), left.now_ns):
            left.chassis.receive(frame, left.now_ns)
    assert pair.bursts


@pytest.mark.parametrize("seed", seeds(6, 60))
def test_its_frames_are_the_guards_for_feedback_that_no_chassis_would_send(seed: int) -> None:
    """Independent modes, brakes, gears, angles and speeds."""
    chance = random.Random(seed)  # noqa: S311 - a scene, no secret
    feedback = Feedback(chance.choice(VARIANTS))
    pair = Pair(EarlyStop(0), chance)
    values: dict[str, dict[str, Value]] = {}
    for now_ns in range(10 * MS, 15_000 * MS, 10 * MS):
        is_long = now_ns > 1_000 * MS
        if not is_long or chance.random() < 0.01:
            modes: list[Value] = ["auto", "auto", "stop", 3]
            gears: list[Value] = ["reverse", "drive", "neutral", "park", 0, 7]
            brakes: list[Value] = ["applied", "released", 0]
            values = {
                names.BODY: {"Mode": chance.choice(modes) if is_long else "auto"},
                names.DRIVE: {"Speed": chance.choice([0.0, 0.0, 0.1, 2.0]) if is_long else 0.5},
                names.GEAR: {"GearPosition": chance.choice(gears)},
                names.STEERING: {"Angle": chance.uniform(-90, 89)},
                names.PARKING: {"ParkingStatus": chance.choice(brakes)},
            }
        kept = [name for name in (*values, names.WHEEL_SPEED) if chance.random() < 0.9]
        pair.step([feedback.frame(name, values.get(name, {})) for name in kept], now_ns)
    assert pair.bursts > 50


ORDER = [message.can_id for message in load(Variant.COARSE).commands]

FAULTS = (
    "transmitter remote for 1s",
    *(f"silence {name} for 1s" for name in (names.DRIVE, names.BODY, names.WHEEL_SPEED, names.GEAR)),
    f"silence {names.PARKING}",
    f"stuck {names.BODY} for 1s",
    f"checksum {names.DRIVE} for 1s",
    f"freeze {names.DRIVE} for 1s",
    f"drop {names.BODY} every 2",
    "motor 0.1",
    "scale wrong",
    "reboot",
)


# The file, and what is around it.


def test_it_imports_small_modules_of_the_standard_library_alone() -> None:
    """Nothing that would have to be installed, and nothing of ours."""
    imported = set[str]()
    for node in ast.walk(ast.parse(FILE.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(str(node.module).partition(".")[0])
    small = "__future__ _thread errno fcntl hashlib os socket struct sys time tomllib"
    assert imported == set(small.split()) <= sys.stdlib_module_names


@pytest.mark.parametrize(
    ("tables", "interface", "file"),
    [
        ("", "can0", "fleet.cruiser-1.guard-stop"),
        ('[robot]\nname = "seven"\nroot = "a/b"', "can0", "a.b.seven.guard-stop"),
        ('[can]\nchannel = "can1"', "can1", "fleet.cruiser-1.guard-stop"),
        ('[can]\nchannel = "can1"', "can0", ""),
        ('[gateway]\nstate_dir = ""', "can0", ""),
        ("no toml", "can0", "fleet.cruiser-1.guard-stop"),
    ],
)
def test_its_note_is_the_guards(
    tables: str, interface: str, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The gateway finds it under the same name, and reads it with its writer."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    (tmp_path / "cruiser.toml").write_text(tables, "utf-8")
    monkeypatch.setenv("CRUISER_CONFIG", str(tmp_path / "cruiser.toml"))
    note = early_stop.EarlyNote(interface)
    for line in (FOUND, "done: the robot stands; 9 frames sent"):
        note.add(line)
        note.close()
        note._is_done.release()
    assert [path.name for path in tmp_path.glob("*.guard-stop")] == ([file] if file else [])
    if file:
        kept = StopNote(tmp_path / file)
        assert FOUND in kept.read()
        assert "damaged" not in kept.read()
        last = kept.last()
        assert last is not None
        assert last[1] == "guard: done: the robot stands; 9 frames sent"


class Cable:
    """The interface of a robot that was left, and the time."""

    def __init__(self, left: Left) -> None:
        self._left = left

    def waiting(self) -> list[Command]:
        return [(frame.can_id, frame.data) for frame in self._left.frames()]

    def send(self, frames: list[Command]) -> int:
        """All of them reach the chassis."""
        for can_id, data in frames:
            self._left.chassis.receive(Frame(can_id, data), self._left.now_ns)
        return len(frames)

    def monotonic_ns(self) -> int:
        return self._left.now_ns

    def sleep(self, seconds: float) -> None:
        self._left.now_ns += round(seconds * 1e9)


def test_a_stop_is_noted_so_that_the_gateway_latches_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """When it begins, and how it ends."""
    cable, lines = Cable(Left(Variant.COARSE)), list[str]()
    note = early_stop.EarlyNote("none")
    monkeypatch.setattr(note, "add", lines.append)
    monkeypatch.setattr(early_stop, "time", cable)
    monkeypatch.setattr(early_stop, "is_claimed", lambda _name: False)
    early_stop.Watch(cable, "none", note, watch_ns=6_000 * MS).run()  # type: ignore[arg-type]
    begun, done = lines
    assert begun == FOUND
    assert done.startswith("done: the robot stands; ")

"""The load of the recorder's bench: robots that publish what a driving robot publishes, at its rates.

The gateway's core makes eight seconds once. Each robot repeats them from its own offset with its own times and
sequences, so that a loss shows. A put waits for capacity, and the load reports whether it held the pace.

Usage: python -m tests.bench.recorder_load ENDPOINT --robots N --ticks N [--paced] [--profile P] [--client]
"""

from __future__ import annotations

import argparse
import math
import random
import struct
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any, Final

import msgspec
import zenoh

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.chassis.layout import Value
from gateway.choice.chassis import CHASSIS
from gateway.core import Core
from gateway.telemetry.health import Links
from schemas import codec, keys
from schemas.codec import Sample
from schemas.messages import CanFrames, Variant
from schemas.settings import FULL, PROFILES, TICK_NS, ChassisSettings, Settings, ZenohSettings
from schemas.subjects import BY_NAME, Pattern
from schemas.zenoh_session import close_session, open_session
from tests.support.frames import STANDING, WALL_NS, Feedback

ROOT: Final = "fleet"
BUS: Final = "can0"

SECONDS_OF_FRAMES: Final = 8  # then every alive counter is where it began, and the frames repeat
TICKS_PER_S: Final = 1_000_000_000 // TICK_NS
SLOTS: Final = SECONDS_OF_FRAMES * TICKS_PER_S  # ticks until a robot repeats itself
STAGGER: Final = 10  # robots tick at so many different instants of a tick
CONNECT_S: Final = 20.0

_TIME_KEY: Final = b"\xa7time_ns"
_SEQUENCE_KEY: Final = b"\xa8sequence"
_STAMP: Final = struct.Struct(">8scQ9scI")  # time and sequence in MessagePack's widest forms, of constant size
_INT_BYTES: Final = {0xCC: 2, 0xCD: 3, 0xCE: 5, 0xCF: 9}
_MAP16: Final = 0xDE


class Said(msgspec.Struct, frozen=True, gc=False):
    """One sample: the payload before and after time and sequence, and its number of log records."""

    subject: int
    records: int
    head: bytes
    tail: bytes


class Script(msgspec.Struct, frozen=True):
    subjects: list[str]
    slots: list[list[Said]]

    @property
    def samples_per_s(self) -> float:
        return sum(map(len, self.slots)) / SECONDS_OF_FRAMES

    @property
    def records_per_s(self) -> float:
        return sum(said.records for slot in self.slots for said in slot) / SECONDS_OF_FRAMES


class Fed(msgspec.Struct, frozen=True):
    """What was published; ``late_s`` is how far behind the robots' pace it ended."""

    samples: int
    records: int
    begin_ns: int
    end_ns: int
    late_s: float


def make_script(profile: str = FULL) -> Script:
    """Let the gateway's core publish a drive, with one of the profiles of ``schemas.settings``."""
    rates = PROFILES[profile]
    subjects = [
        name for name in BY_NAME if BY_NAME[name].pattern is Pattern.PUBLISHED and rates.get(name, math.inf)
    ]
    core = Core(CHASSIS, Settings(chassis=ChassisSettings(variant="coarse")), "bench", 0)
    core.update_links(Links(bus_up=True), 0)
    frames = deque(_frames())
    slots = []
    due_ns = dict.fromkeys(subjects, 0)
    for now_ns in range(0, SLOTS * TICK_NS, TICK_NS):
        samples = []
        while frames and frames[0].wall_ns <= WALL_NS + now_ns:
            sample = core.receive_frame(frames.popleft(), now_ns)
            if sample is not None:
                samples.append(sample)
        samples += core.tick(now_ns, WALL_NS + now_ns, 0, now_ns.to_bytes(8)).samples
        samples += core.sent(0, now_ns, WALL_NS + now_ns)
        slot = []
        for one in samples:
            if one.subject in due_ns and now_ns >= due_ns[one.subject]:
                due_ns[one.subject] = now_ns + round(1e9 / rates.get(one.subject, math.inf))
                slot.append(_said(one, subjects.index(one.subject)))
        slots.append(slot)
    return Script(subjects, slots)


def _frames() -> Iterator[Frame]:
    """Feedback of a chassis that changes speed and direction, with sensor noise."""
    noise = random.Random(1)  # noqa: S311 - reproducible, not secret
    feedback, layout = Feedback(Variant.COARSE), load(Variant.COARSE)
    travelled_m = 0.0
    for now_ns in range(0, SLOTS * TICK_NS, TICK_NS):
        turn = 2 * math.pi * now_ns / (SLOTS * TICK_NS)
        speed_mps = 1.2 + 0.8 * math.sin(turn) + noise.gauss(0, 0.04)
        travelled_m += speed_mps * TICK_NS / 1e9
        pulses = int(travelled_m * 1000) % 32768
        values: dict[str, dict[str, Value]] = {
            "Auto_GearFeedBack": {"GearPosition": "drive"},
            "Auto_SteeringFeedBack": {"Angle": 12 * math.sin(2 * turn) + noise.gauss(0, 0.1)},
            "Auto_DriveFeedBack": {"Speed": speed_mps},
            "Auto_ParkingFeedBack": {"ParkingStatus": "released"},
            "Auto_WheelSpdFeedback": {
                "RearLeftSpeed": speed_mps + noise.gauss(0, 0.04),
                "RearRightSpeed": speed_mps + noise.gauss(0, 0.04),
            },
            "Auto_WheelPulseFeedback": {"RearLeftPulses": pulses, "RearRightPulses": pulses},
            "Auto_MileageAndBodyFeedback": {"TotalMileage": 1.5 + travelled_m / 1000, "Mode": "remote"},
        }
        for name in STANDING:
            if now_ns % layout.messages[name].period_ns == 0:
                frame = feedback.frame(name, {**STANDING[name], **values.get(name, {})}, WALL_NS + now_ns)
                yield frame


def _said(sample: Sample, subject: int) -> Said:
    """Cut time and sequence out of a payload: they are its first two fields."""
    payload = sample.payload
    head = 3 if payload[0] == _MAP16 else 1
    tail = head
    for key in (_TIME_KEY, _SEQUENCE_KEY):
        assert payload[tail:].startswith(key)
        tail += len(key)
        tail += _INT_BYTES.get(payload[tail], 1)
    message = codec.decode(BY_NAME[sample.subject], payload)
    records = len(message.data) if isinstance(message, CanFrames) else 1
    return Said(subject, records, payload[:head], payload[tail:])


def appear(sessions: Sequence[zenoh.Session], robots: int) -> list[zenoh.LivelinessToken]:
    return [
        sessions[robot % len(sessions)].liveliness().declare_token(keys.liveliness(ROOT, _name(robot)))
        for robot in range(robots)
    ]


def declare(sessions: Sequence[zenoh.Session], script: Script, robots: int) -> list[list[zenoh.Publisher]]:
    """Declare each robot's publishers, in the script's order, and wait until each has a subscriber."""
    publishers = [
        [_publisher(sessions[robot % len(sessions)], robot, name) for name in script.subjects]
        for robot in range(robots)
    ]
    deadline_s = time.monotonic() + CONNECT_S
    # Its stub says that the matching status is a bool; it is an object, and always true.
    last: list[Any] = [row[-1] for row in publishers]
    while not all(one.matching_status.matching for one in last):
        if time.monotonic() > deadline_s:
            raise TimeoutError("nobody subscribes")
        time.sleep(0.01)
    return publishers


def feed(publishers: Sequence[Sequence[zenoh.Publisher]], script: Script, ticks: int, *, is_paced: bool) -> Fed:
    """Publish so many ticks of all robots, at their pace or as fast as possible."""
    robots = len(publishers)
    begin_ns = time.time_ns()
    begin_s = time.monotonic()
    states = [([one.put for one in row], [0] * len(row)) for row in publishers]
    stamp, slots = _STAMP.pack, script.slots
    samples = records = 0
    for step in range(ticks * STAGGER):
        if is_paced:
            while (early_s := begin_s + step / STAGGER / TICKS_PER_S - time.monotonic()) > 0:
                time.sleep(early_s)
        tick, first = divmod(step, STAGGER)
        for robot in range(first, robots, STAGGER):
            puts, sequences = states[robot]
            # Each robot begins at a place of its own.
            slot = slots[(tick + robot * 37) % SLOTS]
            now_ns = time.time_ns()
            for said in slot:
                subject = said.subject
                sequence = sequences[subject]
                sequences[subject] = sequence + 1
                puts[subject](
                    said.head + stamp(_TIME_KEY, b"\xcf", now_ns, _SEQUENCE_KEY, b"\xce", sequence) + said.tail
                )
                records += said.records
            samples += len(slot)
    late_s = time.monotonic() - begin_s - ticks / TICKS_PER_S if is_paced else 0.0
    return Fed(samples, records, begin_ns, time.time_ns(), late_s)


def _name(robot: int) -> str:
    return f"cruiser-{robot + 1}"


def _publisher(session: zenoh.Session, robot: int, name: str) -> zenoh.Publisher:
    subject = BY_NAME[name]
    return session.declare_publisher(
        keys.build(ROOT, _name(robot), subject, BUS if "{bus}" in name else ""),
        encoding=subject.encoding,
        priority=getattr(zenoh.Priority, subject.qos.priority.value),
        express=subject.qos.express,
        # Not as a gateway does: it is the receiver that is measured, and what it loses.
        congestion_control=zenoh.CongestionControl.BLOCK,
    )


def main() -> None:
    """At a line of input declare the robots, at the next publish; end with the input."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("endpoint")
    parser.add_argument("--robots", type=int, required=True)
    parser.add_argument("--ticks", type=int, required=True)
    parser.add_argument("--paced", action="store_true")
    parser.add_argument("--profile", choices=PROFILES, default=FULL, help="how much of it leaves each robot")
    parser.add_argument(
        "--client", action="store_true", help="the endpoint is a router's; each robot is a client of its own"
    )
    arguments = parser.parse_args()
    script = make_script(arguments.profile)
    if arguments.client:
        client = ZenohSettings(mode="client")
        sessions = [open_session(client, [arguments.endpoint], []) for _ in range(arguments.robots)]
    else:
        sessions = [open_session(ZenohSettings(), [], [arguments.endpoint])]
    try:
        print("listening", flush=True)
        sys.stdin.readline()
        tokens = appear(sessions, arguments.robots)
        publishers = declare(sessions, script, arguments.robots)
        print("declared", flush=True)
        sys.stdin.readline()
        fed = feed(publishers, script, arguments.ticks, is_paced=arguments.paced)
        print(msgspec.json.encode(fed).decode(), flush=True)
        sys.stdin.read()
        # A token that nobody keeps is undeclared, perhaps before anybody has heard of it.
        tokens.clear()
    finally:
        for session in sessions:
            close_session(session)


if __name__ == "__main__":
    main()

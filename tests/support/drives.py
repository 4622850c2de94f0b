"""Made-up drives, as messages, as samples and as logs; each is used where its figures are looked at."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import msgspec

from recorder.encoding.samples import ReceivedSample
from recorder.record.robot_log import LogPlan
from schemas.decisions import ArbiterState, EventKind
from schemas.messages import CanFrames, Message
from tests.support.logs import Log
from tests.support.messages import (
    MS,
    PERIOD_NS,
    SECOND,
    WALL_NS,
    FakeSample,
    arbiter,
    batch,
    event,
    feedback,
    gear,
    info,
    refusal,
    safety_event,
    sample_of,
    state,
)

STEP_NS = 10 * MS  # between the messages of ``drive``

FRAMES = 5


def drive_log(robot: str = "cruiser-1", first: int = 0, count: int = 20) -> bytes:
    """A whole log: gears 10 ms apart, raw frames, an event, an unknown key, and the gateway's info."""
    log = Log(LogPlan(name=robot, chunk_bytes=262_144, flush_ns=SECOND // 2, version="0.1.0"))
    for number in range(first, first + count):
        time_ns = WALL_NS + number * 10 * MS
        log.receive(sample_of(gear(number, time_ns), robot), wall_ns=time_ns, now_ns=number * 10 * MS)
        log.tick(number * 10 * MS)
    log.receive(sample_of(frames(first), robot), wall_ns=WALL_NS + first * 10 * MS)
    log.receive(sample_of(safety_event(EventKind.LATCH, sequence=first), robot), wall_ns=WALL_NS)
    log.receive(FakeSample(f"fleet/{robot}/strange", "text/plain", b"hello"), wall_ns=WALL_NS)
    log.receive(sample_of(info(), robot), wall_ns=WALL_NS)
    return log.close()


def frames(sequence: int) -> CanFrames:
    """A batch of raw frames, 1.000001 ms apart."""
    start_ns = WALL_NS + sequence * 10 * MS
    return batch(sequence, [(start_ns + number * 1_000_001, feedback(number)) for number in range(FRAMES)])


def drive_samples(count: int = 20, root: str = "fleet") -> list[ReceivedSample]:
    """Samples of a robot: gears with two frames each, its info; and a foreign one."""
    found: list[ReceivedSample] = [sample_of(info(), root=root)]
    for number in range(count):
        time_ns = WALL_NS + number * STEP_NS
        frames = [(time_ns - 3 * MS, feedback(2 * number)), (time_ns - MS, feedback(2 * number + 1))]
        found += [
            sample_of(gear(number, time_ns), root=root),
            sample_of(batch(number, frames), root=root),
        ]
    return [*found, FakeSample(f"{root}/elsewhere", "text/plain", b"hello", attachment=b"with this")]


def write_samples(path: Path, samples: Sequence[ReceivedSample], offset_ns: int = 0) -> Path:
    """A log of samples, each received a step after the one before."""
    log = Log()
    for number, sample in enumerate(samples):
        log.receive(sample, now_ns=number * STEP_NS, wall_ns=WALL_NS + offset_ns + number * STEP_NS)
    path.write_bytes(log.close())
    return path


# Shown as it is, and without effect.
HOSTILE: Final = (
    "</script><script>document.body.dataset.owned=1</script><img src=http://evil.test/x> <b>&amp; $x^2$ \u202e"
)


def drive_messages(periods: int = 200) -> list[Message]:
    """A drive that a bumper ends."""
    found: list[Message] = []
    for number in range(periods):
        found += [state(number, angle_deg=10.0), arbiter(number)]
    return [*found, refusal(periods - 1), event(periods - 1)]


def restart(periods: int = 200, silent: int = 60) -> list[Message]:
    """A drive; its gateway dies, and after ``silent`` periods another one stands by."""
    found: list[Message] = [one for number in range(periods) for one in (state(number), arbiter(number))]
    for number in range(periods + silent, periods + silent + 40):
        other = arbiter(number, sequence=number - periods - silent, state=ArbiterState.STANDBY, lease_holder="")
        found += [state(number, speed_mps=0.0), msgspec.structs.replace(other, tick=10**12 + 5 * number)]
    return found


def write_messages(path: Path, messages: Iterable[Message], robots: Iterable[str] = ("cruiser-1",)) -> Path:
    """A log in which each robot publishes all these messages, received when they were sent."""
    log = Log()
    for robot in robots:
        log.receive(sample_of(info(), robot))
    for message in messages:
        for robot in robots:
            log.receive(sample_of(message, robot), wall_ns=message.time_ns)
    path.write_bytes(log.close())
    return path


def drives_over(days: int, count: int, periods: int = 60) -> list[Message]:
    """Drives that a bumper ends, spread over so many days; nothing is recorded between them."""
    apart = days * 24 * 3600 * SECOND // PERIOD_NS // count
    return [
        message
        for first in range(0, count * apart, apart)
        for message in (
            *(one for number in range(first, first + periods) for one in (state(number), arbiter(number))),
            event(first + periods - 1),
        )
    ]

"""Logs of small drives as files."""

from pathlib import Path

from recorder.record.robot_log import LogPlan
from schemas.decisions import EventKind
from schemas.messages import CanFrames
from tests.support.recorder_fakes import (
    MS,
    SECOND,
    WALL_NS,
    FakeSample,
    Log,
    batch,
    feedback,
    gear,
    info,
    safety_event,
    sample_of,
)

FRAMES = 5


def drive(robot: str = "cruiser-1", first: int = 0, count: int = 20, late_ns: int = 0) -> bytes:
    """A whole log: gears, raw frames, an event, a strange key, and what the gateway says of itself.

    Args:
        robot: whose it is.
        first: sequence of the first gear, each 10 ms after the one before.
        count: gears.
        late_ns: so much later than it was said the recorder has heard it.
    """
    log = Log(LogPlan(name=robot, chunk_bytes=262_144, flush_ns=SECOND // 2, version="0.1.0"))
    for number in range(first, first + count):
        time_ns = WALL_NS + number * 10 * MS
        log.receive(sample_of(gear(number, time_ns), robot), wall_ns=time_ns + late_ns, now_ns=number * 10 * MS)
        log.tick(number * 10 * MS)
    log.receive(sample_of(frames(first), robot), wall_ns=WALL_NS + first * 10 * MS + late_ns)
    log.receive(sample_of(safety_event(EventKind.LATCH, sequence=first), robot), wall_ns=WALL_NS + late_ns)
    log.receive(FakeSample(f"fleet/{robot}/strange", "text/plain", b"hello"), wall_ns=WALL_NS + late_ns)
    log.receive(sample_of(info(), robot), wall_ns=WALL_NS + late_ns)
    return log.close()


def frames(sequence: int) -> CanFrames:
    """A batch of raw frames, 1.000001 ms apart."""
    start_ns = WALL_NS + sequence * 10 * MS
    return batch(sequence, [(start_ns + number * 1_000_001, feedback(number)) for number in range(FRAMES)])


def write(directory: Path, name: str, data: bytes) -> Path:
    """A file."""
    path = directory / f"{name}.mcap"
    path.write_bytes(data)
    return path

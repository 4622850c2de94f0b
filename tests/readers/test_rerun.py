"""A log as rerun reads it, against the mcap package (``make readers``; rerun has its own environment)."""

import json
import os
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from recorder.disk.files import LogDirectory
from recorder.disk.log_writer import LogWriter
from recorder.encoding.samples import ReceivedSample
from recorder.loop import RecorderLoop
from recorder.record.recorder import HealthReport, Recorder, SampleInbox
from schemas import codec, keys
from schemas.decisions import EventKind
from schemas.messages import CanFrames
from schemas.subjects import BY_NAME
from tests.bench.recorder_load import make_script
from tests.support.fakes.recording import RECORDER_PLAN, FakeSource
from tests.support.messages import WALL_NS, FakeSample, info, safety_event, sample_of
from tests.support.rigs.scenarios import acted, front_bumper

TICKS = 200

DRAWN = {"double", "float", "bool", "string", "int64", "uint32"}  # Arrow types that a chart can show


class Logged(msgspec.Struct, frozen=True):
    topic: str
    log_ns: int
    publish_ns: int
    fields: dict[str, Any]


def samples() -> Iterator[ReceivedSample]:
    """Two seconds of a driving robot, an event, and its info."""
    script = make_script()
    sequences: Counter[str] = Counter()
    for tick in range(TICKS):
        for said in script.slots[tick]:
            name = script.subjects[said.subject]
            subject = BY_NAME[name]
            time_ns = WALL_NS + tick * 10_000_000
            message = codec.decode(subject, said.head + _stamp(time_ns, sequences[name]) + said.tail)
            sequences[name] += 1
            bus = "can0" if isinstance(message, CanFrames) else ""
            key = keys.build("fleet", "cruiser-1", subject, bus)
            yield FakeSample(key, subject.encoding, codec.encode(message), received_ns=time_ns + 1000)
    for more in (safety_event(EventKind.LATCH), info()):
        yield sample_of(more)


def _stamp(time_ns: int, sequence: int) -> bytes:
    return b"\xa7time_ns" + msgspec.msgpack.encode(time_ns) + b"\xa8sequence" + msgspec.msgpack.encode(sequence)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("logs")
    source = FakeSource(samples())
    writer = LogWriter(LogDirectory(directory), "test")
    recorder = RecorderLoop(
        Recorder(RECORDER_PLAN), source, writer, SampleInbox(64_000_000), HealthReport("bench", "1", 0)
    )
    recorder.run(lambda: source.is_exhausted)
    return next(path for path in directory.glob("*.mcap") if ".incident" not in path.name)


def by_mcap(path: Path) -> Iterator[Logged]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            fields = {field.name: value for field, value in content.ListFields()}
            yield Logged(channel.topic, message.log_time, message.publish_time, fields)


def test_rerun_reads_what_the_mcap_package_reads(log: Path) -> None:
    """Topics, times and numbers."""
    done = subprocess.run(
        [os.environ["READERS_PYTHON"], Path(__file__).with_name("with_rerun.py"), log],
        capture_output=True,
        text=True,
        check=True,
    )
    seen = [msgspec.json.decode(line, type=Logged) for line in done.stdout.splitlines()]
    expected = list(by_mcap(log))
    assert Counter(one.topic for one in seen) == Counter(one.topic for one in expected)
    assert len({one.topic for one in seen}) > 15
    assert len({one.publish_ns for one in expected if one.topic.endswith("/rx")}) > TICKS // 2, (
        "frames have their times"
    )
    order = [sorted(messages, key=_place) for messages in (seen, expected)]
    for one, wanted in zip(*order, strict=True):
        assert (one.topic, one.log_ns, one.publish_ns) == (wanted.topic, wanted.log_ns, wanted.publish_ns)
        for name, value in wanted.fields.items():
            if isinstance(value, float | str) or (
                isinstance(value, int) and not isinstance(one.fields[name], dict)
            ):
                assert one.fields[name] == value, (one.topic, name)


def _place(one: Logged) -> tuple[Any, ...]:
    return one.topic, one.log_ns, one.publish_ns, one.fields.get("sequence", 0), one.fields.get("identifier", 0)


def test_rerun_draws_what_the_blueprint_names(log: Path, tmp_path: Path) -> None:
    """Each field that it draws is a number or a text in the log."""
    blueprint = tmp_path / "layout.rerun.rbl"
    python = Path(os.environ["READERS_PYTHON"]).absolute()
    packages = Path(msgspec.__file__).parents[1]
    project = Path(__file__).parents[2]
    script = Path(__file__).with_name("with_blueprint.py")
    done = subprocess.run(
        [python, script, project, packages, log, blueprint], capture_output=True, text=True, check=True
    )
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(lines) == 21
    assert [(topic, field) for topic, field, drawn in lines if drawn not in DRAWN] == []
    subprocess.run([python.with_name("rerun"), "rrd", "verify", blueprint], check=True, capture_output=True)


FRAMES = """
import json, sys
from rerun.chunk import McapReader
for chunk in McapReader(sys.argv[1]).stream():
    rows = chunk.to_record_batch().to_pylist()
    if chunk.entity_path.endswith("/tf") and "Transform3D:child_frame" in rows[0]:
        names = ("Transform3D:parent_frame", "Transform3D:child_frame")
        print(json.dumps([[row[name][0] for name in names] for row in rows]))
"""


def test_rerun_sees_the_robots_frames_and_warns_of_nothing(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(acted(front_bumper).log(ticks=True))
    python = Path(os.environ["READERS_PYTHON"]).absolute()
    done = subprocess.run([python, "-c", FRAMES, log], capture_output=True, text=True, check=True)
    found = [pair for line in done.stdout.splitlines() for pair in json.loads(line)]
    assert len(found) > 20
    assert all(pair == ["fleet/cruiser-1/odom", "fleet/cruiser-1/base_link"] for pair in found)
    convert = [
        str(python.with_name("rerun")),
        "mcap",
        "convert",
        str(log),
        *("--application-id", "a", "-o", "log.rrd"),
    ]
    done = subprocess.run(convert, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert "WARN" not in done.stdout + done.stderr

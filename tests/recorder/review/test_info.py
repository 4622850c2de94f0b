"""What a log holds, and what it lacks."""

import random
from pathlib import Path

import pytest

from recorder.review.faults import FAULTS_SHOWN
from recorder.review.info import LogInfo, read_info
from schemas.decisions import Journal
from schemas.exit_codes import CommandError
from tests.recorder.fakes import (
    MS,
    SECOND,
    WALL_NS,
    FakeSample,
    Log,
    batch,
    feedback,
    gear,
    info,
    sample_of,
    small_log,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Where a test's log goes."""
    return tmp_path / "log.mcap"


def info_of(path: Path, data: bytes) -> LogInfo:
    """What is read from a file with this content."""
    path.write_bytes(data)
    return read_info(path)


def test_a_whole_log_tells_all_of_itself(path: Path) -> None:
    """Channels, schemas, counts, robots, variant, versions, attachments."""
    found = info_of(path, small_log())
    assert found.whole
    assert (found.faults, found.missed, found.frames_lost) == ([], 0, 0)
    assert found.messages == 12
    assert {channel.topic: (channel.schema, channel.messages) for channel in found.channels} == {
        "fleet/cruiser-1/can/can0/rx": ("cruiser.CanFrame", 5),
        "fleet/cruiser-1/chassis/gear": ("cruiser.Gear", 5),
        "fleet/cruiser-1/gateway/info": ("cruiser.GatewayInfo", 1),
        "fleet/elsewhere": ("cruiser.RawSample", 1),
    }
    assert (found.robots, found.variants) == (["cruiser-1"], {"cruiser-1": "coarse"})
    assert found.versions == {"recorder_version": "0.1.0", "cruiser-1.versions.cruiser-gateway": "0.1.0"}
    assert [one.name for one in found.attachments] == [
        "cruiser-1/configuration.toml",
        "cruiser-1/cruiser-coarse.dbc",
    ]
    assert found.bytes == len(small_log())


def test_rates_and_times_come_from_the_receipt(path: Path) -> None:
    """The mean rate over the channel's own span."""
    log = Log()
    for number in range(11):
        log.receive(sample_of(gear(number)), wall_ns=WALL_NS + number * 100 * MS)
    found = info_of(path, log.close())
    assert (found.start_ns, found.end_ns, found.duration_s) == (WALL_NS, WALL_NS + SECOND, 1.0)
    assert found.channels[0].rate_hz == pytest.approx(10.0)


def test_losses_are_told_by_key_and_by_frame(path: Path) -> None:
    """Samples by the gaps in sequence, raw frames by their alive counters; neither where it says nothing."""
    log = Log()
    log.receive(*(sample_of(gear(number)) for number in (0, 3, 4)))
    frames = [(WALL_NS + number * 10 * MS, feedback(number)) for number in range(40) if number not in {5, 20, 21}]
    log.receive(
        sample_of(batch(0, frames[:10])), sample_of(batch(1, frames[10:20])), sample_of(batch(3, frames[20:]))
    )
    log.receive(FakeSample("k", "x", b""), FakeSample("k", "x", b""))
    found = info_of(path, log.close())
    assert {channel.topic: channel.missed for channel in found.channels} == {
        "fleet/cruiser-1/can/can0/rx": 1,
        "fleet/cruiser-1/chassis/gear": 2,
        "k": None,
    }
    assert found.missed == 3
    frame = found.frames[0]
    assert (frame.identifier, frame.name) == ("0x18C4D1EF", "Auto_GearFeedBack")
    assert (frame.frames, frame.lost, found.frames_lost) == (37, 3, 3)


def test_what_was_asked_for_later_is_not_missed(path: Path) -> None:
    """It stands behind what came by itself; its time tells its place."""
    log = Log()
    said = [
        sample_of(Journal(WALL_NS + number * MS, number, run=7, first=number, count=0, inputs=b"\x90"))
        for number in range(7)
    ]
    replies = [FakeSample(one.key, one.encoding, one.payload, is_reply=True) for one in said]
    log.receive(said[3], *replies[:3], said[4], said[6])
    [channel] = info_of(path, log.close()).channels
    assert (channel.messages, channel.missed) == (6, 1)


def test_the_last_metadata_holds(path: Path) -> None:
    """A variant that became known later is the one that is told."""
    log = Log()
    log.receive(sample_of(gear(0)))
    log.carry_out(log.session.tick(0))
    log.receive(sample_of(info()))
    assert info_of(path, log.close()).variants == {"cruiser-1": "coarse"}


def test_any_cut_leaves_what_was_before_it(path: Path) -> None:
    """At every byte: partial, never a traceback; before the magic is whole it is no MCAP file."""
    data = small_log()
    for size in range(1, len(data)):
        if size < 8:
            with pytest.raises(CommandError, match="no MCAP file"):
                info_of(path, data[:size])
        else:
            found = info_of(path, data[:size])
            assert not found.whole
            assert found.faults


def test_any_noise_is_read_as_far_as_it_goes(path: Path) -> None:
    """Random damage, many times over: never whole, never a traceback."""
    data = small_log()
    generator = random.Random(1)  # noqa: S311 - nothing here is secret
    for _ in range(500):
        damaged = bytearray(data)
        for _ in range(generator.randint(1, 8)):
            damaged[generator.randrange(8, len(data))] ^= generator.randint(1, 255)
        if damaged != data:
            assert not info_of(path, bytes(damaged)).whole


def test_many_faults_are_counted_and_the_first_are_told(path: Path) -> None:
    """Output does not grow with the damage."""
    log = Log()
    for number in range(2 * FAULTS_SHOWN):
        log.receive(sample_of(gear(number)))
        log.tick(number * SECOND)
    data = log.close()
    place = data.index(b"zstd")
    damaged = data
    while place >= 0 and place < len(data):
        damaged = damaged[: place + 30] + bytes([damaged[place + 30] ^ 255]) + damaged[place + 31 :]
        place = data.find(b"zstd", place + 100)
    found = info_of(path, damaged)
    assert len(found.faults) == FAULTS_SHOWN
    assert found.fault_count > FAULTS_SHOWN


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "is empty"), (b"hello, this is no log", "is no MCAP file"), (None, "No such file")],
)
def test_what_is_no_log_is_one_clear_error(path: Path, content: bytes | None, message: str) -> None:
    """A missing, an empty and a foreign file."""
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CommandError, match=message):
        read_info(path)


def test_a_directory_is_one_clear_error(tmp_path: Path) -> None:
    """Not a traceback."""
    with pytest.raises(CommandError, match="Is a directory"):
        read_info(tmp_path)

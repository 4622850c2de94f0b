"""The logs of what was missing."""

from io import BytesIO
from pathlib import Path

import pytest
from mcap.reader import make_reader

from recorder.backfill.backfilling import BACKFILLED_FROM
from recorder.backfill.excerpt import LoggedBytes
from recorder.cli.review.info import describe
from recorder.disk.backfill_file import BACKFILL_NAME, BackfillFile, BackfillFiles
from recorder.disk.leftovers import RecoveryOutcome, recover
from recorder.encoding.protobuf_schema import descriptor_set
from recorder.mcap.recovery import survey
from recorder.review.info import read_info
from schemas.exit_codes import CommandError
from schemas.messages import Gear
from tests.support.backfill_logs import GEAR, RX, START_NS, Row, channel_of, gear_rows, row, rows_in

ABOUT = {"recorders": "robot"}
NAME = "cruiser-1-20270115T080000Z.backfill.mcap"


def message(one: Row, schema_data: bytes | None = None) -> LoggedBytes:
    """A message of a piece."""
    channel = channel_of(one.topic, 77, schema_data)
    return LoggedBytes(channel, one.sequence, one.log_ns, one.publish_ns, one.data)


def written(directory: Path, rows: list[Row]) -> BackfillFiles:
    """A backfill under way."""
    files = BackfillFiles("test")
    for one in rows:
        files.write(directory, "cruiser-1", message(one), "robot")
    return files


ROWS = [row(number, number * 10, topic, bytes(500)) for number in range(600) for topic in (GEAR, RX)]


def test_a_log_can_be_read_alone(tmp_path: Path) -> None:
    """By the mcap package with all checksums; times and sequences are those of the recorder that answered."""
    (path,) = written(tmp_path, ROWS).finish(ABOUT)
    data = path.read_bytes()
    assert rows_in(data) == ROWS
    assert survey(BytesIO(data), len(data)).is_whole
    (metadata,) = make_reader(BytesIO(data), validate_crcs=True).iter_metadata()
    assert (metadata.name, metadata.metadata) == (BACKFILL_NAME, ABOUT)
    assert path == tmp_path / NAME
    assert list(tmp_path.iterdir()) == [path]


def test_nothing_is_no_file(tmp_path: Path) -> None:
    """Where nothing was missing."""
    assert written(tmp_path, []).finish(ABOUT) == []
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_ever_overwritten(tmp_path: Path) -> None:
    """The second backfill of one time has a number."""
    names = [path.name for _ in range(2) for path in written(tmp_path, gear_rows(1)).finish(ABOUT)]
    assert names == [NAME, NAME.replace("Z.backfill.mcap", "Z.backfill-2.mcap")]


def test_a_part_holds_what_was_written_so_far(tmp_path: Path) -> None:
    """It can be read, and nobody takes it for a leftover."""
    files = written(tmp_path, ROWS)
    (part,) = files.parts()
    assert part == tmp_path / f"{NAME}.part"
    data = part.read_bytes()
    found = survey(BytesIO(data), len(data))
    assert found.messages == len(ROWS)
    assert recover(part, "test").outcome is RecoveryOutcome.BUSY
    files.close()


def test_a_backfill_that_is_broken_off_leaves_what_it_had(tmp_path: Path) -> None:
    """As a part, which the next recorder in that directory makes whole."""
    files = written(tmp_path, ROWS)
    (part,) = files.parts()
    files.close()
    assert recover(part, "test").outcome is RecoveryOutcome.RECOVERED
    assert rows_in((tmp_path / NAME).read_bytes()) == ROWS


def test_each_robot_has_its_log_and_each_version_of_a_schema(tmp_path: Path) -> None:
    """For a file has one schema of a name."""
    files = BackfillFiles("test")
    other = descriptor_set(Gear) + b"\xfa\x01\x00"
    one, two = gear_rows(2)
    files.write(tmp_path, "cruiser-1", message(one), "robot")
    files.write(tmp_path, "cruiser-1", message(two, other), "robot")
    files.write(tmp_path, "cruiser-2", message(two), "robot")
    paths = files.finish(ABOUT)
    assert [path.name.partition("-2027")[0] for path in paths] == ["cruiser-1", "cruiser-1", "cruiser-2"]
    assert [rows_in(path.read_bytes()) for path in paths] == [[one], [two], [two]]


def test_each_message_is_marked_with_the_recorder_that_sent_it(tmp_path: Path) -> None:
    """By its channel, also where two recorders sent messages of one topic; ``review info`` names them."""
    files = BackfillFiles("test")
    one, two, three = gear_rows(3)
    files.write(tmp_path, "cruiser-1", message(one), "robot")
    files.write(tmp_path, "cruiser-1", message(two), "stranger")
    files.write(tmp_path, "cruiser-1", message(three), "robot")
    (path,) = files.finish(ABOUT)
    marked = {
        found.sequence: channel.metadata[BACKFILLED_FROM]
        for _, channel, found in make_reader(BytesIO(path.read_bytes())).iter_messages()
    }
    assert marked == {one.sequence: "robot", two.sequence: "stranger", three.sequence: "robot"}
    info = read_info(path)
    assert [(one.topic, one.backfilled_from) for one in info.channels] == [(GEAR, "robot"), (GEAR, "stranger")]
    assert "  backfilled from recorder robot, stranger" in describe(info)


def test_the_latest_time_is_a_name_too(tmp_path: Path) -> None:
    """MCAP's times end in the year 2554."""
    file = BackfillFile(tmp_path, "x", 2**64 - 1, "test")
    assert file.path.name == "x-25540721T233433Z.backfill.mcap"
    file.close()


def test_a_directory_that_takes_nothing_is_an_error_in_one_line(tmp_path: Path) -> None:
    """With the path."""
    with pytest.raises(CommandError, match=r"cannot write .*none.*No such file"):
        BackfillFile(tmp_path / "none", "x", START_NS, "test")

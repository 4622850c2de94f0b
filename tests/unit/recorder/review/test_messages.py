"""``from recorder import read_log``: logs for programs."""

from pathlib import Path

import pyarrow as pa
import pytest

import recorder
from recorder import read_log
from recorder.reading.logs import Faults
from schemas.command_line import CommandError
from schemas.messages import Gear
from tests.support.logs import GEAR_TOPIC, saved, small_log


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return saved(tmp_path / "a.mcap", small_log())


def test_messages_are_typed_and_in_order(log: Path) -> None:
    """Each iteration reads the directory's logs again."""
    messages = read_log(log.parent, topics=["chassis/*"])
    found = list(messages)
    assert found == list(messages)
    assert {one.topic for one in found} == {GEAR_TOPIC}
    assert all(isinstance(one.message, Gear) for one in found)
    times = [one.log_time_ns for one in found]
    assert times == sorted(times)
    assert len(list(read_log(log))) > len(found)
    assert repr(messages).startswith("<LogMessages topics=['chassis/*'], files=1, from ")


def test_tables_hold_the_same(log: Path) -> None:
    """One for each topic, in the order of log times, although two files overlap."""
    saved(log.parent / "b.mcap", small_log())
    messages = read_log(log.parent)
    tables = messages.to_arrow()
    gears = [one for one in messages if one.topic == GEAR_TOPIC]
    table = tables[GEAR_TOPIC]
    assert table["log_time"].cast(pa.int64()).to_pylist() == [one.log_time_ns for one in gears]
    assert sorted(table["sequence"].to_pylist()) == sorted(one.sequence for one in gears)
    assert table["gear_position"].to_pylist() == [one.message.gear_position.value for one in gears]
    assert set(tables) == {one.topic for one in messages}


@pytest.mark.parametrize(
    ("topic", "says"),
    [
        ("chassis/gaer", "no topic of these logs is 'chassis/gaer'; the nearest is 'chassis/gear'"),
        ("no*such", "no topic of these logs is 'no*such'"),
        # The gateway's own, of which this log just has no message.
        ("safety/event", ""),
    ],
)
def test_a_topic_that_is_a_typo_raises(log: Path, topic: str, says: str) -> None:
    if not says:
        assert not list(read_log(log, topics=[topic]))
        return
    with pytest.raises(CommandError) as raised:
        read_log(log, topics=[topic])
    assert str(raised.value) == says


def test_faults_are_collected_or_logged(log: Path, caplog: pytest.LogCaptureFixture) -> None:
    log.write_bytes(log.read_bytes()[:-300])
    faults = Faults()
    list(read_log(log, faults=faults))
    assert faults
    assert not caplog.records
    list(read_log(log))
    assert [record.getMessage() for record in caplog.records] == faults.told


def test_a_path_without_logs_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="no log"):
        read_log(tmp_path)
    with pytest.raises(AttributeError, match="no attribute 'read_logs'"):
        recorder.read_logs  # noqa: B018

"""``from recorder import read_log``."""

from pathlib import Path

import pytest

import recorder
from recorder import read_log
from recorder.reading.logs import Faults
from schemas.command_line import CommandError
from schemas.messages import Gear
from tests.support.logs import small_log


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A small log."""
    path = tmp_path / "a.mcap"
    path.write_bytes(small_log())
    return path


def test_messages_are_typed_and_in_order(log: Path) -> None:
    """Of a topic as it is called behind the robot; a directory is all of its logs."""
    found = list(read_log(log.parent, topics=["chassis/*"]))
    assert found
    assert {one.topic for one in found} == {"fleet/cruiser-1/chassis/gear"}
    assert all(isinstance(one.message, Gear) for one in found)
    times = [one.log_time_ns for one in found]
    assert times == sorted(times)
    assert len(list(read_log(log))) > len(found)


def test_a_time_bounds_what_is_read(log: Path) -> None:
    """From the first to before the last."""
    times = sorted(one.log_time_ns for one in read_log(log))
    some = list(read_log(str(log), from_ns=times[0], to_ns=times[-1]))
    assert len(some) == sum(time < times[-1] for time in times)


def test_what_cannot_be_read_is_said(log: Path, caplog: pytest.LogCaptureFixture) -> None:
    """To whom gathers it, or in the program's log."""
    log.write_bytes(log.read_bytes()[:-300])
    faults = Faults()
    list(read_log(log, faults=faults))
    assert faults
    assert not caplog.records
    list(read_log(log))
    assert [record.getMessage() for record in caplog.records] == faults.told


def test_where_there_is_no_log_that_is_an_error(tmp_path: Path) -> None:
    """As for the commands; and a mistaken name is one as of any module."""
    with pytest.raises(CommandError, match="no log"):
        list(read_log(tmp_path))
    with pytest.raises(AttributeError, match="no attribute 'read_logs'"):
        recorder.read_logs  # noqa: B018

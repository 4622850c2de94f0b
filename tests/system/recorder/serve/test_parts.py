"""Parts of a log, as real commands make them."""

import asyncio
import zipfile
from pathlib import Path

import pytest

from recorder.reading.log_file import LogFile
from recorder.reading.logs import look_at
from recorder.reading.read_log import read_log
from recorder.serve.parts import FORMS, LOG, make_part
from tests.support.rigs.scenarios import front_bumper, recorded

SECOND = 1_000_000_000


@pytest.fixture
def log(tmp_path: Path) -> LogFile:
    """A log of a few seconds."""
    path = tmp_path / "a.mcap"
    path.write_bytes(recorded(front_bumper))
    return look_at(path)


@pytest.mark.parametrize("form", FORMS)
def test_a_part_has_its_time_and_no_other(tmp_path: Path, log: LogFile, form: str) -> None:
    """As a log, as tables and as raw frames; nothing stays beside it."""
    from_ns = log.start_ns + SECOND
    place = tmp_path / "part"
    assert asyncio.run(make_part(log.path, from_ns, from_ns + SECOND, form, place)) == ""
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.mcap", "part"]
    if form == LOG:
        place = place.rename(tmp_path / "part.mcap")
        times = [one.log_time_ns for one in read_log(str(place))]
        # The times that are asked for are whole milliseconds.
        assert from_ns - SECOND // 1000 <= min(times) <= max(times) < from_ns + SECOND
    else:
        with zipfile.ZipFile(place) as packed:
            assert packed.testzip() is None
            assert packed.namelist()


@pytest.mark.parametrize("form", [LOG, "csv"])
def test_of_a_time_without_anything_there_is_no_part(tmp_path: Path, log: LogFile, form: str) -> None:
    """And a line that says so."""
    fault = asyncio.run(make_part(log.path, log.end_ns + SECOND, log.end_ns + 2 * SECOND, form, tmp_path / "part"))
    assert "hold nothing of that time" in fault
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.mcap"]

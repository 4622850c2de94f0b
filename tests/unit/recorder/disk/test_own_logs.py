"""Logs on this machine."""

from pathlib import Path

from recorder.disk.own_logs import OwnLogs
from recorder.mcap.channel import LogChannel
from recorder.mcap.reader import LoggedMessage
from tests.support.backfill_logs import GEAR, gear_rows, log_of, write


def sequences(logs: OwnLogs) -> list[int]:
    """All that the logs hold."""
    found: list[int] = []

    def take(channels: dict[int, LogChannel], messages: object) -> None:
        rows: list[LoggedMessage] = list(messages)  # type: ignore[call-overload] # an iterable
        found.extend(one.sequence for one in rows if channels[one.channel_id].topic == GEAR)

    logs.each(take)
    return sorted(found)


def test_a_directory_is_all_its_logs(tmp_path: Path) -> None:
    """Whole ones, parts and what a backfill wrote; a log that is named besides counts once."""
    one = write(tmp_path / "a.mcap", log_of(gear_rows(5)))
    write(tmp_path / "b.backfill.mcap", log_of(gear_rows(5, first=5)))
    write(tmp_path / "c.mcap.part", log_of(gear_rows(5, first=10), is_finished=False))
    write(tmp_path / "d.txt", b"")
    logs = OwnLogs([one, tmp_path])
    assert sequences(logs) == list(range(15))
    assert logs.faults == []


def test_what_cannot_be_read_is_told(tmp_path: Path) -> None:
    """A log that is not there, one that is deleted meanwhile, one that is damaged."""
    data = bytearray(log_of(gear_rows(30)))
    data[data.index(b"zstd") + 30] ^= 1
    damaged = write(tmp_path / "damaged.mcap", bytes(data))
    gone = write(tmp_path / "gone.mcap", log_of(gear_rows(5)))
    logs = OwnLogs([damaged, gone, tmp_path / "none.mcap"])
    gone.unlink()
    assert sequences(logs) == list(range(10, 30))
    assert logs.paths == [damaged]
    assert logs.faults == [
        f"{tmp_path / 'none.mcap'}: No such file or directory",
        f"{gone}: No such file or directory",
        f"{damaged}: 1 damaged places were skipped",
    ]


def test_a_robots_log_says_where_its_directory_is(tmp_path: Path) -> None:
    """Or else that of the first log."""
    for name, topic in (("x", "other"), ("y", GEAR)):
        (tmp_path / name).mkdir()
        rows = [type(one)(one.publish_ns, topic, 0, one.log_ns, b"") for one in gear_rows(1)]
        write(tmp_path / name / "a.mcap", log_of(rows))
    logs = OwnLogs([tmp_path / "x", tmp_path / "y"])
    assert logs.directory("fleet/cruiser-1/") == tmp_path / "y"
    assert logs.directory("fleet/cruiser-2/") == tmp_path / "x"

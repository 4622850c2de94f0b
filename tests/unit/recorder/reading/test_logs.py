"""Which files a question is about."""

import os
from pathlib import Path

import pytest

from recorder.reading.logs import Faults, find_logs, look_at
from schemas.command_line import CommandError
from tests.support.logs import foreign_log, gears, own_log, saved


def log(start_ns: int, count: int = 10) -> bytes:
    """A log of so many messages, 10 ns apart."""
    return own_log([gears(0, count, start_ns)])


def names(paths: list[Path], faults: Faults | None = None, *, with_covered: bool = False) -> list[str]:
    """The names of what is found."""
    return [one.path.name for one in find_logs(paths, faults or Faults(), with_covered=with_covered)]


def test_files_come_by_their_beginning(tmp_path: Path) -> None:
    """Whatever their names, and however they were given; each once."""
    paths = [
        saved(tmp_path / f"{name}.mcap", log(time_ns)) for name, time_ns in (("a", 300), ("b", 100), ("c", 200))
    ]
    assert names([*paths, paths[0]]) == ["b.mcap", "c.mcap", "a.mcap"]


def test_of_a_directory_logs_and_parts_are_taken(tmp_path: Path) -> None:
    """And nothing else that is there."""
    saved(tmp_path / "r-1.mcap", log(100))
    saved(tmp_path / "r-2.mcap.part", log(200)[:-30])
    saved(tmp_path / "r-3.mcap.damaged", log(300))
    saved(tmp_path / "notes.txt", b"hello")
    # macOS puts such a file beside each one that it copies onto a stick of another file system.
    saved(tmp_path / "._r-1.mcap", b"\0\5\x16\7")
    assert names([tmp_path]) == ["r-1.mcap", "r-2.mcap.part"]


@pytest.mark.parametrize(
    ("data", "span"),
    [
        (log(100), (100, 190)),
        (log(100)[:-300], (100, 190)),
        (own_log([]), (0, 0)),
        (foreign_log(range(5, 10)), (5, 9)),
        (foreign_log(range(5, 10))[:-30], (5, 9)),
        (foreign_log(range(5, 10), use_chunking=False)[:-30], (5, 9)),
        (foreign_log(range(5, 10), use_statistics=False), (5, 9)),
    ],
)
def test_the_time_of_a_file_is_told_in_any_state(tmp_path: Path, data: bytes, span: tuple[int, int]) -> None:
    """By its end, or by its chunks."""
    found = look_at(saved(tmp_path / "x.mcap", data))
    assert (found.start_ns, found.end_ns) == span
    assert found.bytes == len(data)


def test_an_incident_that_logs_cover_is_left_out(tmp_path: Path) -> None:
    """All of it is in them; named by itself, or asked for, it is taken."""
    saved(tmp_path / "r-1.mcap", log(100))
    incident = saved(tmp_path / "r-2.incident.mcap", log(120, 5))
    assert names([tmp_path]) == ["r-1.mcap"]
    assert names([tmp_path, incident]) == ["r-1.mcap", "r-2.incident.mcap"]
    assert names([tmp_path], with_covered=True) == ["r-1.mcap", "r-2.incident.mcap"]


@pytest.mark.parametrize(
    "others",
    [
        {"r-1.mcap": (200, 10)},
        {"r-1.mcap": (100, 3)},
        {"r-1.mcap": (100, 3), "r-3.mcap": (150, 10)},
        {"r-1.incident.mcap": (100, 3)},
    ],
)
def test_an_incident_that_is_not_covered_is_taken(tmp_path: Path, others: dict[str, tuple[int, int]]) -> None:
    """Logs that begin later, end sooner, or have a break."""
    saved(tmp_path / "r-2.incident.mcap", log(110, 7))
    for name, given in others.items():
        saved(tmp_path / name, log(*given))
    assert "r-2.incident.mcap" in names([tmp_path])


def test_an_incident_of_a_log_that_is_damaged_is_taken(tmp_path: Path) -> None:
    """It holds what cannot be read there any more; and so where the recorder lost something of it."""
    saved(tmp_path / "r-2.incident.mcap", log(120, 5))
    path = saved(tmp_path / "r-1.mcap", log(100))
    assert names([tmp_path]) == ["r-1.mcap"]
    data = bytearray(log(100))
    place = data.index(b"zstd") + 40
    data[place] ^= 0x55
    saved(path, bytes(data))
    assert names([tmp_path]) == ["r-1.mcap", "r-2.incident.mcap"]
    saved(path, own_log([gears(0, 3, 100), gears(4, 6, 140)]))
    assert names([tmp_path]) == ["r-1.mcap", "r-2.incident.mcap"]


@pytest.mark.parametrize("data", [foreign_log(range(5, 10)), foreign_log(range(5, 10), use_chunking=False)])
def test_other_peoples_logs_cover_too(tmp_path: Path, data: bytes) -> None:
    """With message indexes or without, and whatever they are called."""
    saved(tmp_path / "all.mcap", data)
    saved(tmp_path / "r-2.incident.mcap", foreign_log(range(6, 9)))
    assert names([tmp_path]) == ["all.mcap"]
    saved(tmp_path / "r-2.incident.mcap", foreign_log(range(6, 11)))
    assert names([tmp_path]) == ["all.mcap", "r-2.incident.mcap"]


def test_logs_that_follow_each_other_cover_together(tmp_path: Path) -> None:
    """An incident may reach from one into the next."""
    saved(tmp_path / "r-2.incident.mcap", log(110, 12))
    saved(tmp_path / "r-1.mcap", log(100, 6))
    saved(tmp_path / "r-3.mcap", log(150, 10))
    assert names([tmp_path]) == ["r-1.mcap", "r-3.mcap"]


def test_the_logs_of_two_robots_are_all_taken(tmp_path: Path) -> None:
    """By their beginnings."""
    for name, start_ns in (("r-1", 100), ("q-1", 150), ("r-2", 200)):
        saved(tmp_path / f"{name}.mcap", log(start_ns))
    assert names([tmp_path]) == ["r-1.mcap", "q-1.mcap", "r-2.mcap"]


def test_one_of_several_that_is_none_is_told(tmp_path: Path) -> None:
    """The others are found."""
    faults = Faults()
    good = saved(tmp_path / "a.mcap", log(1))
    found = find_logs([good, tmp_path / "none.mcap", saved(tmp_path / "b.mcap", b"hello, hello")], faults)
    assert [one.path for one in found] == [good]
    assert ["No such file" in faults.told[0], "is no MCAP file" in faults.told[1]] == [True, True]


@pytest.mark.parametrize("is_directory", [False, True])
def test_a_fifo_is_no_log(tmp_path: Path, *, is_directory: bool) -> None:
    """It is not opened, which would wait for a writer; the logs beside it are found."""
    fifo = tmp_path / "x.mcap"
    os.mkfifo(fifo)
    faults = Faults()
    good = saved(tmp_path / "a.mcap", log(1))
    found = find_logs([tmp_path] if is_directory else [good, fifo], faults)
    assert [one.path for one in found] == [good]
    assert faults.told == [f"{fifo} is no regular file"]


def test_nothing_to_read_is_an_error(tmp_path: Path) -> None:
    """One clear line."""
    with pytest.raises(CommandError, match="there is no log in"):
        find_logs([tmp_path], Faults())
    with pytest.raises(CommandError, match="is empty"):
        find_logs([saved(tmp_path / "x.mcap", b"")], Faults())

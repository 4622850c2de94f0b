"""Which files a question is about."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.logs import FAULTS_SHOWN, Faults, find_logs, look_at
from tests.support.logs import flipped, foreign_log, gears, own_log, saved


def log(start_ns: int, count: int = 10) -> bytes:
    return own_log([gears(0, count, start_ns)])


def names(paths: list[Path], faults: Faults | None = None, *, with_covered: bool = False) -> list[str]:
    return [one.path.name for one in find_logs(paths, faults or Faults(), with_covered=with_covered)]


def test_files_come_by_their_beginning(tmp_path: Path) -> None:
    paths = [
        saved(tmp_path / f"{name}.mcap", log(time_ns)) for name, time_ns in (("a", 300), ("b", 100), ("c", 200))
    ]
    assert names([*paths, paths[0]]) == ["b.mcap", "c.mcap", "a.mcap"]


def foreign(first: int, last: int, *, use_chunking: bool = True) -> bytes:
    """A log of another maker, a message a nanosecond."""
    return foreign_log(range(first, last), use_chunking=use_chunking)


# macOS puts such a file beside each one that it copies onto a stick of another file system.
RESOURCE_FORK = b"\0\5\x16\7"
HOLE = own_log([gears(0, 3, 100), gears(4, 6, 140)])
DIRECTORIES: list[tuple[str, dict[str, bytes], str]] = [
    ("logs and parts", {"a": log(100), "b.mcap.part": log(200)[:-30]}, "a b.mcap.part"),
    ("nothing else", {"a": log(100), "b.mcap.damaged": log(300), "c.txt": b"x", "._a": RESOURCE_FORK}, "a"),
    ("by their beginnings", {"r-1": log(100), "q-1": log(150), "r-2": log(200)}, "r-1 q-1 r-2"),
    ("an incident that a log covers", {"a": log(100), "b.incident": log(120, 5)}, "a"),
    ("that two logs cover", {"a": log(100, 6), "b.incident": log(110, 12), "c": log(150)}, "a c"),
    ("the log begins later", {"a": log(200), "b.incident": log(110, 7)}, "b.incident a"),
    ("the log lacks the first message", {"a": log(110, 9), "b.incident": log(100, 5)}, "b.incident a"),
    ("the log ends sooner", {"a": log(100, 3), "b.incident": log(110, 7)}, "a b.incident"),
    ("a break", {"a": log(100, 3), "b.incident": log(110, 7), "c": log(150)}, "a b.incident c"),
    ("another incident", {"a.incident": log(100, 3), "b.incident": log(110, 7)}, "a.incident b.incident"),
    ("a damaged log", {"a": flipped(log(100)), "b.incident": log(120, 5)}, "a b.incident"),
    ("what the recorder lost", {"a": HOLE, "b.incident": log(120, 5)}, "a b.incident"),
    ("others' logs cover too", {"all": foreign(5, 10), "b.incident": foreign(6, 9)}, "all"),
    ("without chunks", {"all": foreign(5, 10, use_chunking=False), "b.incident": foreign(6, 9)}, "all"),
    ("or do not", {"all": foreign(5, 10), "b.incident": foreign(6, 11)}, "all b.incident"),
    ("or neither", {"all": foreign(5, 10, use_chunking=False), "b.incident": foreign(6, 11)}, "all b.incident"),
]


@pytest.mark.parametrize(("files", "found"), [row[1:] for row in DIRECTORIES], ids=[row[0] for row in DIRECTORIES])
def test_what_is_taken_of_a_directory(tmp_path: Path, files: dict[str, bytes], found: str) -> None:
    """Logs and parts; an incident only where nothing covers all of it, or what would cannot be read."""
    for name, data in files.items():
        saved(tmp_path / (name if ".mcap" in name or name.endswith(".txt") else f"{name}.mcap"), data)
    assert [name.removesuffix(".mcap") for name in names([tmp_path])] == found.split()


def test_an_incident_that_is_named_or_asked_for_is_taken(tmp_path: Path) -> None:
    saved(tmp_path / "r-1.mcap", log(100))
    incident = saved(tmp_path / "r-2.incident.mcap", log(120, 5))
    assert names([tmp_path]) == ["r-1.mcap"]
    assert names([tmp_path, incident]) == ["r-1.mcap", "r-2.incident.mcap"]
    assert names([tmp_path], with_covered=True) == ["r-1.mcap", "r-2.incident.mcap"]


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
    found = look_at(saved(tmp_path / "x.mcap", data))
    assert (found.start_ns, found.end_ns) == span
    assert found.bytes == len(data)


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


@given(st.lists(st.text()))
def test_all_faults_are_counted_and_the_first_are_told(details: list[str]) -> None:
    faults = Faults()
    for detail in details:
        faults.add(detail)
    assert faults.count == len(dict.fromkeys(details))
    assert faults.told == list(dict.fromkeys(details))[:FAULTS_SHOWN]
    assert bool(faults) == bool(details)

"""Local copies of logs in object stores."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import pytest

from recorder.disk.log_names import lock_own
from recorder.objects import cache as caches
from recorder.objects.address import StoreAddress
from recorder.objects.cache import LogCache, cache_directory
from schemas.command_line import CommandError, ExitCode
from tests.support.fakes.objects import FakeObjects

PLACE = StoreAddress("s3://logs/plant-1")
DATA = os.urandom(2500)


@pytest.fixture(autouse=True)
def _pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caches, "PIECE_BYTES", 1000)


@pytest.fixture
def store() -> FakeObjects:
    objects = FakeObjects()
    manifest = {"format": "cruiser.upload/1", "bytes": len(DATA), "sha256": hashlib.sha256(DATA).hexdigest()}
    objects.objects = {"r/a.mcap": DATA, "r/a.mcap.json": json.dumps(manifest).encode(), "r/a.mcap.sig": b"signed"}
    return objects


def fetched(store: FakeObjects, directory: Path, name: str = "r/a.mcap", limit: int = 10_000) -> Path:
    return LogCache(directory, limit).fetch(store, PLACE, name, lambda _: None)


def ranges_of(store: FakeObjects, name: str = "r/a.mcap") -> list[int]:
    return [start for one, start, _ in store.ranges if one == name]


def test_a_log_is_fetched_once_with_its_signature(tmp_path: Path, store: FakeObjects) -> None:
    told: list[int] = []
    path = LogCache(tmp_path, 10_000).fetch(store, PLACE, "r/a.mcap", told.append)
    assert path.read_bytes() == DATA
    assert path.name == "a.mcap"
    assert path.with_name("a.mcap.sig").read_bytes() == b"signed"
    assert sum(told) == len(DATA)
    assert ranges_of(store) == [0, 1000, 2000]
    assert fetched(store, tmp_path) == path
    assert ranges_of(store) == [0, 1000, 2000]


def test_what_was_broken_off_goes_on(tmp_path: Path, store: FakeObjects) -> None:
    store.breaks_after = 2
    with pytest.raises(CommandError, match=r"s3://logs/plant-1/r/a\.mcap: connection reset") as raised:
        fetched(store, tmp_path)
    assert raised.value.code is ExitCode.UNREACHABLE
    store.breaks_after = None
    store.ranges.clear()
    assert fetched(store, tmp_path).read_bytes() == DATA
    assert ranges_of(store) == [2000]


@pytest.mark.parametrize("where", ["store", "disk"])
def test_what_is_not_what_was_uploaded_is_no_copy(tmp_path: Path, store: FakeObjects, where: str) -> None:
    if where == "store":
        store.objects["r/a.mcap"] = bytes(len(DATA))
    else:
        store.breaks_after = 2
        with pytest.raises(CommandError):
            fetched(store, tmp_path)
        store.breaks_after = None
        (part,) = tmp_path.rglob("*.fetched")
        part.write_bytes(bytes(2000))
    with pytest.raises(CommandError, match="it differs from the upload"):
        fetched(store, tmp_path)
    assert not list(tmp_path.rglob("a.mcap"))
    store.objects["r/a.mcap"] = DATA
    assert fetched(store, tmp_path).read_bytes() == DATA


def test_another_content_is_another_copy(tmp_path: Path, store: FakeObjects) -> None:
    first = fetched(store, tmp_path)
    store.objects = {"r/a.mcap": DATA[::-1]}
    assert fetched(store, tmp_path).read_bytes() == DATA[::-1]
    assert first.read_bytes() == DATA


def test_what_was_not_asked_for_longest_goes_first(tmp_path: Path, store: FakeObjects) -> None:
    for name in ("b.mcap", "c.mcap", "d.mcap"):
        store.objects[name] = os.urandom(2500)
    paths = {name: fetched(store, tmp_path, name) for name in ("b.mcap", "c.mcap")}
    os.utime(paths["b.mcap"].parent, (1, 1))
    os.utime(paths["c.mcap"].parent, (2, 2))
    fetched(store, tmp_path, "b.mcap")
    fetched(store, tmp_path, "d.mcap", limit=5500)
    assert [path.exists() for path in paths.values()] == [True, False]
    small = LogCache(tmp_path, 1)
    kept = [small.fetch(store, PLACE, name, lambda _: None) for name in ("c.mcap", "r/a.mcap")]
    assert all(path.exists() for path in kept)
    assert sorted(path.name for path in tmp_path.rglob("*.mcap")) == ["a.mcap", "c.mcap"]


def test_a_copy_that_another_process_fetches_is_waited_for(tmp_path: Path, store: FakeObjects) -> None:
    store.breaks_after = 1
    with pytest.raises(CommandError):
        fetched(store, tmp_path)
    store.breaks_after = None
    (part,) = tmp_path.rglob("*.fetched")
    store.ranges.clear()
    told: list[int] = []
    with part.open("r+b") as other:
        assert lock_own(other.fileno())

        def end_the_other(count: int) -> None:
            told.append(count)
            if count == 0:
                part.with_name("a.mcap").write_bytes(DATA)
                other.close()

        path = LogCache(tmp_path, 10_000).fetch(store, PLACE, "r/a.mcap", end_the_other)
    assert path.read_bytes() == DATA
    assert (told, ranges_of(store)) == ([0, len(DATA)], [])


def test_copies_are_where_the_user_keeps_such_things() -> None:
    """XDG_CACHE_HOME counts if it is absolute, as its specification says."""
    assert cache_directory({"XDG_CACHE_HOME": "/x"}, Path("/home/u")) == Path("/x/cruiser/logs")
    for environment in ({}, {"XDG_CACHE_HOME": "x"}):
        assert cache_directory(environment, Path("/home/u")) == Path("/home/u/.cache/cruiser/logs")


def test_a_disk_that_takes_no_copy_is_said_in_a_line(tmp_path: Path, store: FakeObjects) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CommandError, match=r"cannot store a copy of s3://.*Not a directory"):
        fetched(store, tmp_path / "file")

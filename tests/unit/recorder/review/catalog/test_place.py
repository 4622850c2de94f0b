"""The catalog of a place in an object store: rows beside logs, and invalid rows."""

from pathlib import Path

import pytest

from recorder.objects.address import ListedObject, StoreAddress
from recorder.objects.cache import LogCache
from recorder.reading.logs import Faults
from recorder.review.catalog import directory as places
from recorder.review.catalog.directory import PlaceCatalog
from recorder.review.catalog.find import SEARCHES
from recorder.review.catalog.log_row import write_row
from recorder.upload.finished import ROW_SUFFIX
from schemas.command_line import CommandError, ExitCode
from tests.support.drives import drive_messages, write_messages
from tests.support.fakes.objects import FakeObjects
from tests.support.logs import foreign_log

PLACE = StoreAddress("s3://logs/plant-1")
NAME = "cruiser-1/a.mcap"
OTHER = "cruiser-1/b.mcap"
COLUMNS = SEARCHES["logs"].columns


@pytest.fixture
def store(tmp_path: Path) -> FakeObjects:
    objects = FakeObjects()
    for name, count in ((NAME, 60), (OTHER, 30)):
        path = write_messages(tmp_path / Path(name).name, drive_messages(count))
        objects.objects[name] = path.read_bytes()
        objects.objects[name + ROW_SUFFIX] = write_row(path, path.name, 5)
        objects.objects[f"{name}.json"] = b"{}"
    return objects


def files(catalog: PlaceCatalog) -> dict[str, int]:
    return dict(zip(*(catalog.table.column(name).to_pylist() for name in ("file", "messages")), strict=True))


@pytest.fixture(autouse=True)
def cache(tmp_path: Path) -> LogCache:
    CACHES[:] = [LogCache(tmp_path / "cache", 10**9)]
    return CACHES[0]


CACHES: list[LogCache] = []


def brought_up(store: FakeObjects) -> tuple[PlaceCatalog, Faults]:
    faults = Faults()
    catalog = PlaceCatalog(store, PLACE, COLUMNS, CACHES[0])
    catalog.refresh(faults)
    return catalog, faults


def logs_read(store: FakeObjects) -> set[str]:
    return {name for name, _, _ in store.ranges if name.endswith(".mcap")}


def test_rows_tell_of_a_place_and_no_log_is_read(store: FakeObjects) -> None:
    catalog, faults = brought_up(store)
    assert files(catalog) == {NAME: 124, OTHER: 64}
    assert (logs_read(store), faults.told, catalog.notes) == (set(), [], [])


@pytest.mark.parametrize("trouble", ["lost", "damaged", "of another log", "huge", "older than its log"])
def test_a_row_that_does_not_hold_is_made_again_from_its_log(
    store: FakeObjects, monkeypatch: pytest.MonkeyPatch, trouble: str
) -> None:
    row = NAME + ROW_SUFFIX
    match trouble:
        case "lost":
            del store.objects[row]
        case "damaged":
            store.objects[row] = store.objects[row][:-20]
        case "of another log":
            store.objects[row] = store.objects[OTHER + ROW_SUFFIX]
        case "huge":
            monkeypatch.setattr(places, "ROW_MAX", len(store.objects[row]) - 1)
            monkeypatch.setitem(store.objects, OTHER + ROW_SUFFIX, store.objects[OTHER + ROW_SUFFIX])
        case _:
            store.objects[NAME] += b"more"
    catalog, _ = brought_up(store)
    assert files(catalog) == {NAME: 124, OTHER: 64}
    assert NAME in logs_read(store)
    assert catalog.notes[0].endswith("they were read")
    store.ranges.clear()
    again, _ = brought_up(store)
    assert files(again) == files(catalog)
    assert logs_read(store) == set()


def test_logs_of_other_makers_and_what_is_no_log_are_told_apart(store: FakeObjects) -> None:
    store.objects |= {"theirs.mcap": foreign_log(), "none.mcap": b"no log", "empty.mcap": b""}
    store.old_names = [
        *(ListedObject(name, len(data)) for name, data in store.objects.items()),
        ListedObject("gone.mcap", 5),
        ListedObject(f"gone.mcap{ROW_SUFFIX}", 5),
    ]
    catalog, faults = brought_up(store)
    assert files(catalog) == {NAME: 124, OTHER: 64, "theirs.mcap": 10}
    assert sorted(faults.told) == [
        "cannot read s3://logs/plant-1/gone.mcap: there is no such object",
        "s3://logs/plant-1/empty.mcap is empty",
        "s3://logs/plant-1/none.mcap is no MCAP file",
    ]


@pytest.mark.parametrize("step", ["list", "rows", "log"])
def test_a_store_that_goes_away_ends_the_search_in_a_line(store: FakeObjects, step: str) -> None:
    match step:
        case "list":
            store.is_gone = True
        case "rows":
            store.breaks_after = 0
        case _:
            del store.objects[NAME + ROW_SUFFIX]
            store.breaks_after = 1
    with pytest.raises(CommandError, match=r"cannot read s3://.*: (no answer|connection reset)") as raised:
        brought_up(store)
    assert raised.value.code is ExitCode.UNREACHABLE


def test_a_server_that_lists_nothing_cannot_be_searched(store: FakeObjects) -> None:
    with pytest.raises(CommandError, match="has no list of its logs"):
        PlaceCatalog(store, StoreAddress("https://logs.example.com/plant-1"), COLUMNS, CACHES[0])

"""An object is read like a file, by few ranges."""

import io
import random
from typing import BinaryIO

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recorder.objects import ranged
from recorder.objects.interface import StoreError
from recorder.objects.ranged import BLOCK_BYTES, FETCH_MAX, RangedObject, RangeError
from tests.support.fakes.objects import FakeObjects, mark_of

DATA = random.Random(1).randbytes(9 * BLOCK_BYTES + 7)  # noqa: S311 - reproducible, not secret


def stored(data: bytes = DATA) -> tuple[FakeObjects, RangedObject]:
    """A store with an object, and the object."""
    store = FakeObjects(log=data)
    return store, RangedObject(store, "log", len(data), mark_of(data))


def places() -> st.SearchStrategy[int]:
    """Places in it, some of them beyond its end, many at the borders of blocks."""
    return st.one_of(
        st.integers(0, len(DATA) + 100),
        st.builds(lambda block, off: max(0, block * BLOCK_BYTES + off), st.integers(0, 10), st.integers(-2, 2)),
    )


@given(st.lists(st.tuples(st.sampled_from(["seek", "end", "read", "fetch"]), places()), max_size=30))
@settings(deadline=None)
def test_whatever_is_sought_and_read_is_that_of_a_file(steps: list[tuple[str, int]]) -> None:
    """Also beyond its end; and no byte is fetched twice."""
    store, one = stored()
    file: BinaryIO = io.BytesIO(DATA)
    with one.open() as stream:
        for step, place in steps:
            match step:
                case "seek":
                    assert stream.seek(place) == file.seek(place)
                case "end":
                    back = min(place, len(DATA))
                    assert stream.seek(-back, io.SEEK_END) == file.seek(-back, io.SEEK_END)
                case "read":
                    assert stream.read(place) == file.read(place)
                case _:
                    one.fetch(place, place + BLOCK_BYTES)
            assert stream.tell() == file.tell()
    assert store.fetched <= len(DATA)


def test_what_is_read_from_one_end_to_the_other_takes_ever_longer_ranges() -> None:
    """As a scan does."""
    store, one = stored()
    with one.open() as stream:
        while stream.read(1000):
            pass
    assert store.fetched == len(DATA)
    assert len(store.ranges) <= 5


def test_a_place_that_will_be_read_is_fetched_at_once() -> None:
    """And then no more."""
    store, one = stored()
    one.fetch(BLOCK_BYTES + 5, 4 * BLOCK_BYTES)
    with one.open() as stream:
        stream.seek(BLOCK_BYTES + 5)
        assert stream.read(2 * BLOCK_BYTES) == DATA[BLOCK_BYTES + 5 : 3 * BLOCK_BYTES + 5]
    assert store.ranges == [("log", BLOCK_BYTES, 4 * BLOCK_BYTES)]


def test_memory_is_bounded_and_so_is_a_request(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was used longest ago is asked for again."""
    monkeypatch.setattr(ranged, "CACHE_BYTES", 4 * BLOCK_BYTES)
    monkeypatch.setattr(ranged, "FETCH_MAX", 2 * BLOCK_BYTES)
    store, one = stored()
    with one.open() as stream:
        assert stream.read() == DATA
        stream.seek(0)
        assert stream.read(5) == DATA[:5]
    assert max(end - start for _, start, end in store.ranges) <= 2 * BLOCK_BYTES
    assert store.ranges.count(("log", 0, BLOCK_BYTES)) >= 1
    assert FETCH_MAX > 2 * BLOCK_BYTES


@pytest.mark.parametrize("trouble", ["gone", "refused", "broken", "changed", "removed"])
def test_what_a_store_refuses_is_an_error_in_one_line(trouble: str) -> None:
    """With the cure, where there is one; what was read before is there still."""
    store, one = stored()
    with one.open() as stream:
        assert stream.read(5) == DATA[:5]
        match trouble:
            case "gone":
                store.is_gone = True
            case "refused":
                store.refused.add("log")
            case "broken":
                store.breaks_after = 0
            case "changed":
                store.objects["log"] = bytes(len(DATA))
            case _:
                del store.objects["log"]
        assert stream.read(5) == DATA[5:10]
        stream.seek(5 * BLOCK_BYTES)
        with pytest.raises(RangeError) as raised:
            stream.read(5)
    line = raised.value.strerror
    assert line
    assert "\n" not in line
    assert isinstance(raised.value.__cause__, StoreError)

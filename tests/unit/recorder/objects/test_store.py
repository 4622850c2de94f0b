"""Answers of obstore become bytes, or one line with a cure."""

import re
from pathlib import Path

import obstore
import pytest
from obstore.exceptions import GenericError, PermissionDeniedError, UnauthenticatedError

from recorder.objects import store as stores
from recorder.objects.address import ListedObject, StoreAddress, StoredObject, StoreError, is_address, shown_url
from recorder.objects.store import ObstoreObjects
from schemas.command_line import CommandError

DATA = bytes(range(200))


@pytest.fixture
def place(tmp_path: Path) -> StoreAddress:
    (tmp_path / "cruiser-1").mkdir()
    (tmp_path / "a.mcap").write_bytes(DATA)
    (tmp_path / "cruiser-1/b.mcap").write_bytes(b"b")
    return StoreAddress(f"file://{tmp_path}")


def test_an_object_is_looked_at_listed_and_read_by_ranges(place: StoreAddress) -> None:
    objects = ObstoreObjects(place, {})
    found = objects.look("a.mcap")
    assert isinstance(found, StoredObject)
    assert found.bytes == len(DATA)
    assert objects.read("a.mcap", 10, 20, found.e_tag) == DATA[10:20]
    assert objects.look("c.mcap") is None
    names = sorted(objects.names(), key=lambda one: one.name)
    assert names == [ListedObject("a.mcap", len(DATA)), ListedObject("cruiser-1/b.mcap", 1)]


def test_an_object_that_was_changed_is_not_read_on(place: StoreAddress) -> None:
    objects = ObstoreObjects(place, {})
    found = objects.look("a.mcap")
    assert found is not None
    path = Path(place.url.removeprefix("file://")) / "a.mcap"
    path.write_bytes(DATA + b"more")
    with pytest.raises(StoreError, match="changed or removed"):
        objects.read("a.mcap", 0, 10, found.e_tag)
    path.unlink()
    with pytest.raises(StoreError, match="changed or removed"):
        objects.read("a.mcap", 0, 10, "")


def test_a_store_that_knows_no_conditions_is_held_to_its_answers(
    place: StoreAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    objects = ObstoreObjects(place, {})
    honest = obstore.get
    monkeypatch.setattr(
        obstore, "get", lambda store, name, options: honest(store, name, options={"range": options["range"]})
    )
    with pytest.raises(StoreError, match="changed or removed"):
        objects.read("a.mcap", 0, 10, "another")
    with pytest.raises(StoreError, match="sent 100 bytes instead of 110"):
        objects.read("a.mcap", 100, 210, "")


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (PermissionDeniedError("no"), "the store refuses it: "),
        (UnauthenticatedError("who?"), "the store refuses it: "),
        (PermissionError(13, "no"), "the store refuses it: "),
        (
            GenericError("error sending request\n\nDebug: insides"),
            "error sending request: check the store's endpoint",
        ),
        (GenericError("Server returned 403 Forbidden"), "403 Forbidden: give credentials"),
        (
            GenericError(
                "Generic S3 error: Error performing PUT http://169.254.169.254/latest/api/token in 2.4s - "
                "HTTP error: error sending request"
            ),
            "error sending request: give credentials",
        ),
        (
            GenericError(
                "Generic HTTP error: Error performing HEAD http://127.0.0.1:40321/credential-401/a in 448.03µs - "
                "HTTP error: error sending request"
            ),
            "error sending request: check the store's endpoint",
        ),
        (GenericError("Unable to open file /logs/403/a.mcap"), r"Unable to open file /logs/403/a\.mcap$"),
        (GenericError("strange"), "strange"),
    ],
)
def test_what_goes_wrong_is_a_line_with_its_cure(
    place: StoreAddress, monkeypatch: pytest.MonkeyPatch, error: Exception, line: str
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise error

    objects = ObstoreObjects(place, {})
    for name in ("head", "get", "list"):
        monkeypatch.setattr(obstore, name, refuse)
    for ask in (lambda: objects.look("a"), lambda: objects.read("a", 0, 1, ""), lambda: list(objects.names())):
        with pytest.raises(StoreError) as raised:
            ask()
        assert re.search(line, str(raised.value))
        assert "\n" not in str(raised.value)


def test_a_place_of_too_many_objects_is_not_listed(place: StoreAddress, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "LISTED_MAX", 1)
    with pytest.raises(StoreError, match="name a place within it"):
        list(ObstoreObjects(place, {}).names())


def test_a_directory_that_is_not_there_is_no_store(tmp_path: Path) -> None:
    with pytest.raises(CommandError, match="no such directory"):
        ObstoreObjects(StoreAddress(f"file://{tmp_path}/none"), {})
    assert not (tmp_path / "none").exists()
    with pytest.raises(CommandError, match="cannot use the store"):
        ObstoreObjects(StoreAddress("s3://logs"), {"colour": "red"})


def test_addresses_are_told_from_paths() -> None:
    assert is_address("s3://logs/a.mcap")
    assert not is_address("logs/s3:/a.mcap")
    assert not is_address("memory:///a")
    one = StoreAddress("s3://logs/plant-1/a.mcap")
    assert (one.parent.url, one.name, one.has_list) == ("s3://logs/plant-1", "a.mcap", True)
    assert one.parent.join("b").url == "s3://logs/plant-1/b"
    assert not StoreAddress("https://example.com/a.mcap").has_list


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("s3://logs/plant-1/a@b.mcap", "s3://logs/plant-1/a@b.mcap"),
        ("s3://key:secret@logs/plant-1", "s3://***@logs/plant-1"),
        ("https://logs.example/a.mcap?X-Amz-Signature=1234", "https://logs.example/a.mcap?***"),
    ],
)
def test_what_may_be_a_secret_in_an_address_is_not_shown(url: str, shown: str) -> None:
    assert shown_url(url) == shown

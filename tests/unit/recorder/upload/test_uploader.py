"""The upload of finished logs to a store with all kinds of faults."""

from __future__ import annotations

import asyncio
import fcntl
import hashlib
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import msgspec
import obstore
import pytest
from obstore.exceptions import GenericError

from recorder.disk.files import NAME, SafeLogReader, UploadNote
from recorder.objects.address import StoredObject, StoreError
from recorder.record.signed_mode import LogSigner
from recorder.upload import finished, uploader
from recorder.upload.finished import (
    NAMESAKES_MAX,
    PART_BYTES,
    READ_BYTES,
    ROW_SUFFIX,
    RowError,
    UploadManifest,
    UploadState,
    digest,
)
from recorder.upload.uploader import AWAY_AFTER, CHECKSUM, READ_BACK, LogStore, Uploader, UploadPlan, UploadTotals
from schemas.authority.key_files import Identity
from schemas.authority.proof import GrantRole
from schemas.command_line import CommandError, ExitCode
from schemas.peers import RateLimit
from tests.support.authority import Fleet, Party
from tests.support.logs import gears, own_log, saved


class FakeLogStore(LogStore):
    """A store in memory.

    ``calls`` are methods and objects; ``cuts`` writes fail before their last piece, ``spoils`` writes are stored
    wrong; ``is_old`` hides existing objects; ``meanwhile`` runs before each answer.
    """

    def __init__(self) -> None:
        self.objects: dict[str, bytes] = {}
        self.calls: list[tuple[str, str]] = []
        self.is_gone = False
        self.refused: set[str] = set()
        self.cuts = 0
        self.spoils = 0
        self.is_old = False
        self.meanwhile: Callable[[str, str], Awaitable[None]] | None = None

    async def create(self, name: str, data: bytes) -> bool:
        await self._answer("create", name)
        return self.objects.setdefault(name, data) is data

    async def replace(self, name: str, data: bytes) -> None:
        await self._answer("replace", name)
        self.objects[name] = data

    async def read(self, name: str) -> bytes | None:
        await self._answer("read", name)
        return None if self.is_old else self.objects.get(name)

    async def write(self, name: str, pieces: AsyncIterator[bytes], size: int) -> None:
        await self._answer("write", name)
        data = b"".join([piece async for piece in pieces])
        assert len(data) == size
        if self.cuts:
            self.cuts -= 1
            raise StoreError("connection reset by peer")
        if self.spoils:
            self.spoils -= 1
            data = bytes([data[0] ^ 1]) + data[1:]
        self.objects[name] = data

    async def look(self, name: str) -> StoredObject | None:
        await self._answer("look", name)
        if self.is_old or name not in self.objects:
            return None
        data = self.objects[name]
        return StoredObject(len(data), hashlib.md5(data, usedforsecurity=False).hexdigest())

    async def read_back(self, name: str, size: int) -> AsyncIterator[bytes]:
        await self._answer("read_back", name)
        yield self.objects[name][:size]

    async def _answer(self, method: str, name: str) -> None:
        self.calls.append((method, name))
        if self.meanwhile is not None:
            await self.meanwhile(method, name)
        if self.is_gone or name in self.refused:
            raise StoreError("nobody answers")


LOG = "cruiser-1-20270115T080000Z.mcap"
LATER = "cruiser-1-20270115T090000Z.mcap"
INCIDENT = "cruiser-1-20270115T100000Z.incident.mcap"

ABOUT = {"robots": "cruiser-1", "recorder_version": "0.1.0"}


def log_of(count: int = 3) -> bytes:
    return own_log([gears(0, count, 1000)], metadata=[("cruiser", ABOUT)])


@pytest.fixture
def store() -> FakeLogStore:
    return FakeLogStore()


def uploader_of(
    directory: Path,
    store: LogStore,
    note: UploadNote,
    rows: Rows | None = None,
    pace: RateLimit | None = None,
    *,
    reads_back: bool = True,
    only_incidents: bool = False,
) -> Uploader:
    plan = UploadPlan(directory, "s3://logs", only_incidents, reads_back, "0.1.0")
    return Uploader(plan, store, note, pace or RateLimit(0), rows)


def upload(directory: Path, store: LogStore, rows: Rows | None = None, **plan: bool) -> UploadTotals:
    with UploadNote(directory) as note:
        one = uploader_of(directory, store, note, rows, None, **plan)
        asyncio.run(one.upload_all(lambda: True))
        return one.totals


def manifest(store: FakeLogStore, name: str) -> UploadManifest:
    return msgspec.json.decode(store.objects[f"cruiser-1/{name}.json"], type=UploadManifest)


def safe(directory: Path) -> set[str]:
    return set(SafeLogReader(directory).read())


def test_a_log_is_whole_in_the_store_with_a_manifest_and_a_mark(tmp_path: Path, store: FakeLogStore) -> None:
    data = log_of()
    saved(tmp_path / LOG, data)
    totals = upload(tmp_path, store)
    assert store.objects[f"cruiser-1/{LOG}"] == data
    found = manifest(store, LOG)
    assert found == UploadManifest(
        state=UploadState.VERIFIED,
        object=f"cruiser-1/{LOG}",
        file=LOG,
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        robot="cruiser-1",
        is_incident=False,
        messages=3,
        start_ns=1000,
        end_ns=1020,
        metadata=ABOUT,
        verified=READ_BACK,
        recorder_version="0.1.0",
        uploaded_ns=found.uploaded_ns,
    )
    assert (totals.uploaded, totals.bytes, totals.waiting, totals.faults) == (1, len(data), [], {})
    assert safe(tmp_path) == {LOG}
    store.calls.clear()
    assert upload(tmp_path, store).uploaded == 0
    assert store.calls == [], "what is safe is neither sent again nor asked for"


@pytest.mark.parametrize(
    ("name", "only_incidents", "goes_to"),
    [
        (f"{LOG}.part", False, None),
        (f"{LOG}.damaged", False, None),
        (f"{LOG}.rest", False, None),
        ("holiday.mcap", False, None),
        ("notes.txt", False, None),
        ("catalog.parquet", False, None),
        (LOG, True, None),
        (INCIDENT, True, f"cruiser-1/{INCIDENT}"),
        # Anybody who may write there may call a log as he likes: no name leads out of the store's directory.
        ("..-20270115T080000Z.mcap", False, "_/..-20270115T080000Z.mcap"),
    ],
)
def test_finished_logs_of_a_recorder_go_and_nothing_else(
    tmp_path: Path, store: FakeLogStore, name: str, *, only_incidents: bool, goes_to: str | None
) -> None:
    saved(tmp_path / name, log_of()[:-20])
    totals = upload(tmp_path, store, only_incidents=only_incidents)
    assert (bool(store.calls), totals.faults) == (goes_to is not None, {})
    assert store.objects.keys() == ({goes_to, f"{goes_to}.json"} if goes_to else set())
    if goes_to:
        # It is cut off: evidence all the same. Of its contents the manifest says nothing.
        found = msgspec.json.decode(store.objects[f"{goes_to}.json"], type=UploadManifest)
        assert (found.state, found.messages) == (UploadState.VERIFIED, None)


def test_the_recorders_signature_goes_with_its_log(tmp_path: Path, store: FakeLogStore) -> None:
    fleet, recorder = Fleet(), Party("depot-1")
    fleet.authority.grant(recorder, role=GrantRole.RECORDER)
    signer = LogSigner(Identity(recorder.private, recorder.chain, fleet.trust))
    for number in (1, 2, 3):
        name, data = f"cruiser-1-20270115T08000{number}Z.mcap", log_of(number)
        saved(tmp_path / name, data)
        signature = signer.sign(hashlib.sha256(data).hexdigest(), name)
        if number == 3:
            (tmp_path / f"{name}.sig").symlink_to(saved(tmp_path / "elsewhere", signature))
        else:
            saved(tmp_path / f"{name}.sig", signature if number == 1 else signer.sign("0" * 64, name))
    upload(tmp_path, store)
    assert len(safe(tmp_path)) == 3
    signatures = [name for name in store.objects if name.endswith(".sig")]
    assert signatures == ["cruiser-1/cruiser-1-20270115T080001Z.mcap.sig"]


def test_incidents_come_first_and_then_the_oldest(tmp_path: Path, store: FakeLogStore) -> None:
    saved(tmp_path / LATER, log_of(1))
    saved(tmp_path / LOG, log_of(2))

    async def incident_ends(method: str, name: str) -> None:
        if (method, name) == ("write", f"cruiser-1/{LOG}"):
            saved(tmp_path / INCIDENT, log_of(4))

    store.meanwhile = incident_ends
    upload(tmp_path, store)
    written = [name for method, name in store.calls if method == "write"]
    assert written == [f"cruiser-1/{name}" for name in (LOG, INCIDENT, LATER)]


def test_a_file_that_only_has_the_name_of_a_log_is_named_and_stays(tmp_path: Path, store: FakeLogStore) -> None:
    saved(tmp_path / LOG, b"none of ours")
    secret = saved(tmp_path / "elsewhere" / "secret", log_of())
    (tmp_path / "a-20270115T080000Z.mcap").symlink_to(secret)
    os.mkfifo(tmp_path / "b-20270115T080000Z.mcap")
    (tmp_path / "c-20270115T080000Z.mcap").mkdir()
    saved(tmp_path / LATER, log_of())
    with saved(tmp_path / INCIDENT, log_of()).open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        totals = upload(tmp_path, store)
    assert totals.faults == {
        INCIDENT: "is being written or recovered",
        LOG: "is no MCAP file",
        "a-20270115T080000Z.mcap": "is a link",
        "b-20270115T080000Z.mcap": "is a FIFO",
        "c-20270115T080000Z.mcap": "is a directory",
    }
    assert safe(tmp_path) == {LATER}
    assert upload(tmp_path, store).uploaded == 1, "nobody has the incident in hand any more"


@pytest.mark.parametrize(
    ("knob", "times", "fault"),
    [
        ("cuts", 1, "connection reset by peer"),
        ("spoils", 1, ""),
        ("spoils", uploader.TRIES, "the store's copy differs"),
    ],
)
def test_a_log_that_the_store_loses_or_spoils_is_never_called_safe(
    tmp_path: Path, store: FakeLogStore, knob: str, times: int, fault: str
) -> None:
    for name in (LOG, LATER):
        saved(tmp_path / name, log_of(name == LATER))
    setattr(store, knob, times)
    assert upload(tmp_path, store).faults == ({LOG: fault} if fault else {})
    assert safe(tmp_path) == ({LATER} if fault else {LOG, LATER})
    assert manifest(store, LOG).state is (UploadState.UPLOADING if fault else UploadState.VERIFIED)
    upload(tmp_path, store)
    assert store.objects.keys() == {f"cruiser-1/{name}{end}" for name in (LOG, LATER) for end in ("", ".json")}
    assert store.objects[f"cruiser-1/{LOG}"] == log_of(0)
    assert manifest(store, LOG).state is UploadState.VERIFIED


@pytest.mark.parametrize(
    ("happens", "fault"),
    [(lambda path: path.write_bytes(log_of(7)), "was changed while it was read"), (Path.unlink, "")],
    ids=["it changes", "retention deletes it"],
)
def test_a_log_is_sent_whole_or_does_not_appear(
    tmp_path: Path, store: FakeLogStore, happens: Callable[[Path], object], fault: str
) -> None:
    path = saved(tmp_path / LOG, log_of())

    async def happen(method: str, _name: str) -> None:
        if method == "write":
            happens(path)

    store.meanwhile = happen
    assert upload(tmp_path, store).faults == ({LOG: fault} if fault else {})
    assert store.objects.get(f"cruiser-1/{LOG}") == (None if fault else log_of())


@pytest.mark.parametrize("method", ["look", "read_back", "replace"])
def test_what_was_broken_off_behind_the_log_is_verified_and_not_sent_again(
    tmp_path: Path, store: FakeLogStore, method: str
) -> None:
    saved(tmp_path / LOG, log_of())

    async def break_off(asked: str, _name: str) -> None:
        store.is_gone = asked == method

    store.meanwhile = break_off
    assert upload(tmp_path, store).uploaded == 0
    store.meanwhile, store.is_gone = None, False
    store.calls.clear()
    assert upload(tmp_path, store).uploaded == 1
    assert "write" not in {asked for asked, _ in store.calls}
    assert manifest(store, LOG).state is UploadState.VERIFIED


def test_where_the_stores_checksum_is_that_of_the_log_it_is_enough(tmp_path: Path, store: FakeLogStore) -> None:
    saved(tmp_path / LOG, log_of())
    store.spoils = 1
    upload(tmp_path, store, reads_back=False)
    assert manifest(store, LOG).verified == CHECKSUM
    # Of the spoiled one the checksum was another, which may also mean another kind of checksum: it was read.
    assert [asked for asked, _ in store.calls].count("read_back") == 1


def test_a_store_that_answers_as_of_a_while_ago_takes_no_log_twice_and_loses_none(
    tmp_path: Path, store: FakeLogStore
) -> None:
    """It refuses a new manifest, and shows none: the log waits."""
    saved(tmp_path / LOG, log_of())
    store.is_old = True
    assert upload(tmp_path, store).uploaded == 0
    totals = upload(tmp_path, store)
    assert totals.faults == {LOG: f"the manifest of cruiser-1/{LOG} cannot be read yet"}
    store.is_old = False
    assert upload(tmp_path, store).uploaded == 1
    assert set(store.objects) == {f"cruiser-1/{LOG}", f"cruiser-1/{LOG}.json"}


def test_no_manifest_makes_a_log_safe_that_the_store_does_not_hold(tmp_path: Path, store: FakeLogStore) -> None:
    data = log_of()
    saved(tmp_path / "first" / LOG, data)
    saved(tmp_path / "second" / LOG, data)
    upload(tmp_path / "first", store)
    assert manifest(store, LOG).state is UploadState.VERIFIED
    store.objects[f"cruiser-1/{LOG}"] = bytes(len(data))
    assert upload(tmp_path / "second", store).uploaded == 1
    assert store.objects[f"cruiser-1/{LOG}"] == data


def test_a_store_that_answers_with_very_much_fills_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploader, "SMALL_MAX_BYTES", 1000)
    logs = LogStore(f"file://{tmp_path}/store", {})
    for size in (1000, 1001):
        asyncio.run(logs.replace(f"r/{size}.json", bytes(size)))
    assert asyncio.run(logs.read("r/1000.json")) == bytes(1000)
    with pytest.raises(StoreError, match="larger than 1000"):
        asyncio.run(logs.read("r/1001.json"))


def test_a_disk_without_hard_links_is_a_store_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def put(store: object, name: str, data: bytes, **how: object) -> object:
        if how.get("mode") == "create":
            raise GenericError("Unable to rename file: Operation not permitted")
        return await whole(store, name, data, **how)  # type: ignore[arg-type]  # all are as they were given

    whole = obstore.put_async
    monkeypatch.setattr(obstore, "put_async", put)
    logs = LogStore(f"file://{tmp_path}/store", {})
    assert asyncio.run(logs.create("r/1.json", b"first"))
    assert not asyncio.run(logs.create("r/1.json", b"second"))
    assert asyncio.run(logs.read("r/1.json")) == b"first"


def test_another_log_of_the_same_name_is_never_overwritten(tmp_path: Path, store: FakeLogStore) -> None:
    saved(tmp_path / "robot" / LOG, log_of(1))
    saved(tmp_path / "depot" / LOG, log_of(2))
    for count, directory in enumerate(("robot", "depot", "robot"), start=1):
        assert upload(tmp_path / directory, store).uploaded == 1
        saved(tmp_path / "robot" / LOG, log_of(3))
        name = LOG.replace(".mcap", f"-{count}.mcap") if count > 1 else LOG
        assert store.objects[f"cruiser-1/{name}"] == log_of(count)
        assert (manifest(store, name).file, manifest(store, name).object) == (LOG, f"cruiser-1/{name}")


def test_there_are_not_endless_logs_of_one_name(tmp_path: Path, store: FakeLogStore) -> None:
    stem = LOG.removesuffix(".mcap")
    for number in range(1, NAMESAKES_MAX + 1):
        store.objects[f"cruiser-1/{stem}{f'-{number}' * (number > 1)}.mcap.json"] = b"[]"
    saved(tmp_path / LOG, log_of())
    assert upload(tmp_path, store).faults == {LOG: "the store has too many other logs of that name"}


def test_two_machines_that_upload_the_same_log_at_once_make_one_of_it(tmp_path: Path, store: FakeLogStore) -> None:
    data = log_of()
    for name in ("a", "b"):
        saved(tmp_path / name / LOG, data)

    async def let_the_other(_method: str, _name: str) -> None:
        await asyncio.sleep(0)

    async def both() -> None:
        store.meanwhile = let_the_other
        with UploadNote(tmp_path / "a") as one, UploadNote(tmp_path / "b") as other:
            uploaders = (uploader_of(tmp_path / name, store, note) for name, note in (("a", one), ("b", other)))
            await asyncio.gather(*(each.upload_all(lambda: True) for each in uploaders))

    asyncio.run(both())
    assert set(store.objects) == {f"cruiser-1/{LOG}", f"cruiser-1/{LOG}.json"}
    assert store.objects[f"cruiser-1/{LOG}"] == data
    assert safe(tmp_path / "a") == safe(tmp_path / "b") == {LOG}


def test_sending_and_reading_back_keep_to_the_rate(tmp_path: Path, store: FakeLogStore) -> None:
    counted: list[float] = []

    class CountedPace(RateLimit):
        def delay_s(self, count: float, now_s: float) -> float:
            counted.append(count)
            return super().delay_s(count, now_s)

    data = log_of()
    saved(tmp_path / LOG, data)
    with UploadNote(tmp_path) as note:
        asyncio.run(uploader_of(tmp_path, store, note, pace=CountedPace(0)).upload_all(lambda: True))
    assert safe(tmp_path) == {LOG}
    assert sum(counted) == 2 * len(data)


def test_a_second_upload_from_one_directory_is_refused(tmp_path: Path) -> None:
    with UploadNote(tmp_path), pytest.raises(CommandError, match="another upload") as refused:
        UploadNote(tmp_path)
    assert refused.value.code is ExitCode.REFUSED


def test_a_store_that_is_gone_is_not_asked_for_each_log(tmp_path: Path, store: FakeLogStore) -> None:
    names = [f"cruiser-1-20270115T08000{second}Z.mcap" for second in range(5)]
    for number, name in enumerate(names):
        saved(tmp_path / name, log_of(number + 1))
    store.is_gone = True
    assert len(upload(tmp_path, store).faults) == len(store.calls) == AWAY_AFTER
    store.is_gone = False
    store.refused = {f"cruiser-1/{names[0]}"}
    assert list(upload(tmp_path, store).faults) == names[:1]
    assert safe(tmp_path) == set(names[1:])


@pytest.fixture
def _quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(finished, "DISK_BYTES_PER_S", 0)


@pytest.mark.usefixtures("_quick_disk")
@pytest.mark.parametrize("place", ["memory:///", "file://{}/a%20store/of%20logs"])
@pytest.mark.parametrize("count", [3, 300_000], ids=["in one piece", "in parts"])
def test_any_store_of_the_library_holds_the_log(tmp_path: Path, place: str, count: int) -> None:
    data = (
        log_of(3) if count == 3 else own_log([gears(0, 3, 0)], attachments=[("ballast", os.urandom(11_000_000))])
    )
    saved(tmp_path / "logs" / LOG, data)
    store = LogStore(place.format(tmp_path), {})
    assert upload(tmp_path / "logs", store).uploaded == 1

    async def look() -> bytes:
        assert not await store.create(f"cruiser-1/{LOG}.json", b"")
        assert await store.look("nothing") is None
        assert await store.read("nothing") is None
        return b"".join([piece async for piece in store.read_back(f"cruiser-1/{LOG}", len(data))])

    assert asyncio.run(look()) == data
    (tmp_path / "logs" / NAME).unlink()
    assert upload(tmp_path / "logs", store).uploaded == 1


class Rows:
    """Makes rows, or fails."""

    def __init__(self, fault: Exception | None = None) -> None:
        self.made: list[str] = []
        self.fault = fault
        self.meanwhile: Callable[[], None] = lambda: None

    async def __call__(self, path: Path) -> bytes:
        self.made.append(path.name)
        self.meanwhile()
        if self.fault is not None:
            raise self.fault
        return b"row of " + path.name.encode()


def test_a_row_of_the_catalog_lies_beside_each_log_when_all_are_safe(tmp_path: Path, store: FakeLogStore) -> None:
    saved(tmp_path / LOG, log_of(2))
    saved(tmp_path / LATER, log_of(3))
    rows = Rows()
    rows.meanwhile = lambda: pytest.fail("a log still waits") if safe(tmp_path) != {LOG, LATER} else None
    assert upload(tmp_path, store, rows).rows == 2
    assert store.objects[f"cruiser-1/{LOG}{ROW_SUFFIX}"] == b"row of " + LOG.encode()
    assert rows.made == [LOG, LATER]


@pytest.mark.parametrize(
    ("fault", "said"),
    [(RowError("given up after 600 s"), "given up"), (FileNotFoundError(), ""), (None, "nobody answers")],
    ids=["cannot be made", "the log is gone", "the store takes none"],
)
def test_a_log_is_safe_without_its_row(
    tmp_path: Path, store: FakeLogStore, fault: Exception | None, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    saved(tmp_path / LOG, log_of())
    store.refused.add(f"cruiser-1/{LOG}{ROW_SUFFIX}")
    totals = upload(tmp_path, store, Rows(fault))
    assert (totals.uploaded, totals.rows, totals.faults) == (1, 0, {})
    assert safe(tmp_path) == {LOG}
    told = [record.getMessage() for record in caplog.records if "has no row" in record.getMessage()]
    assert [said in one for one in told] == [True] * bool(said)


def test_rows_do_not_wait_one_by_one_for_a_store_that_is_gone(tmp_path: Path, store: FakeLogStore) -> None:
    for number in range(AWAY_AFTER + 2):
        saved(tmp_path / f"cruiser-1-20270115T08000{number}Z.mcap", log_of(number + 1))
    rows = Rows()
    rows.meanwhile = lambda: setattr(store, "is_gone", True)
    assert upload(tmp_path, store, rows).uploaded == AWAY_AFTER + 2
    assert len(rows.made) == AWAY_AFTER


@pytest.mark.usefixtures("_quick_disk")
@pytest.mark.parametrize("size", [1, READ_BYTES + 1, PART_BYTES, PART_BYTES + 1, 2 * PART_BYTES])
def test_the_checksums_are_those_of_the_stores(tmp_path: Path, size: int) -> None:
    """S3 hashes the checksums of the parts, and adds their number."""
    data = os.urandom(size)
    parts = [hashlib.md5(data[at : at + PART_BYTES]).digest() for at in range(0, size, PART_BYTES)]  # noqa: S324
    with saved(tmp_path / "log", data).open("rb") as stream:
        found = asyncio.run(digest(stream))
    assert (found.bytes, found.sha256) == (size, hashlib.sha256(data).hexdigest())
    by_parts = f"{hashlib.md5(b''.join(parts)).hexdigest()}-{len(parts)}"  # noqa: S324
    assert found.e_tags == {hashlib.md5(data).hexdigest(), by_parts}  # noqa: S324

"""``cruiser review`` with addresses in object stores."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from recorder.cli import stored
from recorder.objects import cache
from recorder.objects.address import ListedObject, Objects, StoreAddress, StoreError
from schemas.command_line import CommandError, ExitCode
from schemas.settings import UploadSettings
from tests.support.commands import review
from tests.support.fakes.objects import FakeObjects
from tests.support.logs import foreign_log, saved
from tests.support.rigs import scenarios
from tests.support.rigs.scenarios import recorded

NAME = "cruiser-1/cruiser-1-20270115T080000Z.mcap"


@pytest.fixture(autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))


@pytest.fixture
def log() -> bytes:
    return recorded(scenarios.stale_commands)


@pytest.fixture
def bucket(monkeypatch: pytest.MonkeyPatch, log: bytes) -> FakeObjects:
    objects = FakeObjects()
    objects.objects = {NAME: log, f"{NAME}.json": b"{}"}

    def open_objects(_place: StoreAddress, _upload: UploadSettings) -> Objects:
        return objects

    monkeypatch.setattr(stored, "open_objects", open_objects)
    return objects


@pytest.mark.parametrize("question", ["events", "why", "info", "check", "verify", "rerun"])
def test_the_answer_of_a_store_is_that_of_the_file(
    tmp_path: Path, log: bytes, capsys: pytest.CaptureFixture[str], question: str
) -> None:
    path = saved(tmp_path / NAME, log)
    said = []
    for place in (path, f"file://{path}", f"file://{tmp_path}"):
        assert review(question, place, "--json") == (ExitCode.PARTIAL if question == "verify" else ExitCode.OK)
        said.append(capsys.readouterr().out.replace(f"file://{path}", str(path)))
    assert said[0] == said[1]
    assert question == "info" or said[1] == said[2]
    assert json.loads(said[2].splitlines()[0])["messages" if question in {"info", "check"} else "robot"]


def test_logs_here_and_there_are_asked_together(
    tmp_path: Path, log: bytes, bucket: FakeObjects, capsys: pytest.CaptureFixture[str]
) -> None:
    path = saved(tmp_path / "a.mcap", log)
    assert review("events", path, "--json") == ExitCode.OK
    here = capsys.readouterr().out
    assert review("events", path, "s3://logs/plant-1", "--json") == ExitCode.OK
    assert capsys.readouterr().out == here
    assert bucket.fetched
    bucket.fetched = 0
    assert review("events", "s3://logs/plant-1", "--json") == ExitCode.OK
    assert not bucket.fetched


def empty(objects: FakeObjects) -> None:
    objects.objects.clear()


def gone(objects: FakeObjects) -> None:
    objects.is_gone = True


@pytest.mark.parametrize(
    ("state", "place", "line", "code"),
    [
        (None, "https://logs.example.com/plant-1", "has no list: name one", ExitCode.USAGE),
        (None, "s3://logs/none.mcap", r"s3://logs/none\.mcap: there is no such object", ExitCode.FAILURE),
        (empty, "s3://logs", "there is no log in s3://logs", ExitCode.FAILURE),
        (gone, "s3://logs/plant-1", "no answer", ExitCode.UNREACHABLE),
        (gone, f"s3://logs/{NAME}", "no answer", ExitCode.UNREACHABLE),
    ],
)
def test_what_is_not_there_is_said_in_a_line(
    bucket: FakeObjects, state: Callable[[FakeObjects], None] | None, place: str, line: str, code: ExitCode
) -> None:
    if state:
        state(bucket)
    with pytest.raises(CommandError, match=line) as raised:
        review("events", place)
    assert raised.value.code is code


def test_one_log_that_cannot_be_read_is_named_and_the_others_are_read(
    bucket: FakeObjects, capsys: pytest.CaptureFixture[str]
) -> None:
    bucket.objects |= {"b.mcap": b"", "c.mcap": b"no log" * 20, "d.mcap": foreign_log()}
    bucket.old_names = [*[ListedObject(name, 1) for name in bucket.objects], ListedObject("gone.mcap", 5)]
    assert review("events", "s3://logs", "--kind", "stop", "--json") == ExitCode.PARTIAL
    told = capsys.readouterr()
    assert len(told.out.splitlines()) == 1
    assert told.err.splitlines() == [
        "cruiser review: s3://logs/b.mcap is empty",
        "cruiser review: s3://logs/c.mcap is no MCAP file",
        "cruiser review: cannot read s3://logs/gone.mcap: there is no such object",
    ]


@pytest.mark.parametrize("trouble", ["broken", "changed"])
def test_a_store_that_fails_in_the_middle_is_said_in_a_line(
    bucket: FakeObjects, capsys: pytest.CaptureFixture[str], trouble: str
) -> None:
    honest = bucket.read

    def read(name: str, start: int, end: int, e_tag: str) -> bytes:
        if start and trouble == "changed":
            bucket.objects[name] = bytes(len(bucket.objects[name]))
        if start and trouble == "broken":
            raise StoreError("connection reset by peer")
        return honest(name, start, end, e_tag)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cache, "PIECE_BYTES", 10_000)
        patch.setattr(bucket, "read", read)
        with pytest.raises(CommandError, match=r"connection reset|try again") as raised:
            review("events", "s3://logs", "--json")
    assert raised.value.code is ExitCode.UNREACHABLE
    bucket.ranges.clear()
    if trouble == "broken":
        assert review("events", "s3://logs", "--json") == ExitCode.OK
        assert capsys.readouterr().out
        assert [start for name, start, _ in bucket.ranges if name == NAME] == [10_000]


def test_options_are_those_of_a_store_of_the_same_kind() -> None:
    options: dict[str, str | int | float | bool] = {"endpoint": "http://127.0.0.1:9", "allow_http": True}
    upload = UploadSettings(store="s3://logs", options=options)
    assert stored.options_of(StoreAddress("s3://other"), upload) == options
    assert stored.options_of(StoreAddress("gs://other"), upload) == {"allow_http": True}
    assert stored.options_of(StoreAddress("gs://other"), UploadSettings(options=options)) == options

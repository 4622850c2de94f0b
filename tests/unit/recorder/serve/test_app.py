"""The HTTP interface: who gets what, who may write, and what viewers of other sites see."""

import asyncio
import io
import json
import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from starlette.applications import Starlette

from recorder.review.catalog.known import CATALOG_NAME
from recorder.review.catalog.table import to_table, write_table
from recorder.serve import app as app_module
from recorder.serve import parts
from recorder.serve.app import ServedLogs, is_log
from recorder.serve.library import Library
from recorder.serve.viewers import viewer
from schemas.web.jobs import WAITING_MAX, JobDone
from schemas.web.log_files import LogFiles
from tests.support.asgi import HOST, ask, asked
from tests.support.catalog import DRIVE, STOP, row
from tests.support.messages import WALL_NS

OWN = {"origin": f"http://{HOST}"}
FOXGLOVE = "https://app.foxglove.dev"
COMMENT = json.dumps({"is": "comment", "who": "ann", "text": "<b>hit"}).encode()


@contextmanager
def serving(directory: Path, *, can_write: bool = False, viewers: tuple[str, ...] = ()) -> Iterator[Starlette]:
    """An application on this directory, which has a log and its catalog."""
    (directory / "a.mcap").write_bytes(b"0123456789")
    write_table(directory / CATALOG_NAME, to_table([row(drives=[DRIVE], moments=[STOP])]))
    with closing(LogFiles(directory, is_log)) as files:
        library = Library(directory, files.scratch)
        served = ServedLogs(
            files, library, [viewer(one) for one in viewers], can_write=can_write, wall_ns=lambda: WALL_NS
        )
        yield served.make_app(["127.0.0.1"])


@pytest.fixture
def app(tmp_path: Path) -> Iterator[Starlette]:
    """One that nobody may write to."""
    with serving(tmp_path) as app:
        yield app


@pytest.mark.parametrize(
    "name",
    [
        "b.mcap",
        ".hidden.mcap",
        CATALOG_NAME,
        "a.notes.jsonl",
        "..",
        "..%2Fsecret.mcap",
        "sub%2Finside.mcap",
        "link.mcap",
        "sub.mcap",
        "a.mcap%00",
        "x" * 5000 + ".mcap",
    ],
)
@pytest.mark.parametrize("kind", ["logs", "reports", "cut", "api/logs", "api/why"])
def test_nothing_but_the_logs_of_the_directory_is_given_out(
    app: Starlette, tmp_path: Path, kind: str, name: str
) -> None:
    """Whatever a name says; nor what a link points to."""
    (tmp_path.parent / "secret.mcap").write_bytes(b"secret")
    (tmp_path / ".hidden.mcap").write_bytes(b"secret")
    (tmp_path / "a.notes.jsonl").write_bytes(b"{}")
    (tmp_path / "sub.mcap").mkdir()
    (tmp_path / "link.mcap").symlink_to(tmp_path.parent / "secret.mcap")
    answer = ask(app, f"/{kind}/{name}?from=2026-01-02&to=2026-01-02T00:01:00Z&at=2026-01-02")
    assert answer.status == 404
    assert b"secret" not in answer.body


def test_every_answer_keeps_other_pages_out(app: Starlette) -> None:
    """Nothing is loaded from elsewhere, nothing is guessed; a request under another name is refused."""
    for path in ("/", "/api/state", "/api/find?words=drive", "/logs/a.mcap", "/words.js", "/serve.css"):
        answer = ask(app, path)
        assert answer.status == 200, path
        assert answer.headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'")
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in answer.headers
        assert ask(app, path, {"host": "evil.example"}).status == 400


def test_lists_are_json_and_mistakes_are_one_plain_line(app: Starlette) -> None:
    """What a mistake repeats of the question is never HTML."""
    found = json.loads(ask(app, "/api/find?words=stop").body)
    assert [one["reason"] for one in found["answers"]] == ["front_bumper"]
    assert json.loads(ask(app, "/api/days").body)[0]["drives"] == 1
    log = json.loads(ask(app, "/api/logs/a.mcap").body)
    assert (log["catalog"]["drives"], log["notes"], log["is_open"]) == (1, [], False)
    mistake = ask(app, "/api/find?words=%3Cscript%3E")
    assert mistake.status == 400
    assert mistake.headers["content-type"].startswith("text/plain")
    assert "is no subject" in mistake.text


def test_notes_are_written_by_the_page_itself_alone(tmp_path: Path) -> None:
    """And only where that is allowed: no other site's form or script can."""
    with serving(tmp_path) as app:
        assert ask(app, "/api/notes/a.mcap", OWN, "POST", COMMENT).status == 403
    with serving(tmp_path, can_write=True, viewers=(FOXGLOVE,)) as app:
        for origin in ({}, {"origin": FOXGLOVE}, {"origin": "null"}, {"origin": f"https://{HOST}"}):
            assert ask(app, "/api/notes/a.mcap", origin, "POST", COMMENT).status == 403
        assert not (tmp_path / "a.notes.jsonl").exists()
        assert ask(app, "/api/notes/b.mcap", OWN, "POST", COMMENT).status == 404
        assert ask(app, "/api/notes/a.mcap", OWN, "POST", b"x" * 100_000).text == "the note is too long"
        assert ask(app, "/api/notes/a.mcap", OWN).status == 404
        said = json.loads(ask(app, "/api/notes/a.mcap", OWN, "POST", COMMENT).body)
        assert [(one["who"], one["text"]) for one in said["notes"]] == [("ann", "<b>hit")]
        assert said["notes"][0]["time"].endswith("Z")
        assert json.loads(ask(app, "/api/logs/a.mcap").body)["notes"] == said["notes"]


def test_a_viewer_reads_a_log_by_ranges_and_nothing_else(tmp_path: Path) -> None:
    """With the headers that Foxglove and Lichtblick look at; pages of other sites see none of it."""
    with serving(tmp_path, viewers=(f"{FOXGLOVE}/~/view",)) as app:
        part = ask(app, "/logs/a.mcap", {"origin": FOXGLOVE, "range": "bytes=2-4"})
        assert (part.status, part.body, part.headers["content-range"]) == (206, b"234", "bytes 2-4/10")
        assert part.headers["access-control-allow-origin"] == FOXGLOVE
        exposed = part.headers["access-control-expose-headers"].lower().split(", ")
        assert {"accept-ranges", "content-range", "content-length", "etag"} <= set(exposed)
        asks = {"access-control-request-method": "GET", "access-control-request-headers": "range"}
        local = {"access-control-request-private-network": "true"}
        allowed = ask(app, "/logs/a.mcap", {"origin": FOXGLOVE, **asks, **local}, "OPTIONS")
        assert allowed.headers["access-control-allow-origin"] == FOXGLOVE
        assert "range" in allowed.headers["access-control-allow-headers"].lower()
        assert allowed.headers["access-control-allow-private-network"] == "true"
        other = {"origin": "https://evil.example"}
        assert ask(app, "/logs/a.mcap", {**other, **asks, **local}, "OPTIONS").status == 400
        assert "access-control-allow-origin" not in ask(app, "/logs/a.mcap", other).headers
        for path in ("/api/find?words=drive", "/api/logs/a.mcap", "/api/state"):
            assert "access-control-allow-origin" not in ask(app, path, {"origin": FOXGLOVE}).headers


def test_a_remote_data_loader_is_told_where_a_log_is(tmp_path: Path) -> None:
    """A manifest with one source, which is read by ranges; its address is relative to the manifest's."""
    with serving(tmp_path, viewers=(FOXGLOVE,)) as app:
        (tmp_path / "a b.mcap").write_bytes(b"x")
        answer = ask(app, "/manifest?log=a%20b.mcap", {"origin": FOXGLOVE})
        assert answer.headers["access-control-allow-origin"] == FOXGLOVE
        said = json.loads(answer.body)
        assert said["name"] == "a b.mcap"
        (source,) = said["sources"]
        assert source == {"url": "/logs/a%20b.mcap", "supportsRangeRequests": True}
        assert ask(app, source["url"]).body == b"x"
        outside = tmp_path.parent / "outside.mcap"
        outside.write_bytes(b"x")
        for name in ("", "..%2Foutside.mcap", str(outside), f"sub%2F..%2F..%2F{outside.name}"):
            assert ask(app, f"/manifest?log={name}").status == 404


@pytest.mark.parametrize(
    "asked_for",
    [
        "",
        "?from=2026-01-02",
        "?from=1&to=2",
        "?from=2026-01-02&to=2026-01-02",
        "?from=2026-01-02&to=2026-01-03",
        "?from=2026-01-02T00:01:00Z&to=2026-01-02",
        "?from=-o&to=--help",
        "?from=2026-01-02&to=2026-01-02T00:01:00Z&as=../x",
    ],
)
def test_a_part_has_an_end_and_is_not_long(app: Starlette, asked_for: str) -> None:
    """What is no time goes to no command."""
    answer = ask(app, f"/cut/a.mcap{asked_for}")
    assert (answer.status, answer.headers["content-type"]) == (400, "text/plain; charset=utf-8")
    assert ask(app, "/api/why/a.mcap?at=--help").status == 400


def test_no_other_site_makes_it_work(app: Starlette) -> None:
    """A picture or a frame of another page would: reports, reasons and parts take a processor."""
    fetched = {"sec-fetch-site": "cross-site", "sec-fetch-dest": "image"}
    period = "from=2026-01-02&to=2026-01-02T00:01:00Z&at=2026-01-02"
    for kind in ("reports", "cut", "api/why", "api/logs"):
        assert ask(app, f"/{kind}/a.mcap?{period}", fetched).status == 404
    for path in ("/api/find?words=drive", "/api/days"):
        assert ask(app, path, fetched).status == 404
        assert ask(app, path, {"sec-fetch-site": "same-origin", "sec-fetch-dest": "empty"}).status == 200


def test_questions_wait_in_a_line_that_is_not_endless(app: Starlette, monkeypatch: pytest.MonkeyPatch) -> None:
    """One is answered at a time; who comes when too many wait is told so at once."""
    running, most = 0, 0
    gate = asyncio.Event()

    async def ask_slowly(*_: object, **__: object) -> JobDone:
        nonlocal running, most
        running += 1
        most = max(most, running)
        await gate.wait()
        running -= 1
        return JobDone(0, b'{"headline": "x", "chain": []}', "")

    monkeypatch.setattr(app_module, "ask_review", ask_slowly)

    async def crowd() -> list[int]:
        asking = [
            asyncio.create_task(asked(app, f"/api/why/a.mcap?at=2026-01-02T00:00:{number:02d}Z"))
            for number in range(WAITING_MAX + 3)
        ]
        for _ in range(100):
            await asyncio.sleep(0)
        gate.set()
        return [answer.status for answer in await asyncio.gather(*asking)]

    statuses = asyncio.run(asyncio.wait_for(crowd(), 60))
    assert most == 1
    assert statuses == [200] * (WAITING_MAX + 1) + [503] * 2


@pytest.mark.parametrize(
    ("done", "status"),
    [
        (JobDone(3, b'{"headline": "x", "chain": []}', "not all could be read"), 200),
        (JobDone(2, b"", "the log holds nothing of cruiser-2"), 500),
        (JobDone(None, b"", "no answer within 120 s"), 500),
        (JobDone(0, b"{", ""), 500),
    ],
)
def test_a_reason_is_given_or_the_line_that_says_why_not(
    app: Starlette, monkeypatch: pytest.MonkeyPatch, done: JobDone, status: int
) -> None:
    """An answer of a damaged log is one; one that failed is not kept."""
    asked_for: list[object] = []

    async def answered(words: list[str], **_: object) -> JobDone:
        asked_for.append(words)
        return done

    monkeypatch.setattr(app_module, "ask_review", answered)
    for _ in range(2):
        answer = ask(app, "/api/why/a.mcap?at=2026-01-02T03:04:05.678Z&robot=--json%0A")
        assert answer.status == status
        assert status == 200 or answer.text == (done.fault or "no answer")
    assert len(asked_for) == (1 if status == 200 else 2)
    # What a browser says is never an option of its own.
    assert "--robot=--json\n" in asked_for[0]  # type: ignore[operator]


@pytest.mark.parametrize("is_cut", [True, False])
def test_a_part_is_given_out_once_and_kept_nowhere(
    app: Starlette, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_cut: bool
) -> None:
    """It has the name of its log and its time; where nothing was cut, that is said."""
    places: list[Path] = []

    async def answered(words: list[str], **_: object) -> JobDone:
        places.append(Path(words[-1]))
        if is_cut:
            places[-1].write_bytes(b"part")
        return JobDone(0 if is_cut else 2, b"", "" if is_cut else "the logs hold nothing of that time")

    monkeypatch.setattr(parts, "ask_review", answered)
    answer = ask(app, "/cut/a.mcap?from=2026-01-02T03:04:05Z&to=2026-01-02T03:04:06Z")
    assert (answer.status, answer.body) == (
        (200, b"part") if is_cut else (500, b"the logs hold nothing of that time")
    )
    assert ("a-030405.mcap" in answer.headers.get("content-disposition", "")) is is_cut
    assert not places[0].exists()
    assert tmp_path not in places[0].parents


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"a.csv": b"1" * 900, "topic=x/b.csv": b"2"}, ""),
        ({}, "nothing of that time"),
        ({"a.csv": b"1" * 1001}, "give a shorter time"),
        (None, "no answer within 120 s"),
    ],
)
def test_tables_of_a_part_are_packed(
    app: Starlette, monkeypatch: pytest.MonkeyPatch, files: dict[str, bytes] | None, said: str
) -> None:
    """To a bound, and nothing is left behind; what was given up is not given out, half as it may be."""
    places: list[Path] = []

    async def answered(words: list[str], **_: object) -> JobDone:
        places.append(Path(words[-1]))
        for name, content in (files or {"half.csv": b"1"}).items() if files != {} else ():
            (places[0] / name).parent.mkdir(parents=True, exist_ok=True)
            (places[0] / name).write_bytes(content)
        places[0].mkdir(exist_ok=True)
        return JobDone(0, b"", "") if files is not None else JobDone(None, b"", said)

    monkeypatch.setattr(parts, "ask_review", answered)
    monkeypatch.setattr(parts, "PART_BYTES", 1000)
    answer = ask(app, "/cut/a.mcap?from=2026-01-02T03:04:05Z&to=2026-01-02T03:04:06Z&as=csv")
    if said:
        assert (answer.status, said in answer.text) == (500, True)
    else:
        assert "a-030405.csv.zip" in answer.headers["content-disposition"]
        with zipfile.ZipFile(io.BytesIO(answer.body)) as packed:
            assert {name: packed.read(name) for name in packed.namelist()} == files
    assert list(places[0].parent.iterdir()) == []

"""The desk's logs over HTTP."""

import asyncio
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from urllib.parse import unquote

import msgspec
import pytest
from starlette.applications import Starlette
from starlette.types import ASGIApp, Message

from gateway.cli import desk_logs
from gateway.cli.desk_logs import QUESTIONS_AT_ONCE, WAITING_MAX, DeskLogs, JobDone, viewer
from gateway.cli.desk_server import make_logs_app
from schemas.command_line import CommandError

HOST = "127.0.0.1:8081"


class Answer(msgspec.Struct, frozen=True):
    """A response; header names in lower case."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def text(self) -> str:
        return self.body.decode()


def ask(
    app: ASGIApp, path: str, headers: Mapping[str, str] | None = None, method: str = "GET", body: bytes = b""
) -> Answer:
    return asyncio.run(asked(app, path, headers, method, body))


async def asked(
    app: ASGIApp, path: str, headers: Mapping[str, str] | None = None, method: str = "GET", body: bytes = b""
) -> Answer:
    said: list[Message] = []
    sent: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def receive() -> Message:
        if sent:
            return sent.pop()
        # The browser does not go away before it has its answer.
        never: asyncio.Future[Message] = asyncio.get_running_loop().create_future()
        return await never

    async def send(message: Message) -> None:
        said.append(message)

    place, _, query = path.partition("?")
    given = {"host": HOST, **(headers or {})}
    scope = {
        "type": "http",
        "http_version": "1.1",
        "method": method,
        "scheme": "http",
        "server": HOST.split(":"),
        "path": unquote(place),
        "raw_path": place.encode(),
        "query_string": query.encode(),
        "headers": [(name.lower().encode(), value.encode()) for name, value in given.items()],
    }
    await app(scope, receive, send)
    kept = {name.decode(): value.decode() for name, value in said[0]["headers"]}
    return Answer(said[0]["status"], kept, b"".join(one.get("body", b"") for one in said[1:]))


LOG = "cruiser-1-20260102T030405Z.mcap"
FOXGLOVE = "https://app.foxglove.dev"


@pytest.fixture
def app(tmp_path: Path) -> Iterator[Starlette]:
    (tmp_path / "a.mcap").write_bytes(b"0123456789")
    with closing(DeskLogs.open(str(tmp_path), [f"{FOXGLOVE}/~/view"])) as logs:
        yield make_logs_app(logs, ["127.0.0.1"])


@pytest.fixture
def answered(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The questions that were asked; ``ANSWERS`` has the answers."""
    questions: list[list[str]] = []

    async def answer(words: list[str], *_: object) -> JobDone:
        questions.append(words)
        return ANSWERS[words[0]]

    monkeypatch.setattr(desk_logs, "ask_review", answer)
    return questions


ANSWERS = {"find": JobDone(0, b'{"file": "a.mcap"}\n', "a note"), "why": JobDone(0, b'{"headline": "x"}', "")}


@pytest.fixture
def unreadable(monkeypatch: pytest.MonkeyPatch) -> set[Path]:
    """Paths that the desk's user may not read: root, who may run this, reads everything."""
    paths: set[Path] = set()
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) not in paths and access(path, mode))
    return paths


def test_a_directory_that_is_none_or_cannot_be_read_is_one_clear_line(
    tmp_path: Path, unreadable: set[Path]
) -> None:
    with pytest.raises(CommandError, match=r"logs is not a directory \(desk\.logs\)$"):
        DeskLogs.open(str(tmp_path / "logs"))
    unreadable.add(tmp_path)
    with pytest.raises(CommandError, match=rf"not read {tmp_path}: add it to the .* \(desk\.logs\)$"):
        DeskLogs.open(str(tmp_path))


def test_a_log_that_cannot_be_read_says_so_in_one_line(tmp_path: Path, unreadable: set[Path]) -> None:
    (tmp_path / LOG).write_bytes(b"log")
    with closing(DeskLogs.open(str(tmp_path))) as logs:
        app = Starlette(routes=logs.routes())
        assert ask(app, f"/logs/{LOG}").body == b"log"
        unreadable.add(tmp_path / LOG)
        for kind in ("logs", "reports"):
            answer = ask(app, f"/{kind}/{LOG}")
            assert (answer.status, answer.text.count("\n")) == (403, 0)
            assert f"may not read {LOG}: add it to the" in answer.text
            assert ask(app, f"/{kind}/{LOG.replace('1', '2')}").status == 404


@pytest.mark.parametrize("is_link", [True, False])
def test_what_becomes_a_link_while_it_is_asked_for_is_not_followed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    is_link: bool,  # noqa: FBT001 - a parameter
) -> None:
    """A compromised recorder could make the desk send its keys, or wait at a FIFO."""
    (tmp_path / "https.key").write_bytes(b"secret")
    log = tmp_path / LOG
    log.write_bytes(b"log")
    find = DeskLogs.path

    def change(logs: DeskLogs, name: str) -> Path | None:
        found = find(logs, name)
        log.unlink()
        if is_link:
            log.symlink_to(tmp_path / "https.key")
        else:
            os.mkfifo(log)
        return found

    with closing(DeskLogs.open(str(tmp_path))) as logs:
        app = Starlette(routes=logs.routes())
        assert ask(app, f"/logs/{LOG}").body == b"log"
        open_before = len(list(Path("/proc/self/fd").iterdir()))
        monkeypatch.setattr(DeskLogs, "path", change)
        answer = ask(app, f"/logs/{LOG}")
        assert (answer.status, answer.text) == (404, "no such log")
        assert len(list(Path("/proc/self/fd").iterdir())) == open_before


@pytest.mark.parametrize(
    "name",
    [
        *("b.mcap", ".hidden.mcap", "catalog.parquet", "..", "..%2Fsecret.mcap", "sub%2Finside.mcap"),
        *("link.mcap", "sub.mcap", "a.mcap%00", "x" * 5000 + ".mcap"),
    ],
)
@pytest.mark.parametrize("kind", ["logs", "reports", "whys"])
def test_nothing_but_the_logs_of_the_directory_is_given_out(
    app: Starlette, tmp_path: Path, kind: str, name: str
) -> None:
    (tmp_path.parent / "secret.mcap").write_bytes(b"secret")
    for hidden in (".hidden.mcap", "catalog.parquet"):
        (tmp_path / hidden).write_bytes(b"secret")
    (tmp_path / "sub.mcap").mkdir()
    (tmp_path / "link.mcap").symlink_to(tmp_path.parent / "secret.mcap")
    answer = ask(app, f"/{kind}/{name}?at=2026-01-02")
    assert answer.status == 404
    assert b"secret" not in answer.body


@pytest.mark.usefixtures("answered")
def test_every_answer_keeps_other_pages_out(app: Starlette) -> None:
    for path in ("/logs.html", "/find?search=stops", "/whys/a.mcap?at=1", "/logs/a.mcap", "/words.js"):
        answer = ask(app, path)
        assert answer.status == 200, path
        assert answer.headers["content-security-policy"].startswith("default-src 'none'; script-src 'self'")
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert "access-control-allow-origin" not in answer.headers
        assert ask(app, path, {"host": "evil.example"}).status == 400


def test_no_other_site_makes_it_work(app: Starlette, answered: list[list[str]]) -> None:
    for path in ("/reports/a.mcap", "/whys/a.mcap?at=1", "/find?search=stops"):
        assert ask(app, path, {"sec-fetch-site": "cross-site", "sec-fetch-dest": "image"}).status == 404
    assert answered == []


def test_what_a_browser_says_is_never_an_option_of_its_own(app: Starlette, answered: list[list[str]]) -> None:
    assert ask(app, "/find?search=--rebuild").status == 400
    assert ask(app, "/find").status == 400
    assert ask(app, f"/find?search=stops&robot=--json&catalog=/x&since={'9' * 999}").status == 200
    assert answered[0][:2] == ["find", "stops"]
    assert answered[0][3:] == ["--json", "--newest=100", "--robot=--json", f"--since={'9' * 300}"]
    assert ask(app, "/whys/a.mcap?at=--last&robot=--json").status == 200
    assert answered[1][2:] == ["--at=--last", "--robot=--json", "--json"]


@pytest.mark.parametrize(
    ("done", "status", "said"),
    [
        (JobDone(0, b"{}\n", "a note"), 200, {"fault": "", "uncataloged": ["b.mcap.part"], "is_failed": False}),
        (JobDone(3, b"{}\n", "1 is damaged"), 200, {"fault": "1 is damaged", "is_failed": False}),
        (JobDone(1, b"", "no pyarrow"), 200, {"uncataloged": ["a.mcap", "b.mcap.part"], "is_failed": True}),
        (JobDone(2, b"", "usage: ...\nno such reason"), 400, "no such reason"),
        (JobDone(None, b"", "no answer within 600 s"), 503, "no answer within 600 s"),
    ],
)
def test_a_search_says_what_goes_with_its_answer(
    app: Starlette, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, done: JobDone, status: int, said: object
) -> None:
    (tmp_path / "b.mcap.part").write_bytes(b"")

    async def answer(*_: object) -> JobDone:
        return done

    monkeypatch.setattr(desk_logs, "ask_review", answer)
    found = ask(app, "/find?search=stops")
    assert found.status == status
    if isinstance(said, str):
        assert found.text == said
        return
    head, rest = found.body.split(b"\n", 1)
    assert rest == done.output
    assert isinstance(said, dict)
    assert (
        json.loads(head).items()
        >= {**said, "viewers": [{"url": f"{FOXGLOVE}/~/view", "name": "app.foxglove.dev"}]}.items()
    )


def test_two_questions_are_asked_at_a_time_and_the_line_has_an_end(
    app: Starlette, monkeypatch: pytest.MonkeyPatch
) -> None:
    running: list[str] = []
    most: list[list[str]] = []
    gate = asyncio.Event()

    async def ask_slowly(words: list[str], *_: object) -> JobDone:
        running.append(words[0])
        most.append(sorted(running))
        await gate.wait()
        running.remove(words[0])
        return ANSWERS[words[0]]

    monkeypatch.setattr(desk_logs, "ask_review", ask_slowly)

    async def crowd() -> list[int]:
        paths = ["/find?search=stops"] * 3 + ["/whys/a.mcap?at=1"] * (WAITING_MAX + 3)
        asking = [asyncio.create_task(asked(app, path)) for path in paths]
        for _ in range(100):
            await asyncio.sleep(0)
        gate.set()
        return [answer.status for answer in await asyncio.gather(*asking)]

    statuses = asyncio.run(asyncio.wait_for(crowd(), 60))
    assert max(map(len, most)) == QUESTIONS_AT_ONCE
    assert max(one.count("find") for one in most) == 1
    assert statuses.count(503) == 2
    assert set(statuses) == {200, 503}


def test_a_question_at_the_end_of_the_desk_is_no_fault(app: Starlette, monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(*_: object) -> JobDone:
        await asyncio.Event().wait()
        raise AssertionError

    monkeypatch.setattr(desk_logs, "ask_review", never)

    async def end(path: str) -> int:
        asking = asyncio.create_task(asked(app, path))
        for _ in range(20):
            await asyncio.sleep(0)
        asking.cancel()
        return (await asking).status

    for path in ("/find?search=stops", "/whys/a.mcap?at=1"):
        assert asyncio.run(end(path)) == 503


def test_a_viewer_reads_a_log_by_ranges_and_nothing_else(app: Starlette) -> None:
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
    for path in ("/find?search=x1", "/whys/b.mcap", "/reports/b.mcap", "/logs.html"):
        assert "access-control-allow-origin" not in ask(app, path, {"origin": FOXGLOVE}).headers


@pytest.mark.parametrize(
    ("url", "origin"),
    [
        ("https://app.foxglove.dev/~/view", "https://app.foxglove.dev"),
        ("https://Lichtblick.example:443/?ds=x", "https://lichtblick.example"),
        ("http://127.0.0.1:8080", "http://127.0.0.1:8080"),
        ("http://[::1]:80/a", "http://[::1]"),
    ],
)
def test_the_origin_is_as_browsers_write_it(url: str, origin: str) -> None:
    assert viewer(url).origin == origin


@pytest.mark.parametrize(
    "url", ["", "app.foxglove.dev", "javascript:alert(1)", "file:///etc", "https://a:b", "https://u@h/"]
)
def test_what_is_no_page_is_refused(url: str) -> None:
    with pytest.raises(CommandError, match=r"desk\.viewers: .* not the address of a viewer"):
        viewer(url)

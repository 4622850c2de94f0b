"""A directory of logs that answers, on a thread of its own."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest

from recorder.mcap import log_map
from recorder.mcap.log_map import EARLY_NS, LATE_NS, LogMap
from recorder.zenoh import backfill_server
from recorder.zenoh.backfill_server import BackfillServer
from schemas.recording import Backfill, BackfillPiece
from tests.support.backfill_logs import (
    GEAR,
    RX,
    SECOND,
    START_NS,
    Row,
    gear_rows,
    log_of,
    matches,
    row,
    rows_of,
    write,
)

WAIT_S = 30.0
ALL = Backfill("fleet/**", START_NS, START_NS + 3600 * SECOND)


class Asker:
    """Waits for an answer."""

    def __init__(self) -> None:
        self.pieces: list[BackfillPiece] = []
        self.over = threading.Event()

    def ask(self, server: BackfillServer, request: Backfill = ALL) -> list[BackfillPiece]:
        """All pieces."""
        server.submit(request, self.pieces.append, self.over.set)
        assert self.over.wait(WAIT_S)
        return self.pieces


@pytest.fixture
def server(tmp_path: Path) -> Iterator[BackfillServer]:
    """A server of a directory."""
    with closing(BackfillServer(tmp_path, matches)) as found:
        yield found


def answer(server: BackfillServer, request: Backfill = ALL) -> list[Row]:
    """The messages of an answer that was whole."""
    pieces = Asker().ask(server, request)
    assert pieces[-1].is_last
    assert pieces[-1].next_ns == request.to_ns
    assert all(piece.ok for piece in pieces)
    return rows_of(pieces)


ROWS = gear_rows(100)


def test_all_logs_of_a_directory_are_asked(server: BackfillServer, tmp_path: Path) -> None:
    """Whole ones and the one that is being written, in the order of publish times."""
    write(tmp_path / "b.mcap", log_of(ROWS[:40]))
    write(tmp_path / "a.mcap", log_of(ROWS[40:70]))
    write(tmp_path / "c.mcap.part", log_of(ROWS[70:], is_finished=False))
    write(tmp_path / "notes.txt", b"none")
    write(tmp_path / "x.mcap.damaged", log_of(gear_rows(10, first=500)))
    assert answer(server) == ROWS


def test_a_key_and_a_time_are_answered(server: BackfillServer, tmp_path: Path) -> None:
    """And nothing else."""
    write(tmp_path / "a.mcap", log_of([*ROWS, row(0, 500, RX)]))
    request = Backfill(GEAR, ROWS[10].publish_ns, ROWS[20].publish_ns)
    assert answer(server, request) == ROWS[10:20]


def test_a_log_that_grows_is_answered_as_far_as_it_is(server: BackfillServer, tmp_path: Path) -> None:
    """And when it has been renamed, and another one begun."""
    part = tmp_path / "a.mcap.part"
    data = log_of(ROWS)
    write(part, data[: len(data) // 2])
    found = answer(server)
    assert 0 < len(found) < 100
    with part.open("ab") as stream:
        stream.write(data[len(data) // 2 :])
    os.utime(part, ns=(0, START_NS + 86_400 * SECOND))
    assert answer(server) == ROWS
    part.rename(tmp_path / "a.mcap")
    write(tmp_path / "b.mcap.part", b"")
    assert answer(server) == ROWS


def test_a_part_that_becomes_whole_meanwhile_is_read_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between looking through the directory and reading."""
    part = write(tmp_path / "a.mcap.part", log_of(ROWS))
    read_on = LogMap.read_on

    def read_and_rename(chart: LogMap, *arguments: object, **more: object) -> None:
        read_on(chart, *arguments, **more)  # type: ignore[arg-type] # handed on as they come
        if part.exists():
            part.rename(tmp_path / "a.mcap")

    monkeypatch.setattr(LogMap, "read_on", read_and_rename)
    with closing(BackfillServer(tmp_path, matches)) as server:
        assert answer(server) == ROWS


def test_logs_of_another_time_are_not_looked_through(
    server: BackfillServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that was last written before, and one that begins after."""
    old = write(tmp_path / "old.mcap", log_of(ROWS))
    write(tmp_path / "new.mcap", log_of(gear_rows(100, at_ms=86_400_000)))
    now = write(tmp_path / "now.mcap", log_of(gear_rows(100, first=200, at_ms=3_600_000)))
    from_ns = START_NS + 3600 * SECOND
    os.utime(old, ns=(0, from_ns - EARLY_NS - 1))
    os.utime(now, ns=(0, from_ns + 10 * SECOND))
    walked: list[int] = []
    read_on = LogMap.read_on

    def watched(chart: LogMap, *arguments: object, **more: object) -> None:
        read_on(chart, *arguments, **more)  # type: ignore[arg-type] # handed on as they come
        walked.append(len(chart))

    monkeypatch.setattr(LogMap, "read_on", watched)
    found = answer(server, Backfill("fleet/**", from_ns, from_ns + LATE_NS))
    assert found == gear_rows(100, first=200, at_ms=3_600_000)
    assert walked == [1, 10, 1]


def test_a_log_that_cannot_be_read_is_named(server: BackfillServer, tmp_path: Path) -> None:
    """The others are answered."""
    write(tmp_path / "good.mcap", log_of(ROWS))
    (tmp_path / "bad.mcap").mkdir()
    pieces = Asker().ask(server)
    assert rows_of(pieces) == ROWS
    assert pieces[-1].detail == "bad.mcap: Is a directory"


def test_a_directory_that_is_gone_has_nothing(tmp_path: Path) -> None:
    """That is an answer too."""
    with closing(BackfillServer(tmp_path / "none", matches)) as server:
        assert answer(server) == []


def test_a_request_for_no_time_is_refused(server: BackfillServer) -> None:
    """At once."""
    (piece,) = Asker().ask(server, Backfill("fleet/**", 5, 5))
    assert not piece.ok
    assert piece.is_last
    assert "no time" in piece.detail


class Held:
    """A reply that waits for the link until it is let go."""

    def __init__(self) -> None:
        self.begun = threading.Event()
        self.go = threading.Event()

    def __call__(self, _piece: BackfillPiece) -> None:
        self.begun.set()
        assert self.go.wait(WAIT_S)


def test_of_too_many_requests_the_last_are_refused(server: BackfillServer, tmp_path: Path) -> None:
    """Submitting never waits; those that wait are answered in their turn."""
    write(tmp_path / "a.mcap", log_of(ROWS))
    held = Held()
    over = threading.Event()
    server.submit(ALL, held, over.set)
    assert held.begun.wait(WAIT_S)
    waiting = [Asker() for _ in range(backfill_server.REQUESTS_WAITING)]
    for asker in waiting:
        server.submit(ALL, asker.pieces.append, asker.over.set)
    (refused,) = Asker().ask(server)
    assert (refused.ok, refused.detail, refused.is_last) == (False, "busy", True)
    held.go.set()
    for asker in waiting:
        assert asker.over.wait(WAIT_S)
        assert rows_of(asker.pieces) == ROWS


def test_the_end_refuses_what_waits(tmp_path: Path) -> None:
    """And what comes later; each is told that it is over."""
    server = BackfillServer(tmp_path, matches)
    held = Held()
    over = threading.Event()
    server.submit(ALL, held, over.set)
    assert held.begun.wait(WAIT_S)
    waiting = Asker()
    server.submit(ALL, waiting.pieces.append, waiting.over.set)
    closer = threading.Thread(target=server.close)
    closer.start()
    held.go.set()
    closer.join(WAIT_S)
    assert over.is_set()
    assert waiting.over.is_set()
    for pieces in (waiting.pieces, Asker().ask(server)):
        assert [(piece.ok, piece.detail) for piece in pieces] == [(False, "the recorder is ending")]


def test_a_reply_that_fails_costs_its_own_answer_only(server: BackfillServer, tmp_path: Path) -> None:
    """The next one is answered."""
    write(tmp_path / "a.mcap", log_of(ROWS))

    def fail(_piece: BackfillPiece) -> None:
        raise RuntimeError("the link is gone")

    over = threading.Event()
    server.submit(ALL, fail, over.set)
    assert over.wait(WAIT_S)
    assert answer(server) == ROWS


def clock(step_s: float) -> Callable[[], float]:
    """A clock that goes on by so much whenever it is looked at."""
    now_s = 0.0

    def look() -> float:
        nonlocal now_s
        now_s += step_s
        return now_s

    return look


def test_a_request_takes_no_longer_than_it_may(tmp_path: Path) -> None:
    """Asked again from where it ended, it comes to the end; what was found out of the logs is remembered."""
    rows = gear_rows(2000)
    for number in range(4):
        write(tmp_path / f"{number}.mcap", log_of(rows[number * 500 : number * 500 + 500]))
    with closing(BackfillServer(tmp_path, matches, clock(backfill_server.REQUEST_S / 60))) as server:
        found: list[Row] = []
        from_ns, requests = ALL.from_ns, 0
        while from_ns < ALL.to_ns:
            pieces = Asker().ask(server, Backfill(ALL.key, from_ns, ALL.to_ns))
            assert pieces[-1].is_last
            found += rows_of(pieces)
            from_ns = pieces[-1].next_ns
            requests += 1
            assert requests < 100
        assert found == rows
        assert requests > 2


def test_a_log_that_was_not_looked_through_is_no_empty_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer says that nothing is answered yet; the next one goes on from there."""
    monkeypatch.setattr(log_map, "LOOK_EVERY", 1)
    write(tmp_path / "a.mcap", log_of(ROWS))
    with closing(BackfillServer(tmp_path, matches, clock(backfill_server.REQUEST_S / 10))) as server:
        (first,) = Asker().ask(server)
        assert (first.ok, first.is_last, first.next_ns, first.messages) == (True, True, ALL.from_ns, 0)
        assert "ask again" in first.detail
        (chart,) = server._charts.values()
        before = len(chart)
        Asker().ask(server)
        assert 0 < before < len(chart)


def test_maps_are_remembered_but_not_without_end(
    server: BackfillServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The newest logs asked for."""
    monkeypatch.setattr(backfill_server, "CHUNKS_REMEMBERED", 25)
    for number in range(6):
        write(tmp_path / f"{number}.mcap", log_of(gear_rows(100, first=100 * number, at_ms=10_000 * number)))
    for _ in range(3):
        assert answer(server) == gear_rows(600)
        assert sum(map(len, server._charts.values())) <= 25 + 10

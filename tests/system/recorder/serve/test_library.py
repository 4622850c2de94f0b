"""The catalog of a served directory, as a real command makes it."""

import asyncio
from pathlib import Path

import pytest

from recorder.serve.library import Library, LibraryState
from tests.support.rigs.scenarios import deadman, front_bumper, recorded


def keep_until(library: Library, state: LibraryState) -> None:
    """Keep it current until it is so."""
    asyncio.run(asyncio.wait_for(library.keep_current(lambda: library.state == state), 100))


def test_where_nothing_may_be_written_beside_the_logs_they_are_found_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what comes later is read alone. A log that is damaged is said, and costs no other."""
    logs, scratch = tmp_path / "logs", tmp_path / "scratch"
    logs.mkdir()
    scratch.mkdir()
    (logs / "a.mcap").write_bytes(recorded(front_bumper))
    # Root, who may run this, writes everywhere.
    monkeypatch.setattr("os.access", lambda *_: False)
    library = Library(logs, scratch)
    keep_until(library, LibraryState(1, 1))
    assert [one["reason"] for one in library.find("stop", 0)["answers"]] == ["front_bumper"]
    assert [one.name for one in logs.iterdir()] == ["a.mcap"]
    (logs / "b.mcap").write_bytes(recorded(deadman)[:-5000])
    (logs / "c.mcap").write_bytes(b"no log at all")
    asyncio.run(asyncio.wait_for(library.keep_current(lambda: bool(library.state.fault)), 100))
    assert (library.state.logs, library.state.cataloged) == (3, 2)
    assert "1 of 2 logs are damaged" in library.state.fault
    assert {one["reason"] for one in library.find("stop", 0)["answers"]} == {"front_bumper", "deadman"}

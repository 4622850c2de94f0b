"""The common part of questions: robots, a terminal, a stop."""

from io import BytesIO, TextIOWrapper
from pathlib import Path

import pytest

from gateway.cli.main import main
from recorder.cli.asking import progress_bar
from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.logs import Log, gears, own_log, saved
from tests.support.messages import FakeSample


def test_a_directory_of_many_robots_is_told_of_some(
    tmp_path: Path, cut: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(1, 16):
        log = Log()
        log.receive(FakeSample(f"fleet/depot-{number}/state", "x", b""))
        saved(tmp_path / f"{number}.mcap", log.close())
    saved(tmp_path / cut.name, cut.read_bytes())
    assert review("info", str(tmp_path), "--robot", "depot-1*", "--robot", "depot-2") == ExitCode.OK
    *lines, total, _, robots = capsys.readouterr().out.splitlines()
    assert len(lines) == 8
    assert total.startswith("8 files, 8 of them whole")
    assert robots == "  8 robots: depot-1, depot-2, depot-10, depot-11, depot-12, depot-13, depot-14, depot-15"
    assert review("info", str(tmp_path)) == ExitCode.PARTIAL
    assert capsys.readouterr().out.splitlines()[-1].endswith("depot-11 and 4 more")
    with pytest.raises(CommandError, match="nothing of depot-3\\?, but of cruiser-1, depot-1, ") as refused:
        review("info", str(tmp_path), "--robot", "depot-3?")
    assert refused.value.code is ExitCode.USAGE


def test_a_terminal_may_lack_characters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = BytesIO()
    monkeypatch.setattr("sys.stdout", TextIOWrapper(stream, "latin-1"))
    log = saved(
        tmp_path / "a.mcap", own_log([gears(0, 2, 5)], metadata=[("cruiser.recorder", {"name": "\u901f"})])
    )
    assert main(["review", "info", str(log.rename(tmp_path / "\u901f.mcap"))]) == ExitCode.OK
    assert rb"\u901f.mcap: whole" in stream.getvalue()


def test_whoever_is_told_to_stop_stops_reading() -> None:
    asked_to = [False, True]
    with progress_bar("reading", 100, lambda: asked_to.pop(0)) as progress:
        progress(1)
        with pytest.raises(KeyboardInterrupt):
            progress(1)
    assert not asked_to

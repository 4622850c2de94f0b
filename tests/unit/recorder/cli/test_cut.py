"""``cruiser review cut``."""

import json
from pathlib import Path

import pytest

from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.logs import GEAR_TOPIC, gears, own_log, saved
from tests.support.reading import Read


def test_a_part_is_cut(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A time and topics, as people write them."""
    second = 1_000_000_000
    path = saved(tmp_path / "a.mcap", own_log([gears(0, 60, 100 * second, second)]))
    words = ("--from", "10", "--to", "-9.5", "--topics", "*/gear")
    assert review("cut", str(path), *words, "-o", str(tmp_path / "out.mcap"), "--json") == ExitCode.OK
    assert json.loads(capsys.readouterr().out)["messages"] == 40
    read = Read(tmp_path / "out.mcap")
    assert [message[1] for message in read.messages] == list(range(10, 50))
    assert {channel.topic for channel in read.channels} == {GEAR_TOPIC}
    with pytest.raises(CommandError, match="is no time") as caught:
        review("cut", str(path), "--from", "soon", "-o", str(tmp_path / "other.mcap"))
    assert caught.value.code == ExitCode.USAGE
    assert not (tmp_path / "other.mcap").exists()


def test_whoever_is_told_to_stop_leaves_nothing(tmp_path: Path) -> None:
    """At the first Ctrl-C."""
    log = saved(tmp_path / "in" / "a.mcap", own_log([gears(0, 3, 10)]))
    with pytest.raises(KeyboardInterrupt):
        review("cut", str(log), "-o", str(tmp_path / "out.mcap"), is_stopped=True)
    assert [path.name for path in tmp_path.iterdir()] == ["in"]

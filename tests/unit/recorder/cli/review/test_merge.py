"""``cruiser review merge`` and ``cut``."""

import json
from pathlib import Path

import pytest

from schemas.exit_codes import CommandError, ExitCode
from tests.support.commands import review
from tests.support.logs import GEAR_TOPIC, gears, own_log, saved
from tests.support.reading import Read


def test_logs_are_merged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What went into it is told."""
    saved(tmp_path / "in" / "a.mcap", own_log([gears(0, 3, 10)]))
    saved(tmp_path / "in" / "b.mcap", own_log([gears(2, 3, 30)]))
    out = tmp_path / "out.mcap"
    assert review("merge", str(tmp_path / "in"), "-o", str(out)) == ExitCode.OK
    assert [message[1] for message in Read(out).messages] == [0, 1, 2, 3, 4]
    said = capsys.readouterr().out
    assert f"{out}: 5 messages on 1 channels" in said
    assert "of 2 files; 1 messages were in them more than once" in said
    with pytest.raises(CommandError, match="exists, and is not overwritten"):
        review("merge", str(tmp_path / "in"), "-o", str(out))


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


@pytest.mark.parametrize("question", ["merge", "cut"])
def test_whoever_is_told_to_stop_leaves_nothing(tmp_path: Path, question: str) -> None:
    """At the first Ctrl-C."""
    log = saved(tmp_path / "in" / "a.mcap", own_log([gears(0, 3, 10)]))
    with pytest.raises(KeyboardInterrupt):
        review(question, str(log), "-o", str(tmp_path / "out.mcap"), is_stopped=True)
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


@pytest.mark.parametrize("left_out", [0, 20])
def test_a_part_of_no_topic_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], left_out: int) -> None:
    """A wrong pattern would look like an empty drive. That the log is cut off is told besides."""
    data = own_log([gears(0, 3, 10)])
    log = saved(tmp_path / "a.mcap", data[: len(data) - left_out])
    with pytest.raises(CommandError, match="no topic is of these patterns") as refused:
        review("cut", log, "--topics", "nothing", "-o", tmp_path / "out.mcap")
    assert refused.value.code is ExitCode.USAGE
    assert ("cut off" in capsys.readouterr().err) == bool(left_out)
    assert list(tmp_path.iterdir()) == [log]

"""What ``cruiser record`` says to recorders, and what they reply, in words."""

import argparse

import pytest

from recorder.cli import record
from recorder.cli.remote import describe
from schemas.command_line import ExitCode
from schemas.recording import RecorderReply, RecorderState
from tests.support.messages import recorder_health


@pytest.mark.parametrize(
    "words",
    [
        ["dance"],
        ["status", "Depot"],
        ["status", "depot/x"],
        ["status", "\x1b[2J"],
        ["status", "depot", "other"],
        ["mark", "--robot", "*"],
        ["mark", "--operator", "a b"],
        ["mark", "--timeout", "0"],
        ["mark", "--timeout", "nan"],
        ["status", "--text", "x"],
    ],
)
def test_wrong_words_are_a_usage_error(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2, before anybody is asked."""
    parser = argparse.ArgumentParser()
    record.add_arguments(parser)
    with pytest.raises(SystemExit) as caught:
        parser.parse_args(words)
    assert caught.value.code == ExitCode.USAGE
    assert "\x1b" not in capsys.readouterr().err


def test_a_reply_reads_like_a_sentence() -> None:
    """A refusal is one; the figures of a status have their units."""
    reply = RecorderReply(ok=False, detail="why", files=["a.mcap"], health=recorder_health(RecorderState.FULL))
    assert describe("depot", "mark", reply) == "depot: refused: why\n  a.mcap"
    text = describe("depot", "status", reply)
    assert "0.0 MB of logs, 0.0 MB of them incidents, 0.0 MB free" in text
    assert "for 1 s, up 2 s, version 1" in text

"""Which logs and which time a question is about."""

import argparse
from pathlib import Path

import pytest

from recorder.cli.asking import Asked, add_logs, add_period, find
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings
from tests.support.logs import small_log
from tests.support.messages import WALL_NS


def ask(*words: str) -> Asked:
    parser = argparse.ArgumentParser()
    add_logs(parser)
    add_period(parser)
    return find(parser.parse_args(words), Settings(), lambda: False)


@pytest.fixture
def log(tmp_path: Path) -> str:
    path = tmp_path / "log.mcap"
    path.write_bytes(small_log())
    return str(path)


def test_without_times_all_is_asked_about(log: str) -> None:
    """From the first log time to the last."""
    asked = ask(log)
    assert asked.start_ns == WALL_NS
    assert asked.from_ns <= asked.start_ns <= asked.end_ns < asked.to_ns


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--from", "5", "--to", "3"], "no time between"),
        (["--from", "1000"], "hold nothing of that time"),
        (["--to", "1999-01-01T00:00:00Z"], "hold nothing of that time"),
        (["--from", "noon"], "is no time"),
    ],
)
def test_a_time_that_is_not_in_the_logs_is_one_clear_error(log: str, words: list[str], message: str) -> None:
    """An empty answer would look like one."""
    with pytest.raises(CommandError, match=message) as raised:
        ask(log, *words)
    assert raised.value.code is ExitCode.USAGE

import os
import pty
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.cli.sim import TypedLines


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """The two ends of a pipe; the test may close the second."""
    ends = os.pipe()
    yield ends
    for end in ends:
        try:
            os.close(end)
        except OSError:
            continue


def test_whole_lines_come_once(pipe: tuple[int, int]) -> None:
    """A line is read when its end has come; empty ones are skipped."""
    lines = TypedLines(pipe[0])
    assert lines.read() == []
    os.write(pipe[1], b"bumper front on\n\n  clear  \nsilen")
    assert lines.read() == ["bumper front on", "clear"]
    assert lines.read() == []
    os.write(pipe[1], b"ce all\n")
    assert lines.read() == ["silence all"]


def test_the_end_of_a_pipe_is_the_end(pipe: tuple[int, int]) -> None:
    """Its last line counts without a newline; from then on the descriptor is left alone."""
    lines = TypedLines(pipe[0])
    os.write(pipe[1], b"clear")
    assert lines.read() == []
    os.close(pipe[1])
    assert lines.read() == ["clear"]
    assert lines.read() == []
    assert lines._open is False


def test_an_endless_line_is_given_up(pipe: tuple[int, int]) -> None:
    """What is kept is bounded, and any bytes are text."""
    lines = TypedLines(pipe[0])
    for _ in range(10):
        os.write(pipe[1], b"\xff" * 4096)
        assert lines.read() == []
    assert len(lines._buffer) <= 1024


def test_only_a_terminal_or_a_pipe_is_typed_into(tmp_path: Path) -> None:
    """A file, /dev/null or no descriptor at all has no lines."""
    file = tmp_path / "lines"
    file.write_text("clear\n")
    for path in (file, Path("/dev/null")):
        with path.open("rb") as opened:
            assert TypedLines(opened.fileno()).read() == []
    assert TypedLines(-1).read() == []


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A pseudo-terminal: the side that types, and the side that reads."""
    ends = pty.openpty()
    yield ends
    for end in ends:
        os.close(end)


def test_a_terminal_is_typed_into(terminal: tuple[int, int]) -> None:
    """Line by line, as a person types."""
    lines = TypedLines(terminal[1])
    os.write(terminal[0], b"clear\nbump")
    assert lines.read() == ["clear"]
    assert lines.read() == []

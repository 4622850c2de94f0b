"""What is shared by all commands: words that are gone, files that are no files, text from elsewhere."""

from __future__ import annotations

import os
import stat
import sys
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.cli.main import COMMANDS, main
from recorder.cli.review import QUESTIONS
from schemas import command_line
from schemas.command_line import LINE_LENGTH, CommandError, ExitCode, check_regular, missing_extra, plain, short


@pytest.mark.parametrize(
    "typed", [*command_line.GONE_WORDS, "parade", "review parade", "record --horses", "review why --band"]
)
@pytest.mark.parametrize("more", ["", " logs", " --out there"])
def test_what_is_gone_is_an_error_that_says_what_to_use(
    typed: str, more: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Commands, questions, and flags with their values."""
    here = dict.fromkeys(["parade", "review parade", "record --horses", "review why --band"], "a drum")
    monkeypatch.setattr(command_line, "GONE_WORDS", {**command_line.GONE_WORDS, **here})
    assert main([*typed.split(), *more.split()]) == ExitCode.USAGE
    assert capsys.readouterr().err.startswith(f"cruiser: '{typed}' is gone: ")


@pytest.mark.parametrize(
    ("words", "gone_one"),
    [
        ("record --connect tcp/127.0.0.1:7447 stop", "record stop"),
        ("record --log-level=debug start", "record start"),
        ("review --config c.toml evidence a.mcap", "review evidence"),
        ("record --name stop", ""),
        ("review why evidence", ""),
    ],
)
def test_what_is_gone_is_found_behind_flags(words: str, gone_one: str) -> None:
    """A flag's value, and the word after the question, are neither."""
    assert command_line.gone_word(words.split()).startswith(f"'{gone_one}' is gone" if gone_one else "")
    assert bool(command_line.gone_word(words.split())) == bool(gone_one)


def test_what_is_gone_is_not_there() -> None:
    """A word is not in two tables."""
    questions = {f"review {question}" for question in QUESTIONS}
    assert not command_line.GONE_WORDS.keys() & (COMMANDS.keys() | questions)


@pytest.mark.parametrize("words", ["review why a.mcap", "record", "", "review", "stop --all", "--help"])
def test_other_words_are_not_gone(words: str) -> None:
    """What stays is not held up."""
    assert not command_line.gone_word(words.split())


@given(st.text())
def test_whatever_comes_is_printable(text: str) -> None:
    """It breaks neither line nor terminal; what can be printed stays as it is."""
    assert plain(text).isprintable()
    assert (plain(text) == text) == text.isprintable()


@given(st.integers(0, 2 * LINE_LENGTH))
def test_a_text_that_is_too_long_for_a_line_is_cut(length: int) -> None:
    """And that can be seen."""
    text = "x" * length
    assert len(short(text)) <= LINE_LENGTH
    assert short(text) == text if length <= LINE_LENGTH else short(text).endswith("x...")


def test_a_file_or_a_link_to_one_is_regular(tmp_path: Path) -> None:
    """Nothing is said of it."""
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_text("")
    link.symlink_to(file)
    for path in (file, link):
        check_regular(path, path.stat().st_mode)


def test_what_is_no_file_is_named_with_its_kind(tmp_path: Path) -> None:
    """Directories, FIFOs, sockets and devices, in one printable line."""
    fifo, place = tmp_path / "fi\nfo", tmp_path / "socket"
    os.mkfifo(fifo)
    os.mknod(place, stat.S_IFSOCK | 0o600)
    for path, kind in (
        (tmp_path, "a directory"),
        (fifo, "a FIFO"),
        (place, "a socket"),
        (Path("/dev/zero"), "a device"),
    ):
        with pytest.raises(CommandError, match=f"is {kind}, and has to be a regular file") as caught:
            check_regular(path, path.stat().st_mode)
        assert caught.value.code is ExitCode.USAGE
        assert str(caught.value).isprintable()


PYPROJECT = Path(__file__).parents[3] / "pyproject.toml"


@pytest.mark.parametrize("extra", ["review", "live"])
def test_with_pip_it_is_the_extra(monkeypatch: pytest.MonkeyPatch, extra: str) -> None:
    """Which there is."""
    monkeypatch.setitem(sys.modules, "pip", sys)
    said = str(missing_extra("duckdb", extra))
    assert (
        said
        == f"this needs duckdb: pip install -e '.[{extra}]' in the checkout, or 'FILE[{extra}]' with the wheel"
    )
    assert extra in tomllib.loads(PYPROJECT.read_text("utf-8"))["project"]["optional-dependencies"]


def test_without_pip_it_is_another_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in the Debian package, which would have nobody follow a cure that it has not."""
    monkeypatch.setitem(sys.modules, "pip", None)
    said = str(missing_extra("duckdb", "review"))
    assert "pip install" not in said
    assert "make install" in said
    assert "\n" not in said

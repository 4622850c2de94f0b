"""Tests ``schemas.command_line``: who types what is gone hears what to use instead."""

from __future__ import annotations

import pytest

from gateway.cli.main import COMMANDS, main
from recorder.cli.review import QUESTIONS
from schemas import command_line
from schemas.command_line import ExitCode


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

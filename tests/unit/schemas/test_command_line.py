"""What all commands share: regular files, printable text, extras, durations."""

from __future__ import annotations

import argparse
import os
import stat
import sys
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.arguments import ending_after, seconds
from schemas.command_line import (
    LINE_LENGTH,
    CommandError,
    ExitCode,
    check_regular,
    missing_extra,
    plain,
    short,
)


@given(st.text())
def test_whatever_comes_is_printable(text: str) -> None:
    assert plain(text).isprintable()
    assert (plain(text) == text) == text.isprintable()


@given(st.integers(0, 2 * LINE_LENGTH))
def test_a_text_that_is_too_long_for_a_line_is_cut(length: int) -> None:
    text = "x" * length
    assert len(short(text)) <= LINE_LENGTH
    assert short(text) == text if length <= LINE_LENGTH else short(text).endswith("x...")


def test_what_is_no_file_is_named_with_its_kind(tmp_path: Path) -> None:
    fifo, place = tmp_path / "fi\nfo", tmp_path / "socket"
    os.mkfifo(fifo)
    os.mknod(place, stat.S_IFSOCK | 0o600)
    for path, kind in (
        (tmp_path, "a directory"),
        (fifo, "a FIFO"),
        (place, "a socket"),
        (Path("/dev/zero"), "a device"),
    ):
        with pytest.raises(CommandError, match=f"is {kind}, not a regular file") as caught:
            check_regular(path, path.stat().st_mode)
        assert caught.value.code is ExitCode.USAGE
        assert str(caught.value).isprintable()


PYPROJECT = Path(__file__).parents[3] / "pyproject.toml"


@pytest.mark.parametrize("extra", ["review", "live"])
def test_with_pip_it_is_the_extra(monkeypatch: pytest.MonkeyPatch, extra: str) -> None:
    monkeypatch.setitem(sys.modules, "pip", sys)
    said = str(missing_extra("duckdb", extra))
    assert (
        said
        == f"this needs duckdb: pip install -e '.[{extra}]' in the checkout, or 'FILE[{extra}]' with the wheel"
    )
    assert extra in tomllib.loads(PYPROJECT.read_text("utf-8"))["project"]["optional-dependencies"]


def test_without_pip_it_is_another_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as the Debian package."""
    monkeypatch.setitem(sys.modules, "pip", None)
    said = str(missing_extra("duckdb", "review"))
    assert "pip install" not in said
    assert "make install" in said
    assert "\n" not in said


# Options that several commands share.


@given(value=st.floats(min_value=1e-9, max_value=1e9))
def test_a_number_above_0_is_a_duration(value: float) -> None:
    assert seconds(repr(value)) == value


@pytest.mark.parametrize("text", ["", "0", "-1", "nan", "inf", "1e999", "soon"])
def test_anything_else_is_not(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="seconds above 0"):
        seconds(text)


def test_an_end_comes_with_the_signal_or_with_the_time() -> None:
    now_s, signalled = [100.0], [False]
    ends = ending_after(lambda: signalled[0], 5.0, lambda: now_s[0])
    for_ever = ending_after(lambda: signalled[0], None, lambda: now_s[0])
    assert not ends()
    now_s[0] = 104.9
    assert not ends()
    now_s[0] = 105.0
    assert ends()
    assert not for_ever()
    signalled[0] = True
    assert for_ever()

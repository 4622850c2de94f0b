"""Flags, columns and metrics change by intention only."""

import pytest

from tests.support.interface import DIRECTORY, FILES, text_of


@pytest.mark.parametrize("name", FILES)
def test_the_interface_is_as_it_was(name: str) -> None:
    """If it has to change: ``python -m tests.support.interface``, and a line in CHANGELOG."""
    assert text_of(name) == (DIRECTORY / name).read_text(encoding="utf-8")

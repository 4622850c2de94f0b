"""``cruiser demo``: where its log goes."""

from pathlib import Path

import pytest

from gateway.cli.demo import fresh
from schemas.command_line import CommandError


def test_an_out_that_is_no_directory_is_named(tmp_path: Path) -> None:
    """Not only what is wrong, but with what."""
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(CommandError, match=rf"^cannot write in {path}: Not a directory$"):
        fresh(path)

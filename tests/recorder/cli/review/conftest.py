"""What the questions are asked with."""

from pathlib import Path

import pytest

from tests.recorder.fakes import small_log


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """A whole log."""
    path = tmp_path / "whole.mcap"
    path.write_bytes(small_log())
    return path


@pytest.fixture
def cut(tmp_path: Path) -> Path:
    """The log of a recorder that was killed."""
    path = tmp_path / "cut.mcap.part"
    path.write_bytes(small_log()[:-200])
    return path

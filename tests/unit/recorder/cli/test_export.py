"""``cruiser review export``."""

import sys
from functools import partial
from pathlib import Path

import pytest

from schemas.command_line import CommandError
from tests.support.commands import review
from tests.support.drives import drive_log
from tests.support.logs import saved

run = partial(review, "export")


def test_an_export_that_is_stopped_leaves_nothing(tmp_path: Path) -> None:
    """Ctrl-C, once."""
    with pytest.raises(KeyboardInterrupt):
        run("-o", tmp_path / "out", saved(tmp_path / "1.mcap", drive_log()), is_stopped=True)
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_what_is_not_installed_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    """One line says what to install."""
    for name in [name for name in sys.modules if name.startswith("recorder.review.export")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(CommandError, match=r"this needs pyarrow: pip install -e '\.\[review\]'"):
        run("--format", form, "-o", tmp_path / "out", saved(tmp_path / "1.mcap", drive_log()))

"""A library that is missing, and where to get it."""

import sys
import tomllib
from pathlib import Path

import pytest

from schemas.command_line import missing_extra

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

"""``cruiser metrics``: what it needs."""

from __future__ import annotations

import sys

import pytest

from gateway.cli import metrics
from schemas.command_line import CommandError
from tests.support.commands import run_command


def test_without_its_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """The product does not need it otherwise."""
    for name in [name for name in sys.modules if name.startswith("prometheus_client")]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("gateway.cli.metrics_server", "gateway.metrics"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    with pytest.raises(CommandError, match=r"prometheus_client: pip install -e '\.\[metrics\]'"):
        run_command(metrics, stopped=lambda: True)

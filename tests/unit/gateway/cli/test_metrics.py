"""``cruiser metrics``: where it listens, and what it needs."""

from __future__ import annotations

import sys

import pytest

from gateway.cli import metrics
from schemas.command_line import CommandError
from tests.support.commands import parsed, run_command


@pytest.mark.parametrize(
    ("words", "address"),
    [
        ([], ("127.0.0.1", 9747)),
        (["--listen", "192.0.2.1:1"], ("192.0.2.1", 1)),
        (["--listen", "[::1]:0"], ("::1", 0)),
    ],
)
def test_it_listens_on_this_machine_unless_asked(words: list[str], address: tuple[str, int]) -> None:
    """By address and port."""
    assert parsed(metrics, *words).listen == address


def test_without_its_library_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    """The product does not need it otherwise."""
    for name in [name for name in sys.modules if name.startswith("prometheus_client")]:
        monkeypatch.delitem(sys.modules, name)
    for name in ("gateway.cli.metrics_server", "gateway.metrics"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "prometheus_client", None)
    with pytest.raises(CommandError, match=r"prometheus_client: pip install -e '\.\[metrics\]'"):
        run_command(metrics, stopped=lambda: True)

"""``cruiser router``: it runs from its provisioned file, and says in one line what is wrong with it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.authority.transport import TransportRole
from tests.support.fakes.peer import free_endpoint
from tests.support.secured import Network


@pytest.fixture
def router(tmp_path: Path) -> Path:
    """A router's directory, and its endpoint in its file."""
    return Network(tmp_path, free_endpoint().replace("tcp", "tls")).node(TransportRole.ROUTER, "127.0.0.1")


def run(*words: str | Path) -> tuple[int, str]:
    """Exit code, and what is said."""
    command = [sys.executable, "-m", "gateway", "router", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout + done.stderr


def test_it_listens_where_its_file_says(router: Path) -> None:
    """Or where it is told to."""
    endpoint = json.loads((router / "router.json5").read_text())["listen"]["endpoints"][0]
    assert run("--directory", router, "--seconds", "0.1") == (0, f"router: listens on {endpoint}\n")
    other = free_endpoint().replace("tcp", "tls")
    words = ("--zenoh-config", router / "router.json5", "--listen", other, "--seconds", "0.1")
    assert run(*words) == (0, f"router: listens on {other}\n")


def test_what_is_wrong_is_one_line(router: Path, tmp_path: Path) -> None:
    """A missing file, a damaged one, somebody else's, a wrong endpoint, one that is not of this machine."""
    (tmp_path / "damaged.json5").write_text("{mode:")
    operator = Network(router, "tls/127.0.0.1:1").node(TransportRole.OPERATOR, "ann")
    for words, code, says in (
        (("--directory", tmp_path), 2, "'cruiser provision router' makes it"),
        (("--zenoh-config", tmp_path / "damaged.json5"), 2, "damaged.json5"),
        (("--zenoh-config", operator / "operator.json5"), 2, "is not a router's"),
        (("--directory", router, "--listen", "nowhere"), 2, "cannot listen on nowhere"),
        (("--directory", router, "--listen", "tls/192.0.2.1:7447"), 4, "192.0.2.1"),
    ):
        found, text = run(*words)
        assert (found, text.count("\n")) == (code, 1), text
        assert says in text

"""Zenoh's own router from the file of ``cruiser provision router``: where it differs from ours.

``make test-zenohd`` runs tests with both for all else.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Final

import pytest
import zenoh

from gateway.authority.enrolment import TransportRole
from gateway.provisioning.key_files import LEAF_DAYS
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.listening import listening
from tests.support.routers import PROGRAM, Zenohd
from tests.support.secured import Network
from tests.support.waiting import wait_until

ROOT: Final = Path(__file__).parents[2]
ADMIN_SPACE: Final = "@/*/router/**"  # where a router answers about itself: configuration and links


@pytest.fixture
def network(tmp_path: Path) -> Network:
    return Network(tmp_path, free_endpoint().replace("tcp/", "tls/"))


@pytest.fixture
def file(network: Network) -> Path:
    return network.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5"


@pytest.fixture
def zenohd(file: Path) -> Iterator[Zenohd]:
    with closing(Zenohd(file)) as running:
        yield running


def test_it_is_of_the_version_that_nodes_have(zenohd: Zenohd) -> None:
    """And it is the program under test."""
    said = subprocess.run([PROGRAM, "--version"], capture_output=True, text=True, check=True).stdout
    pinned = re.search(r"^eclipse-zenoh==(\S+)", (ROOT / "constraints-run.txt").read_text("utf-8"), re.MULTILINE)
    assert pinned is not None
    assert re.search(rf"\bv{re.escape(pinned[1])}\b", said), said
    assert Path(f"/proc/{zenohd.process.pid}/exe").samefile(os.environ["ZENOHD"])


def test_it_listens_where_its_file_says_and_nowhere_else(network: Network, zenohd: Zenohd) -> None:
    assert listening(zenohd.process.pid) == {network.endpoint.removeprefix("tls/")}


def asked(network: Network, role: TransportRole, name: str) -> list[str]:
    """The router's answers about itself to a node of this role that ignores its own file."""
    with network.session(role, name, access_control__enabled=False) as session:
        assert session.info.routers_zid()
        replies = session.get(ADMIN_SPACE, timeout=2, target=zenoh.QueryTarget.ALL)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


def test_nobody_asks_it_about_itself(network: Network, zenohd: Zenohd) -> None:
    """Its admin space is always on; neither its rules nor its permissions admit anybody."""
    del zenohd
    roles = [role for role in TransportRole if role is not TransportRole.ROUTER]
    assert {role: asked(network, role, "somebody") for role in roles} == {role: [] for role in roles}


def test_a_file_without_access_control_and_permissions_would_let_anybody_ask(network: Network, file: Path) -> None:
    """The test above can fail."""
    said = json.loads(file.read_text("utf-8"))
    said["access_control"]["enabled"] = False
    said["adminspace"]["permissions"]["read"] = True
    file.write_text(json.dumps(said), "utf-8")
    with closing(Zenohd(file)):
        assert asked(network, TransportRole.VIEWER, "somebody")


def test_a_service_manager_ends_it_and_nodes_find_the_next_one(network: Network, file: Path) -> None:
    first = Zenohd(file)
    with network.session(TransportRole.OPERATOR, "ann") as session:
        assert session.info.routers_zid()
        first.close()
        assert first.process.returncode == -signal.SIGTERM
        wait_until(lambda: not session.info.routers_zid())
        with closing(Zenohd(file)):
            wait_until(lambda: bool(session.info.routers_zid()))


def test_it_runs_on_with_a_certificate_that_is_over_and_nobody_connects(network: Network) -> None:
    """Ours does not start, and says what to do."""
    born_s = int(time.time()) - (LEAF_DAYS + 1) * 86_400
    over = network.node(TransportRole.ROUTER, "127.0.0.1", born_s=born_s) / "router.json5"
    with closing(Zenohd(over)) as zenohd:
        with pytest.raises(zenoh.ZError):
            network.session(TransportRole.OPERATOR, "ann")
        assert zenohd.process.poll() is None

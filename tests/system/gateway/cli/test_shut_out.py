"""Why a router lets a machine in no session, by real handshakes on loopback."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

import pytest

from gateway.authority.transport import TransportRole
from gateway.provisioning.certificates import LEAF_DAYS
from gateway.provisioning.tls_probe import why_not_let_in
from gateway.zenoh.client import close_session
from gateway.zenoh.router import open_router
from tests.support.fakes.peer import free_endpoint
from tests.support.secured import Network

PAST_S: Final = LEAF_DAYS * 86_400 + 3600


def tls_endpoint() -> str:
    """An endpoint that nobody listens on."""
    return free_endpoint().replace("tcp/", "tls/")


def viewer_of(network: Network) -> Path:
    """The Zenoh file of a viewer of the network."""
    return network.node(TransportRole.VIEWER, "vic") / "viewer.json5"


def network_in(directory: Path, endpoint: str) -> Network:
    """A network of its own authority."""
    directory.mkdir()
    return Network(directory, endpoint)


def test_where_nobody_listens_no_router_runs(tmp_path: Path) -> None:
    """That is said, and no guess."""
    endpoint = tls_endpoint()
    file = viewer_of(Network(tmp_path, endpoint))
    assert why_not_let_in(file, f"nobody at {endpoint}").startswith(f"no router runs at {endpoint}: ")
    assert why_not_let_in(file, "nobody at tls/elsewhere:7447") == ""


@pytest.mark.parametrize(("whose", "said"), [("own", ""), ("other", "is another fleet's")])
def test_a_router_of_another_fleet_is_told_from_ones_own(tmp_path: Path, whose: str, said: str) -> None:
    """By its certificate. Of one that lets this machine in, nothing is said."""
    endpoint = tls_endpoint()
    own, other = (network_in(tmp_path / name, endpoint) for name in ("own", "other"))
    network = {"own": own, "other": other}[whose]
    router, _ = open_router(network.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5", [])
    try:
        found = why_not_let_in(viewer_of(own), endpoint)
    finally:
        close_session(router)
    assert (said in found) if said else not found


def test_a_routers_certificate_that_is_over_is_said_to_be(tmp_path: Path) -> None:
    """With the cure, which is at the router."""
    network = Network(tmp_path, tls_endpoint())
    place = network.node(TransportRole.ROUTER, "127.0.0.1", born_s=int(time.time()) - PAST_S)
    router, _ = open_router(place / "router.json5", [])
    try:
        assert "that is over: 'cruiser provision renew router' there" in why_not_let_in(
            viewer_of(network), network.endpoint
        )
    finally:
        close_session(router)


def test_a_certificate_that_the_router_refuses_is_said_to_be_ones_own(tmp_path: Path) -> None:
    """As of a machine that has the new authority's ca.pem, and the old one's certificate."""
    endpoint = tls_endpoint()
    own, other = (network_in(tmp_path / name, endpoint) for name in ("own", "other"))
    file = viewer_of(own)
    router, _ = open_router(other.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5", [])
    try:
        (file.parent / "ca.pem").write_text(other.certificate)
        assert f"the router at {endpoint} refuses this machine's certificate: " in why_not_let_in(file, endpoint)
    finally:
        close_session(router)


def test_a_file_that_is_none_says_nothing(tmp_path: Path) -> None:
    """Nothing is tried with it."""
    file = tmp_path / "viewer.json5"
    assert why_not_let_in(file, "tls/127.0.0.1:1") == ""
    file.write_text("{mode: 'client'}")
    assert why_not_let_in(file, "tls/127.0.0.1:1") == ""

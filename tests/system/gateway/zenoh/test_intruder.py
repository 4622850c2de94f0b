"""Access without rights through each hole of a router, in real sessions with mutual TLS."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest
import zenoh

from gateway.authority.enrolment import CERTIFICATE_FILE, TLS_KEY_FILE, TransportRole
from gateway.host.self_test import Attempt, enters_without_certificate, intrude
from gateway.zenoh.client import open_router
from schemas.settings import Settings, ZenohSettings
from tests.support.fakes.peer import free_endpoint
from tests.support.secured import Network

ROBOT: Final = "fleet/cruiser-1"
COMMANDS: Final = f"{ROBOT}/@cmd/*/*"
STATE: Final = f"{ROBOT}/safety/state"

ATTEMPTS: Final = 3

RECEIVES: Final = rf"a subscription to ({STATE}|fleet/\*\*) receives"

HOLES: Final = {
    "put": (["ingress"], ["put"], [COMMANDS], r"a put on fleet/cruiser-1/@cmd/nobody-\w+/drive arrives"),
    "query": (["ingress"], ["query"], [COMMANDS], r"a query on fleet/cruiser-1/@cmd/nobody-\w+/acquire arrives"),
    "see": (["ingress", "egress"], ["declare_subscriber", "put"], [STATE], RECEIVES),
    "spy": (["ingress", "egress"], ["declare_subscriber", "put"], ["fleet/**"], RECEIVES),
    "answer": (
        ["ingress", "egress"],
        ["declare_queryable", "query", "reply"],
        [f"{ROBOT}/gateway/*"],
        r"a query on fleet/cruiser-1/gateway/nobody-\w+ comes to it",
    ),
}
"""Access granted to the role ``nothing``: flows, messages, keys, and the finding."""


class Surrounded:
    """Sessions of a robot and of the doctor, and an intruder's files."""

    def __init__(self, directory: Path) -> None:
        self.network = Network(directory, free_endpoint("tls"))
        self.place = self.network.node(TransportRole.ROBOT, "cruiser-1", "cruiser-1")
        nothing = self.network.node(TransportRole.NOTHING, "cruiser-1")
        self.certificate = nothing / CERTIFICATE_FILE.format(who="nothing")
        self.key = nothing / TLS_KEY_FILE.format(who="nothing")
        self.settings = Settings(zenoh=ZenohSettings(config=str(self.place / "robot.json5")))

    def intrude(self, robot: zenoh.Session, own: zenoh.Session) -> Attempt:
        def publish(pause_s: float) -> None:
            end_s = time.monotonic() + pause_s
            while time.monotonic() < end_s:
                robot.put(STATE, b"state")
                time.sleep(0.02)

        endpoint = self.network.endpoint
        return intrude(self.settings, endpoint, self.certificate, self.key, own, publish)

    def intrude_until(self, deeds: int, telemetry: zenoh.Session, commands: zenoh.Session) -> Attempt:
        """Repeat until this many deeds succeed: on a busy computer a message may be late."""
        for _ in range(ATTEMPTS):
            attempt = self.intrude(telemetry, commands)
            if len(attempt.deeds) >= deeds:
                break
        return attempt

    @contextmanager
    def behind(self, change: Any = None) -> Iterator[tuple[zenoh.Session, zenoh.Session]]:  # noqa: ANN401 - JSON
        file = self.network.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5"
        if change is not None:
            said = json.loads(file.read_text())
            change(said["access_control"])
            file.write_text(json.dumps(said))
        with ExitStack() as closing:
            router, _ = open_router(file, [])
            closing.callback(router.close)
            sessions = [zenoh.open(zenoh.Config.from_file(self.settings.zenoh.config)) for _ in range(2)]
            for session in sessions:
                closing.callback(session.close)
            yield sessions[0], sessions[1]


@pytest.fixture
def surrounded(tmp_path: Path) -> Surrounded:
    return Surrounded(tmp_path)


def test_behind_the_router_that_was_provisioned_nothing_is_possible(surrounded: Surrounded) -> None:
    with surrounded.behind() as sessions:
        assert surrounded.intrude(*sessions) == Attempt(is_connected=True)


@pytest.mark.parametrize("hole", HOLES)
def test_each_hole_of_a_router_is_found(surrounded: Surrounded, hole: str) -> None:
    flows, messages, keys, deed = HOLES[hole]

    def change(access: Any) -> None:  # noqa: ANN401 - JSON
        rule = {"id": "hole", "permission": "allow", "flows": flows, "messages": messages, "key_exprs": keys}
        access["rules"].append(rule)
        access["subjects"].append({"id": "nothing", "cert_common_names": ["nothing"]})
        access["policies"].append({"rules": ["hole"], "subjects": ["nothing"]})

    with surrounded.behind(change) as sessions:
        attempt = surrounded.intrude_until(1, *sessions)
    assert attempt.is_connected
    assert attempt.deeds
    assert all(re.fullmatch(deed, one) for one in attempt.deeds), attempt


def test_an_open_router_lets_everything_pass(surrounded: Surrounded) -> None:
    """Except for a forged state: a robot does not subscribe to its own."""
    with surrounded.behind(lambda access: access.update(enabled=False)) as sessions:
        deeds = surrounded.intrude_until(len(HOLES), *sessions).deeds
    assert len(deeds) == len(HOLES), deeds


@contextmanager
def listening(network: Network, endpoint: str, *, is_mutual: bool, is_open: bool) -> Iterator[zenoh.Session]:
    """A gateway's session that listens, with certificates at both ends or one, with or without rules."""
    place = network.directory / "desk-127.0.0.1"
    if not place.exists():
        network.node(TransportRole.DESK, "127.0.0.1")
    config = zenoh.Config.from_file(str(place / "desk.json5"))
    entries: dict[str, object] = {
        "mode": "peer",
        "connect/endpoints": [],
        "listen/endpoints": [endpoint],
        "transport/link/protocols": ["tls", "tcp"],
        "transport/link/tls/enable_mtls": is_mutual,
    }
    if is_open:
        entries["access_control/enabled"] = False
    for path, value in entries.items():
        config.insert_json5(path, json.dumps(value))
    session = zenoh.open(config)
    try:
        yield session
    finally:
        session.close()


@pytest.mark.parametrize("is_open", [False, True])
def test_a_forged_state_is_found_where_a_gateway_listens(surrounded: Surrounded, *, is_open: bool) -> None:
    network = surrounded.network
    with listening(network, network.endpoint, is_mutual=True, is_open=is_open) as session:
        attempt = surrounded.intrude(session, session)
    assert attempt.is_connected
    assert (f"a put on {STATE} arrives" in attempt.deeds) == is_open
    assert bool(attempt.deeds) == is_open


@pytest.mark.parametrize(
    ("protocol", "is_mutual", "entrance"), [("tls", True, ""), ("tls", False, "tls"), ("tcp", True, "tcp")]
)
def test_who_shows_no_certificate_gets_in_where_none_is_wanted(
    surrounded: Surrounded, protocol: str, *, is_mutual: bool, entrance: str
) -> None:
    network, place = surrounded.network, surrounded.network.endpoint.partition("/")[2]
    with listening(network, f"{protocol}/{place}", is_mutual=is_mutual, is_open=False):
        found = enters_without_certificate(surrounded.settings.zenoh, network.endpoint)
    assert found == (f"{entrance}/{place}" if entrance else "")

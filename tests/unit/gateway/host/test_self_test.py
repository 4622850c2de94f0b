"""The course of the test: what is asked before the network, and when what is asked again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway.authority.self_test import UNDER_WAY
from gateway.host import self_test
from gateway.host.self_test import Reached, SelfTest
from gateway.zenoh.intruder import Attempt
from schemas.exit_codes import CommandError
from schemas.settings import AuthoritySettings, Settings, ZenohSettings
from tests.support.authority import Fleet
from tests.support.provisioning import ProvisionedFleet
from tests.support.waiting import wait_until

ROUTER = "tls/router.example:7447"


class Network:
    """A gateway's sessions and the network around them, with a knob for each.

    Attributes:
        connected: the routers.
        attempt: what an intruder comes to.
        entrance: where somebody gets in without a certificate.
        tried: the endpoints at which an intruder was.
        session: the gateway's; None as long as it is off the network.
    """

    session: Any = "open"

    def __init__(self) -> None:
        self.connected: frozenset[str] = frozenset({"one"})
        self.attempt = Attempt(is_connected=True)
        self.entrance = ""
        self.tried: list[str] = []
        self.verdicts: list[str] = []

    def routers(self) -> frozenset[str]:
        return self.connected

    def intrude(self, _settings: Settings, endpoint: str, *_rest: object) -> Attempt:
        self.tried.append(endpoint)
        return self.attempt


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> Network:
    """A network that is sound."""
    found = Network()
    monkeypatch.setattr(self_test, "intrude", found.intrude)
    monkeypatch.setattr(self_test, "enters_without_certificate", lambda *_: found.entrance)
    monkeypatch.setattr(self_test, "LOOK_S", 0.01)
    monkeypatch.setattr(self_test, "AGAIN_S", 0.01)
    return found


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    """Of a robot that was provisioned."""
    monkeypatch.chdir(tmp_path)
    directory = ProvisionedFleet(tmp_path).let_in("robot", "cruiser-1")
    return Settings(
        zenoh=ZenohSettings(config=str(directory / "robot.json5")),
        authority=AuthoritySettings(mode="signed", directory=str(directory)),
    )


def begun(settings: Settings, network: Network, place: Reached) -> SelfTest:
    """A test that has begun."""
    test = SelfTest(settings, place, network, network, network.verdicts.append)
    test.begin(Fleet().trust)
    return test


def test_a_robot_that_this_machine_alone_reaches_passes_at_once(network: Network) -> None:
    """As in open mode; there is no certificate to be asked for."""
    test = begun(Settings(), network, Reached([], ["tcp/127.0.0.1:7447", "tcp/[::1]:7448"]))
    test.close()
    assert (network.verdicts, network.tried) == ([""], [])


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "udp/10.0.0.5:7447", "ws/[::]:7447"])
def test_an_endpoint_without_certificates_that_others_reach_fails(
    settings: Settings, network: Network, endpoint: str
) -> None:
    """Whether the gateway listens there or dials out."""
    for place in (Reached([endpoint], []), Reached([ROUTER], [endpoint])):
        begun(settings, network, place).close()
        assert network.verdicts.pop().startswith(f"{endpoint} is reached without a certificate: use tls/ or quic/")
    assert network.tried == []


def test_a_gateway_without_a_zenoh_file_fails(network: Network) -> None:
    """Zenoh's own start values shut nobody out."""
    begun(Settings(), network, Reached([ROUTER], [])).close()
    said = "zenoh.config is not set: 'cruiser provision robot' and 'install' make robot.json5"
    assert network.verdicts == [said]


def test_a_certificate_to_test_with_of_another_key_fails(settings: Settings, network: Network) -> None:
    """It would be shut out by TLS, which proves nothing of the access control."""
    directory = Path(settings.authority.directory)
    other = ProvisionedFleet(directory.parent / "other").let_in("robot", "cruiser-1")
    file = directory / "nothing-tls.pem"
    file.write_bytes((other / "nothing-tls.pem").read_bytes())
    begun(settings, network, Reached([ROUTER], [])).close()
    assert network.verdicts == [f"{file} is not of the key beside it; 'cruiser provision renew robot' asks for it"]


def test_a_file_that_is_mended_is_tested_again(settings: Settings, network: Network) -> None:
    """As an ended certificate is in order once the clock is set: no other file comes, and nothing starts again."""
    file = Path(settings.authority.directory) / "nothing-tls.pem"
    away = file.rename(file.with_suffix(".away"))
    test = begun(settings, network, Reached([ROUTER], []))
    assert f"{file} is not there" in network.verdicts[0]
    assert network.tried == []
    away.rename(file)
    wait_until(lambda: network.verdicts[-1] == "")
    test.close()
    assert network.tried


def test_a_damaged_admission_fails_before_all_else(
    settings: Settings, network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever can be reached by whom."""
    monkeypatch.setattr(self_test, "admission_fault", lambda *_: "a verb is accepted twice")
    begun(settings, network, Reached([], ["tcp/127.0.0.1:7447"])).close()
    begun(settings, network, Reached([ROUTER], [])).close()
    said = "a verb is accepted twice: the installation is damaged; install the cruiser-gateway again"
    assert network.verdicts == [said, said]


def test_the_test_is_under_way_until_it_has_passed(settings: Settings, network: Network) -> None:
    """At each endpoint where the gateway is reached with certificates."""
    place = Reached([ROUTER], ["tls/0.0.0.0:7447", "tcp/127.0.0.1:7448"])
    test = begun(settings, network, place)
    wait_until(lambda: len(network.verdicts) > 1)
    test.close()
    assert network.verdicts == [UNDER_WAY, ""]
    assert network.tried == [ROUTER, "tls/127.0.0.1:7447#verify_name_on_connect=false"]


def test_a_router_that_is_away_is_waited_for(settings: Settings, network: Network) -> None:
    """Nobody could engage the robot meanwhile in any case; when it is there, the test passes."""
    network.attempt = Attempt(is_connected=False)
    test = begun(settings, network, Reached([ROUTER], []))
    wait_until(lambda: len(network.tried) > 3)
    assert network.verdicts == [
        UNDER_WAY,
        f"it waits for {ROUTER}, where no node answers; it is tried on",
    ]
    network.attempt = Attempt(is_connected=True)
    wait_until(lambda: network.verdicts[-1] == "")
    test.close()


def test_a_robot_that_lost_its_router_stays_as_it_was(settings: Settings, network: Network) -> None:
    """It is not tested until there is a router again that it did not know; that it is open is found then."""
    test = begun(settings, network, Reached([ROUTER], []))
    wait_until(lambda: network.verdicts[-1] == "")
    network.attempt = Attempt(is_connected=False)
    for connected in (frozenset[str](), frozenset({"one"})):
        network.connected = connected
        tried = len(network.tried)
        test._ends.wait(0.1)
        assert len(network.tried) == tried
    network.connected = frozenset({"another"})
    waits = f"it waits for {ROUTER}, where no node answers; it is tried on"
    wait_until(lambda: network.verdicts[-1] == waits)
    network.connected = frozenset({"one"})
    wait_until(lambda: network.verdicts[-1] == "")
    assert network.verdicts == [UNDER_WAY, "", UNDER_WAY, waits, ""]
    network.connected = frozenset({"another"})
    network.attempt = Attempt(is_connected=True, deeds=["a put on X arrives"])
    wait_until(lambda: network.verdicts[-1].startswith("a certificate"))
    assert network.verdicts[-1] == (
        f"a certificate without any right is not shut out: a put on X arrives: the router at {ROUTER} has to run "
        "from the router.json5 that 'cruiser provision install' writes there"
    )
    network.attempt = Attempt(is_connected=True)
    wait_until(lambda: network.verdicts[-1] == "")
    test.close()


def test_an_own_listener_that_is_open_names_the_robots_own_file(settings: Settings, network: Network) -> None:
    """What it lets through, and whom it lets in without a certificate."""
    network.attempt = Attempt(is_connected=True, deeds=["a put on X arrives"])
    place, file = Reached([], ["tls/127.0.0.1:7447"]), settings.zenoh.config
    test = begun(settings, network, place)
    wait_until(lambda: len(network.verdicts) > 1)
    cure = "'cruiser provision install --replace' writes it"
    assert network.verdicts[-1].endswith(f"a put on X arrives: {file} is not as it has to be; {cure}")
    network.entrance = "tcp/127.0.0.1:7447"
    network.attempt = Attempt(is_connected=True)
    wait_until(lambda: len(network.verdicts) > 2)
    test.close()
    assert network.verdicts[-1] == (
        "tcp/127.0.0.1:7447 lets in who shows no certificate: leave out what the endpoint tls/127.0.0.1:7447 says "
        f"against {file}"
    )


def test_off_the_network_nothing_is_tried_and_nothing_passes(settings: Settings, network: Network) -> None:
    """A router that answers to the intruder alone proves nothing: the gateway's own sessions are to notice it."""
    network.session, network.connected = None, frozenset()
    test = begun(settings, network, Reached([ROUTER], []))
    wait_until(lambda: network.verdicts[-1].endswith("where no node answers; it is tried on"))
    assert network.tried == []
    network.session, network.connected = "open", frozenset({"one"})
    wait_until(lambda: network.verdicts[-1] == "")
    test.close()
    assert network.tried


def test_a_router_that_may_be_anybody_fails(settings: Settings, network: Network) -> None:
    """What the file says can be taken back by an endpoint."""
    endpoint = f"{ROUTER}#verify_name_on_connect=false"
    begun(settings, network, Reached([endpoint], [])).close()
    assert network.verdicts == [f"{endpoint} is whoever answers there: leave out verify_name_on_connect=false"]


def test_a_file_that_cannot_be_read_any_more_is_named(
    settings: Settings, network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The test does not end by it: it is made again."""
    wrong = "Zenoh configuration file 'robot.json5': no such file"

    def enters(*_given: object) -> str:
        if network.entrance:
            raise CommandError(network.entrance)
        return ""

    monkeypatch.setattr(self_test, "enters_without_certificate", enters)
    network.entrance = wrong
    test = begun(settings, network, Reached([], ["tls/127.0.0.1:7447"]))
    wait_until(lambda: network.verdicts[-1] == wrong)
    network.entrance = ""
    wait_until(lambda: network.verdicts[-1] == "")
    test.close()

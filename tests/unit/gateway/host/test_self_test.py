"""Checks of a robot's endpoints and file, and results of the router's test."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway.host import self_test
from gateway.host.self_test import Attempt, Reached, access_fault, find_hole, own_fault
from schemas.command_line import CommandError
from schemas.settings import AuthoritySettings, Settings, ZenohSettings
from tests.support.provisioning import ProvisionedFleet

ROUTER = "tls/router.example:7447"
ACCESS: dict[str, Any] = {
    "enabled": True,
    "default_permission": "deny",
    "subjects": [{"id": "router", "cert_common_names": ["router"]}],
}
TLS: dict[str, Any] = {"enable_mtls": True, "verify_name_on_connect": True}


@pytest.mark.parametrize(
    ("access", "tls", "said"),
    [
        pytest.param({}, {}, None, id="as they are provisioned"),
        ({"enabled": False}, {}, "access_control.enabled is not true"),
        ({"enabled": None}, {}, "access_control.enabled is not true"),
        ({"default_permission": "allow"}, {}, "access_control.default_permission is not deny"),
        ({"subjects": None}, {}, "access_control.subjects is empty"),
        ({"subjects": []}, {}, "access_control.subjects is empty"),
        ({"subjects": [{"id": "x"}]}, {}, "the subject 'x' of access_control has no cert_common_names"),
        (
            {"subjects": [*ACCESS["subjects"], {"id": "x", "cert_common_names": [], "interfaces": ["lo"]}]},
            {},
            "the subject 'x' of access_control has no cert_common_names: it matches every client",
        ),
        ({"subjects": ["x"]}, {}, "the subject 'x' of access_control has no cert_common_names"),
        ({}, {"enable_mtls": False}, "transport.link.tls.enable_mtls is not true"),
        ({}, {"enable_mtls": None}, "transport.link.tls.enable_mtls is not true"),
        ({}, {"verify_name_on_connect": False}, "transport.link.tls.verify_name_on_connect is not true"),
    ],
)
def test_each_rule_that_lets_anybody_pass_is_named(
    access: dict[str, Any], tls: dict[str, Any], said: str | None
) -> None:
    fault = access_fault(ACCESS | access, TLS | tls)
    assert fault.startswith(said) if said else fault == ""


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    monkeypatch.chdir(tmp_path)
    directory = ProvisionedFleet(tmp_path).let_in("robot", "cruiser-1")
    return Settings(
        zenoh=ZenohSettings(config=str(directory / "robot.json5")),
        authority=AuthoritySettings(mode="signed", directory=str(directory)),
    )


def test_what_was_provisioned_is_in_order(settings: Settings) -> None:
    assert own_fault(settings, Reached([ROUTER], ["tls/0.0.0.0:7447", "tcp/127.0.0.1:7448"])) == ""
    assert own_fault(Settings(), Reached([], ["tcp/127.0.0.1:7447", "tcp/[::1]:7448"])) == ""


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "udp/10.0.0.5:7447", "ws/[::]:7447"])
def test_an_endpoint_without_certificates_that_others_reach_is_named(settings: Settings, endpoint: str) -> None:
    for place in (Reached([endpoint], []), Reached([ROUTER], [endpoint])):
        assert own_fault(settings, place).startswith(
            f"{endpoint} is reached without a certificate: use tls/ or quic/"
        )


@pytest.mark.parametrize("option", ["verify_name_on_connect=false", "enable_mtls=false"])
def test_an_endpoint_that_takes_back_what_the_file_says_is_named(settings: Settings, option: str) -> None:
    endpoint = f"{ROUTER}#{option}"
    assert own_fault(settings, Reached([], [endpoint])) == f"{endpoint} accepts any client: leave out {option}"


def test_a_gateway_without_a_zenoh_file_or_with_a_wrong_one_is_not_in_order(settings: Settings) -> None:
    place, file = Reached([ROUTER], []), Path(settings.zenoh.config)
    assert own_fault(Settings(), place).startswith("zenoh.config is not set")
    file.write_text(file.read_text().replace('"default_permission": "deny"', '"default_permission": "allow"'))
    said = "access_control.default_permission is not deny; 'cruiser provision install --replace' writes it"
    assert own_fault(settings, place) == f"{file}: {said}"
    file.unlink()
    assert str(file) in own_fault(settings, place)


def test_what_could_not_be_tried_is_no_sound_router(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("open_session", "close_session"):
        monkeypatch.setattr(self_test, name, lambda *_, **__: None)
    monkeypatch.setattr(self_test, "intrude", lambda *_: Attempt(is_connected=False))
    with pytest.raises(CommandError, match="gets no link"):
        find_hole(settings)
    directory = Path(settings.authority.directory)
    other = ProvisionedFleet(directory.parent / "other").let_in("robot", "cruiser-1")
    (directory / "nothing-tls.pem").write_bytes((other / "nothing-tls.pem").read_bytes())
    with pytest.raises(CommandError, match="does not match the key beside it"):
        find_hole(settings)

"""Roles of certificates: a router denies silently, so the command checks first."""

from pathlib import Path

import pytest

from gateway.authority.enrolment import TransportRole
from recorder.cli.remote import ORDERING, RECORDING, check_recording, check_role
from schemas.command_line import CommandError, ExitCode
from schemas.settings import ZenohSettings
from tests.support.secured import Network

ALL = ["fleet/**"]


@pytest.fixture
def network(tmp_path: Path) -> Network:
    return Network(tmp_path, "tls/127.0.0.1:47447")


def settings(network: Network, role: TransportRole) -> ZenohSettings:
    return ZenohSettings(config=str(network.node(role, "one") / f"{role.value}.json5"))


def refused(one: ZenohSettings, roles: frozenset[str]) -> bool:
    try:
        check_role(one, roles, "others may")
    except CommandError:
        return True
    return False


def test_a_refusal_names_the_certificate(network: Network) -> None:
    one = settings(network, TransportRole.VIEWER)
    file = Path(one.config).with_name("viewer-tls.pem")
    with pytest.raises(CommandError) as caught:
        check_role(one, ORDERING, "others may")
    assert str(caught.value) == f"{file} is a certificate of the role viewer: others may"
    assert caught.value.code is ExitCode.USAGE


def test_each_role_does_what_routers_let_it(network: Network) -> None:
    roles = {role: settings(network, role) for role in TransportRole if role is not TransportRole.NOTHING}
    lets = {
        role.value: [not refused(one, allowed) for allowed in (RECORDING, ORDERING)] for role, one in roles.items()
    }
    assert lets == {
        "robot": [False, False],
        "operator": [False, True],
        "viewer": [False, False],
        "recorder": [True, False],
        "desk": [False, True],
        "router": [True, True],
    }


def test_an_operator_records_single_subjects_alone(network: Network) -> None:
    """With '**' the router would silently deliver nothing."""
    operator = settings(network, TransportRole.OPERATOR)
    with pytest.raises(CommandError, match="by 'cruiser provision recorder NAME', or name"):
        check_recording(operator, ALL)
    check_recording(operator, ["fleet/*/state"])
    check_recording(settings(network, TransportRole.RECORDER), ALL)


def test_of_other_certificates_and_of_none_nothing_is_said(network: Network, tmp_path: Path) -> None:
    one = settings(network, TransportRole.VIEWER)
    certificate = Path(one.config).with_name("viewer-tls.pem")
    for content in (network.certificate, "damaged"):
        certificate.write_text(content)
        check_recording(one, ALL)
    certificate.unlink()
    check_recording(one, ALL)
    own = tmp_path / "own.json5"
    own.write_text("{mode: 'client'}")
    check_recording(ZenohSettings(config=str(own)), ALL)
    check_recording(ZenohSettings(), ALL)

"""What a robot finds of its own keys and rules before anybody engages it. Each hole has to be found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from gateway.authority import admission, self_test
from gateway.authority.lease_key import DriveTags
from gateway.authority.self_test import access_fault, admission_fault
from schemas.authority import trust as trust_module
from schemas.authority.trust import Trust
from schemas.reasons import Reason
from schemas.settings import Settings
from tests.support.authority import Fleet

ACCESS: dict[str, Any] = {
    "enabled": True,
    "default_permission": "deny",
    "subjects": [{"id": "router", "cert_common_names": ["router"]}],
}
TLS: dict[str, Any] = {"enable_mtls": True, "verify_name_on_connect": True}


def test_rules_that_shut_everybody_out_but_the_named_ones_are_sound() -> None:
    """As they are provisioned."""
    assert access_fault(ACCESS, TLS) == ""


@pytest.mark.parametrize(
    ("access", "tls", "said"),
    [
        ({"enabled": False}, {}, "access_control.enabled is not true"),
        ({"enabled": None}, {}, "access_control.enabled is not true"),
        ({"default_permission": "allow"}, {}, "access_control.default_permission is not deny"),
        ({"subjects": None}, {}, "access_control.subjects names nobody"),
        ({"subjects": []}, {}, "access_control.subjects names nobody"),
        ({"subjects": [{"id": "x"}]}, {}, "the subject 'x' of access_control has no cert_common_names"),
        (
            {"subjects": [*ACCESS["subjects"], {"id": "x", "cert_common_names": [], "interfaces": ["lo"]}]},
            {},
            "the subject 'x' of access_control has no cert_common_names, and so is everybody",
        ),
        ({"subjects": ["x"]}, {}, "the subject 'x' of access_control has no cert_common_names"),
        ({}, {"enable_mtls": False}, "transport.link.tls.enable_mtls is not true"),
        ({}, {"enable_mtls": None}, "transport.link.tls.enable_mtls is not true"),
        ({}, {"verify_name_on_connect": False}, "transport.link.tls.verify_name_on_connect is not true"),
    ],
)
def test_each_rule_that_lets_anybody_pass_is_named(access: dict[str, Any], tls: dict[str, Any], said: str) -> None:
    """Zenoh says nothing of any of them."""
    assert access_fault(ACCESS | access, TLS | tls).startswith(said)


@pytest.mark.parametrize("epoch", [0, 7])
def test_a_sound_admission_refuses_what_is_wrongly_signed(epoch: int) -> None:
    """Whatever epoch its authority is in."""
    assert admission_fault(Settings(), msgspec.structs.replace(Fleet().trust, epoch=epoch)) == ""


Break = Callable[[pytest.MonkeyPatch], None]


def everything_fits(patch: pytest.MonkeyPatch) -> None:
    """Signatures of statements verify, whatever they are."""
    patch.setattr(trust_module, "fits", lambda *_: True)
    patch.setattr(trust_module, "is_signed", lambda *_: True)


def nothing_fits(patch: pytest.MonkeyPatch) -> None:
    """No signature of a verb verifies."""
    patch.setattr(admission, "fits", lambda *_: False)


def any_verb_fits(patch: pytest.MonkeyPatch) -> None:
    """Each signature of a verb verifies."""
    patch.setattr(admission, "fits", lambda *_: True)


def any_tag_fits(patch: pytest.MonkeyPatch) -> None:
    """Each tag of a drive command verifies."""
    patch.setattr(DriveTags, "fits", lambda *_: True)


def no_tag_fits(patch: pytest.MonkeyPatch) -> None:
    """No tag of a drive command verifies."""
    patch.setattr(DriveTags, "fits", lambda *_: False)


def no_key_is_agreed(patch: pytest.MonkeyPatch) -> None:
    """The exchange of keys fails."""
    patch.setattr(admission, "lease_key", lambda *_: None)


def nonces_are_forgotten(patch: pytest.MonkeyPatch) -> None:
    """What was received before is new again."""
    patch.setattr(admission, "NONCE_KEPT_NS", -1)


def any_authority_counts(patch: pytest.MonkeyPatch) -> None:
    """The active key is not asked for."""
    judge = Trust.judge
    patch.setattr(Trust, "judge", lambda self, chain, now_s: judge(_of(self, chain[-1].signer), chain, now_s))


def _of(trust: Trust, active: bytes) -> Trust:
    return msgspec.structs.replace(trust, active=active)


@pytest.mark.parametrize(
    ("breaks", "said"),
    [
        (any_authority_counts, "a grant of an authority that is not the robot's is accepted"),
        (everything_fits, "a grant with a wrong signature is accepted"),
        (nothing_fits, "a verb with the right signature is refused"),
        (any_verb_fits, "a verb with a wrong signature is accepted"),
        (nonces_are_forgotten, "a verb is accepted twice"),
        (no_key_is_agreed, "no lease is given for the right signature"),
        (no_tag_fits, "a drive command with the right tag is refused"),
        (any_tag_fits, "a drive command with a wrong tag is accepted"),
    ],
)
def test_a_library_that_verifies_anything_or_nothing_is_found(
    monkeypatch: pytest.MonkeyPatch, breaks: Break, said: str
) -> None:
    """As where it was built wrongly, or the installation is damaged."""
    breaks(monkeypatch)
    assert admission_fault(Settings(), Fleet().trust) == said


def test_a_verb_under_an_unknown_grant_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the robot's own door accepted it."""
    ruling = self_test._Bench.ruling

    def lenient(bench: Any, door: Any, raw: Any) -> Reason:  # noqa: ANN401 - private
        found = ruling(bench, door, raw)
        return Reason.NONE if found is Reason.GRANT_UNKNOWN else found

    monkeypatch.setattr(self_test._Bench, "ruling", lenient)
    assert admission_fault(Settings(), Fleet().trust) == "a verb that an unknown grant signed is accepted"

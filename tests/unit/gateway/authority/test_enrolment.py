"""Requests and bundles: what is proven in them, and that nothing that arrives is believed or raises."""

from __future__ import annotations

import msgspec
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from gateway.authority.enrolment import (
    TEXT_MAX_BYTES,
    Bundle,
    EnrolmentError,
    EnrolmentRole,
    FleetPlace,
    bundle_text,
    chain_of,
    new_request,
    read_bundle,
    read_request,
    request_fingerprint,
)
from schemas.authority.fingerprint import key_fingerprint
from schemas.authority.proof import ProofKind, signed_bytes
from schemas.authority.statement import GrantRole, chain_text
from schemas.authority.trust import AuthorityKeys, fits
from tests.support.authority import NOW_S, Fleet, Party

GRANTED = {
    EnrolmentRole.SITE: GrantRole.SITE,
    EnrolmentRole.ROBOT: GrantRole.ROBOT,
    EnrolmentRole.OPERATOR: GrantRole.OPERATOR,
    EnrolmentRole.RECORDER: GrantRole.RECORDER,
}
PLACE = FleetPlace("fleet", ["tls/router.example:7447"])


def bundle_for(fleet: Fleet, party: Party, role: EnrolmentRole, signer: Party | None = None) -> Bundle:
    """What somebody gets who has this chain."""
    return Bundle(
        role=role,
        name=party.name,
        authority=AuthorityKeys(fleet.authority.key.hex(), fleet.standby.key.hex()),
        fleet=PLACE,
        certificate="certificate",
        ca="ca",
        chain=chain_text(party.chain),
        signer="" if signer is None else chain_text(signer.chain),
    )


def refusal(text: bytes, now_s: int = NOW_S) -> str:
    """Why it is no bundle that holds."""
    with pytest.raises(EnrolmentError) as caught:
        read_bundle(text, now_s)
    return str(caught.value)


@pytest.mark.parametrize("role", list(EnrolmentRole))
def test_a_request_is_read_as_it_was_made(role: EnrolmentRole) -> None:
    """Who is granted something has a key in it, who is not has none."""
    private = Ed25519PrivateKey.generate() if role in GRANTED else None
    assert role.is_granted == (role in GRANTED)
    request = new_request(role, ["one-1"], "csr", private)
    assert read_request(msgspec.json.format(msgspec.json.encode(request))) == request
    assert request_fingerprint(request) == request_fingerprint(read_request(msgspec.json.encode(request)))
    with pytest.raises(EnrolmentError, match="and has a key" if private is None else "has no key"):
        new_request(role, ["one-1"], "csr", Ed25519PrivateKey.generate() if private is None else None)


@pytest.mark.parametrize(
    ("role", "names"),
    [
        (EnrolmentRole.ROBOT, ["Cruiser"]),
        (EnrolmentRole.ROBOT, ["cruiser_1"]),
        (EnrolmentRole.RECORDER, ["depot.1"]),
        (EnrolmentRole.OPERATOR, ["::1"]),
        (EnrolmentRole.OPERATOR, ["ann", "bea"]),
        (EnrolmentRole.SITE, []),
    ],
)
def test_a_name_is_of_the_form_that_keys_have(role: EnrolmentRole, names: list[str]) -> None:
    """Of a robot and a recorder, of an operator; one, where it stands in a grant."""
    with pytest.raises(EnrolmentError):
        new_request(role, names, "csr", Ed25519PrivateKey.generate())


@pytest.mark.parametrize(
    "changed", [{"role": EnrolmentRole.SITE}, {"names": ["bea"]}, {"csr": "another"}, {"proof": "00" * 64}]
)
def test_the_proof_of_a_request_covers_each_field(changed: dict[str, object]) -> None:
    """By itself, whatever else is held against it."""
    request = new_request(EnrolmentRole.OPERATOR, ["ann"], "csr", Ed25519PrivateKey.generate())
    with pytest.raises(EnrolmentError, match="not signed by its own key"):
        read_request(msgspec.json.encode(msgspec.structs.replace(request, **changed)))


def test_a_request_that_is_too_long_is_refused_although_it_is_proven() -> None:
    """An authority keeps what it signs."""
    with pytest.raises(EnrolmentError, match="longer than"):
        new_request(EnrolmentRole.OPERATOR, ["ann"], "x" * TEXT_MAX_BYTES, Ed25519PrivateKey.generate())


def test_a_bundles_signature_is_one_of_nothing_else() -> None:
    """No statement, and no request: the text under it says that it is a bundle."""
    fleet, party = Fleet(), Party("ann")
    fleet.authority.grant(party)
    text = bundle_text(bundle_for(fleet, party, EnrolmentRole.OPERATOR), fleet.authority.private)
    body, _, proof = text.rstrip(b"\n").partition(b"\n")
    signature = bytes.fromhex(proof.split()[2].decode())
    assert fits(fleet.authority.key, signature, signed_bytes(ProofKind.STATEMENT, b"bundle", body))


def test_fingerprints_are_of_128_bits() -> None:
    """Eight groups, and another for another key."""
    one, two = key_fingerprint("00" * 32), key_fingerprint("01" * 32)
    assert one == "6668-7aad-f862-bd77-6c8f-c18b-8e9f-8e20"
    assert one != two


@pytest.mark.parametrize("role", GRANTED)
def test_a_bundle_of_the_authority_holds(role: EnrolmentRole) -> None:
    """For each role that is granted something, with a grant of this role and no other."""
    fleet, party = Fleet(), Party("one-1")
    fleet.authority.grant(party, role=GRANTED[role])
    bundle = bundle_for(fleet, party, role)
    assert read_bundle(bundle_text(bundle, fleet.authority.private), NOW_S) == bundle
    for other in set(GRANTED) - {role}:
        text = bundle_text(msgspec.structs.replace(bundle, role=other), fleet.authority.private)
        assert "its grant is of one-1" in refusal(text)
    renamed = bundle_text(msgspec.structs.replace(bundle, name="two-2"), fleet.authority.private)
    assert "its grant is of one-1" in refusal(renamed)
    over = refusal(bundle_text(bundle, fleet.authority.private), NOW_S + 10 * 86_400)
    assert "its grant does not hold" in over


def test_a_site_makes_bundles_for_people_alone() -> None:
    """Under a grant that holds. Nobody else does."""
    fleet = Fleet()
    site = fleet.site()
    viewer = msgspec.structs.replace(bundle_for(fleet, Party("hall"), EnrolmentRole.VIEWER, site), chain="")
    assert read_bundle(bundle_text(viewer, site.private), NOW_S) == viewer
    for role in (EnrolmentRole.ROUTER, EnrolmentRole.DESK):
        text = bundle_text(msgspec.structs.replace(viewer, role=role), site.private)
        assert refusal(text) == "it is signed by nobody who may make one"
    ann = fleet.operator()
    person = msgspec.structs.replace(viewer, signer=chain_text(ann.chain))
    assert refusal(bundle_text(person, ann.private)) == "it is signed by nobody who may make one"
    assert refusal(bundle_text(viewer, ann.private)) == "it is signed by nobody who may make one"
    late = refusal(bundle_text(viewer, site.private), NOW_S + 10 * 86_400)
    assert "the grant of the site that made it does not hold" in late
    foreign = msgspec.structs.replace(viewer, signer="x")
    assert "cannot be read" in refusal(bundle_text(foreign, site.private))
    unsigned = msgspec.structs.replace(viewer, signer="")
    assert refusal(bundle_text(unsigned, site.private)) == "it is not signed by the authority that it names"


def test_a_bundle_that_was_changed_holds_no_more() -> None:
    """Any bit of it."""
    fleet, party = Fleet(), Party("ann")
    fleet.authority.grant(party)
    whole = bundle_text(bundle_for(fleet, party, EnrolmentRole.OPERATOR), fleet.authority.private)
    for place in range(len(whole) - 1):
        refusal(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
    assert refusal(whole.partition(b"\n")[0]) == "it is not signed"


@given(st.binary(max_size=300) | st.text(max_size=200).map(str.encode))
def test_whatever_comes_is_refused_with_words(text: bytes) -> None:
    """A request, a bundle, a statement: never another exception."""
    for read in (read_request, chain_of, lambda one: read_bundle(one, NOW_S)):
        with pytest.raises(EnrolmentError):
            read(text)


@pytest.mark.parametrize("text", [b"[" * 60_000, b"{" * 70_000, b'{"role":' * 5000])
def test_what_is_deep_or_long_is_refused_with_words(text: bytes) -> None:
    """JSON that is nested, and more than any request has."""
    for read in (read_request, chain_of, lambda one: read_bundle(one, NOW_S)):
        with pytest.raises(EnrolmentError):
            read(text)


def test_a_statement_is_found_in_its_file_and_a_grant_in_its_bundle() -> None:
    """Both are shown to robots with the same command."""
    fleet, party = Fleet(), Party("ann")
    fleet.authority.grant(party)
    text = chain_text(party.chain).encode()
    bundle = bundle_text(bundle_for(fleet, party, EnrolmentRole.OPERATOR), fleet.authority.private)
    assert chain_text(chain_of(text)).encode() == text
    assert chain_text(chain_of(bundle)).encode() == text


def test_a_person_alone_asks_for_a_grant_without_a_certificate() -> None:
    """A browser does: its desk has the certificate."""
    private = Ed25519PrivateKey.generate()
    request = new_request(EnrolmentRole.OPERATOR, ["ann"], "", private)
    assert read_request(msgspec.json.encode(request)).csr == ""
    for role in (EnrolmentRole.ROBOT, EnrolmentRole.RECORDER, EnrolmentRole.SITE):
        with pytest.raises(EnrolmentError, match="needs a certificate"):
            new_request(role, ["ann"], "", private)
    for role in (EnrolmentRole.VIEWER, EnrolmentRole.ROUTER, EnrolmentRole.DESK):
        with pytest.raises(EnrolmentError, match="needs a certificate"):
            new_request(role, ["ann"], "", None)

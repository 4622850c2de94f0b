"""Requests, bundles, and the Zenoh configuration of each role."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from pathlib import PurePosixPath
from typing import Any

import msgspec
import pytest
import zenoh
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.authority.enrolment import (
    ENROLLED,
    Bundle,
    EnrolmentError,
    EnrolmentRequest,
    FleetPlace,
    TransportRole,
    access_table,
    authority_fingerprint,
    bundle_text,
    chain_of,
    new_request,
    read_bundle,
    read_request,
    request_fingerprint,
    zenoh_configuration,
)
from gateway.provisioning.key_files import new_key
from gateway.provisioning.key_files import new_request as new_csr
from schemas.authority.proof import GrantRole, chain_text
from schemas.authority.trust import AuthorityKeys, keys_fingerprint
from schemas.subjects import COMMANDS
from tests.support.access import PUTS, QUERIES, ROBOTS, ROLES, SUBSCRIPTIONS, TOKENS, R
from tests.support.authority import NOW_S, Fleet, Party

GRANTED = {
    TransportRole.ROBOT: GrantRole.ROBOT,
    TransportRole.OPERATOR: GrantRole.OPERATOR,
    TransportRole.RECORDER: GrantRole.RECORDER,
}
PLACE = FleetPlace("fleet", ["tls/router.example:7447"])


def bundle_for(fleet: Fleet, party: Party, role: TransportRole) -> Bundle:
    return Bundle(
        role=role,
        name=party.name,
        authority=AuthorityKeys(fleet.authority.key.hex(), fleet.standby.key.hex()),
        fleet=PLACE,
        certificate="certificate",
        ca="ca",
        chain=chain_text(party.chain),
    )


def made_for(
    name: str = "ann", role: TransportRole = TransportRole.OPERATOR
) -> tuple[Fleet, Party, Bundle, bytes]:
    fleet, party = Fleet(), Party(name)
    fleet.authority.grant(party, role=GRANTED[role])
    bundle = bundle_for(fleet, party, role)
    return fleet, party, bundle, bundle_text(bundle, fleet.authority.private)


def refusal(text: bytes, now_s: int = NOW_S) -> str:
    with pytest.raises(EnrolmentError) as caught:
        read_bundle(text, now_s)
    return str(caught.value)


TLS = new_key()


def asked(
    role: TransportRole,
    names: list[str],
    private: Ed25519PrivateKey | None,
    tls: ec.EllipticCurvePrivateKey = TLS,
) -> EnrolmentRequest:
    return new_request(role, names, new_csr(tls, role.value, names or ["nobody"]), private, tls)


@pytest.mark.parametrize("role", ENROLLED)
def test_a_request_is_read_as_it_was_made(role: TransportRole) -> None:
    private = Ed25519PrivateKey.generate() if role in GRANTED else None
    assert role.is_granted == (role in GRANTED)
    request = asked(role, ["one-1"], private)
    assert read_request(msgspec.json.format(msgspec.json.encode(request))) == request
    assert request_fingerprint(request) == request_fingerprint(read_request(msgspec.json.encode(request)))
    with pytest.raises(EnrolmentError, match="the request has a key" if private is None else "has no key"):
        asked(role, ["one-1"], Ed25519PrivateKey.generate() if private is None else None)


@pytest.mark.parametrize(
    ("role", "names"),
    [
        (TransportRole.ROBOT, ["Cruiser"]),
        (TransportRole.ROBOT, ["cruiser_1"]),
        (TransportRole.RECORDER, ["depot.1"]),
        (TransportRole.OPERATOR, ["::1"]),
        (TransportRole.OPERATOR, ["ann", "bea"]),
        (TransportRole.OPERATOR, []),
    ],
)
def test_a_name_is_of_the_form_that_keys_have(role: TransportRole, names: list[str]) -> None:
    with pytest.raises(EnrolmentError):
        asked(role, names, Ed25519PrivateKey.generate())


ANNS, OTHER_TLS = Ed25519PrivateKey.generate(), new_key()
OTHER = asked(TransportRole.OPERATOR, ["ann"], Ed25519PrivateKey.generate(), OTHER_TLS)
CHANGES: dict[str, list[object]] = {
    "version": [1, 3],
    "role": [TransportRole.RECORDER, TransportRole.ROBOT, TransportRole.VIEWER, TransportRole.NOTHING],
    "names": [["bea"], ["ann", "bea"], [], ["ann\n"]],
    "csr": [OTHER.csr, new_csr(TLS, "operator", ["ann"]), "another", ""],
    "key": [OTHER.key, None],
    "proof": [OTHER.proof, None, "00" * 64],
    "csr_proof": [OTHER.csr_proof, None, "00" * 64],
}
"""What else each field of a request may hold."""


@pytest.mark.parametrize(
    "made",
    [asked(TransportRole.OPERATOR, ["ann"], ANNS), new_request(TransportRole.OPERATOR, ["ann"], "", ANNS, None)],
    ids=["command", "browser"],
)
@pytest.mark.parametrize("field", EnrolmentRequest.__struct_fields__)
def test_no_field_of_a_request_can_be_changed_unseen(field: str, made: EnrolmentRequest) -> None:
    for value in CHANGES[field]:
        changed = msgspec.structs.replace(made, **{field: value})
        if changed == made:
            continue
        with pytest.raises(EnrolmentError):
            read_request(msgspec.json.encode(changed))
        if field not in {"version", "proof", "csr_proof"}:
            assert request_fingerprint(changed) != request_fingerprint(made)


def test_whoever_carries_a_request_puts_no_key_of_theirs_into_it() -> None:
    request, thief = asked(TransportRole.OPERATOR, ["ann"], ANNS), Ed25519PrivateKey.generate()
    stolen = msgspec.structs.replace(request, key=thief.public_key().public_bytes_raw().hex())
    stolen = msgspec.structs.replace(stolen, proof=thief.sign(stolen.signed()).hex())
    with pytest.raises(EnrolmentError, match="not signed by the key of its certificate"):
        read_request(msgspec.json.encode(stolen))
    stolen = msgspec.structs.replace(request, csr=new_csr(OTHER_TLS, "operator", ["ann"]))
    signature = OTHER_TLS.sign(stolen.signed(), ec.ECDSA(SHA256())).hex()
    with pytest.raises(EnrolmentError, match="not signed by its own key"):
        read_request(msgspec.json.encode(msgspec.structs.replace(stolen, csr_proof=signature)))
    browsers = new_request(TransportRole.OPERATOR, ["ann"], "", ANNS, None)
    thiefs = new_request(TransportRole.OPERATOR, ["ann"], "", thief, None)
    assert request_fingerprint(browsers) != request_fingerprint(thiefs)


@pytest.mark.parametrize("change", [lambda text: f"{text}\n", lambda text: f" {text}", str.upper])
@pytest.mark.parametrize("field", ["key", "proof", "csr_proof"])
def test_a_key_and_a_signature_are_written_in_one_way(field: str, change: Callable[[str], str]) -> None:
    """Otherwise one key could appear as several, one of them revoked and the others not."""
    made = asked(TransportRole.OPERATOR, ["ann"], ANNS)
    other = msgspec.structs.replace(made, **{field: change(getattr(made, field))})
    with pytest.raises(EnrolmentError, match="matching regex"):
        read_request(msgspec.json.encode(other))


def test_a_request_of_a_former_version_is_refused_with_the_cure() -> None:
    """Its fingerprint did not cover the key."""
    text = (
        b'{"role":"operator","names":["ann"],"csr":"","key":"' + b"00" * 32 + b'","proof":"' + b"00" * 64 + b'"}'
    )
    with pytest.raises(EnrolmentError, match=r"of version 1, .* 'cruiser provision renew operator'"):
        read_request(text)


def test_no_field_of_an_authority_can_be_changed_unseen() -> None:
    keys, other = AuthorityKeys("00" * 32, "01" * 32), "02" * 32
    replace = msgspec.structs.replace
    shown = [
        authority_fingerprint(keys, PLACE, "ca"),
        authority_fingerprint(replace(keys, active=other), PLACE, "ca"),
        authority_fingerprint(replace(keys, standby=other), PLACE, "ca"),
        authority_fingerprint(AuthorityKeys(keys.standby, keys.active), PLACE, "ca"),
        authority_fingerprint(keys, PLACE, "ca2"),
        authority_fingerprint(keys, replace(PLACE, root="fleet2"), "ca"),
        authority_fingerprint(keys, replace(PLACE, routers=["tls/thief.example:7447"]), "ca"),
        authority_fingerprint(keys, replace(PLACE, routers=[*PLACE.routers, "tls/thief.example:7447"]), "ca"),
        keys_fingerprint(keys),
        keys_fingerprint(replace(keys, active=other)),
        keys_fingerprint(replace(keys, standby=other)),
        keys_fingerprint(AuthorityKeys(keys.standby, keys.active)),
    ]
    assert len(set(shown)) == len(shown)
    assert AuthorityKeys.__struct_fields__ == ("active", "standby")
    assert FleetPlace.__struct_fields__ == ("root", "routers")


@pytest.mark.parametrize("role", GRANTED)
def test_a_bundle_of_the_authority_holds(role: TransportRole) -> None:
    fleet, _, bundle, made = made_for("one-1", role)
    assert read_bundle(made, NOW_S) == bundle
    for other in set(GRANTED) - {role}:
        text = bundle_text(msgspec.structs.replace(bundle, role=other), fleet.authority.private)
        assert "its grant is for one-1" in refusal(text)
    renamed = bundle_text(msgspec.structs.replace(bundle, name="two-2"), fleet.authority.private)
    assert "its grant is for one-1" in refusal(renamed)
    assert "its grant is not valid" in refusal(made, NOW_S + 10 * 86_400)


def test_a_bundle_that_was_changed_holds_no_more() -> None:
    _, _, _, whole = made_for()
    for place in range(len(whole) - 1):
        refusal(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
    assert refusal(whole.partition(b"\n")[0]) == "it is not signed"


@pytest.mark.parametrize("field", [name for name in Bundle.__struct_fields__ if name != "signer"])
def test_no_field_of_a_bundle_can_be_changed_unseen(field: str) -> None:
    (_, party, bundle, whole), thieves = made_for(), Fleet()
    others = msgspec.structs.replace(
        bundle_for(thieves, Party("bea"), TransportRole.VIEWER),
        fleet=FleetPlace("fleet", ["tls/thief.example:7447"]),
        certificate="another",
        shut_out="another",
        ca="another",
    )
    changed = msgspec.structs.replace(bundle, **{field: "" if field == "chain" else getattr(others, field)})
    assert changed != bundle
    refusal(msgspec.json.encode(changed) + b"\n" + whole.partition(b"\n")[2])
    refusal(bundle_text(changed, thieves.authority.private))
    thieves.authority.grant(party)
    its_own = {"authority": others.authority, "chain": chain_text(party.chain)}
    forged = msgspec.structs.replace(bundle, **({field: getattr(others, field)} | its_own))
    assert forged.fingerprint != bundle.fingerprint


@given(st.binary(max_size=300) | st.text(max_size=200).map(str.encode))
@example(b"[" * 60_000)
@example(b"{" * 70_000)
@example(b'{"role":' * 5000)
def test_whatever_comes_is_refused_with_words(text: bytes) -> None:
    for read in (read_request, chain_of, lambda one: read_bundle(one, NOW_S)):
        with pytest.raises(EnrolmentError):
            read(text)


def test_a_person_alone_asks_for_a_grant_without_a_certificate() -> None:
    private = Ed25519PrivateKey.generate()
    request = new_request(TransportRole.OPERATOR, ["ann"], "", private, None)
    assert read_request(msgspec.json.encode(request)).csr == ""
    for role in set(ENROLLED) - {TransportRole.OPERATOR}:
        with pytest.raises(EnrolmentError, match="needs a certificate"):
            new_request(role, ["ann"], "", private if role in GRANTED else None, None)
    with pytest.raises(EnrolmentError, match="not a request: role nothing"):
        asked(TransportRole.NOTHING, ["hall"], None)


# The Zenoh configuration of each role: what holds for all. What they let through is tested through a router.

DIRECTORY = PurePosixPath("/etc/cruiser")
ENDPOINT = "tls/router.example:7447"
every_role = pytest.mark.parametrize("role", [role for role in TransportRole if role is not TransportRole.NOTHING])


def configuration(role: TransportRole) -> dict[str, Any]:
    robot = "cruiser-1" if role is TransportRole.ROBOT else ""
    made: dict[str, Any] = json.loads(json.dumps(zenoh_configuration(role, "fleet", DIRECTORY, [ENDPOINT], robot)))
    return made


@every_role
def test_everything_is_denied_that_is_not_allowed(role: TransportRole) -> None:
    """A subject without names would match every node."""
    access = configuration(role)["access_control"]
    assert (access["enabled"], access["default_permission"]) == (True, "deny")
    assert all(subject["cert_common_names"] for subject in access["subjects"])
    assert {rule["permission"] for rule in access["rules"]} == {"allow"}
    assert all(rule["key_exprs"] and rule["messages"] and rule["flows"] for rule in access["rules"])
    rows = {row.id: row for row in access_table("fleet", "cruiser-1" if role is TransportRole.ROBOT else "*")}
    # At the other end of a link its flows are turned.
    turned = {} if role is TransportRole.ROUTER else {"ingress": "egress", "egress": "ingress"}
    for rule in access["rules"]:
        row = rows[rule["id"]]
        assert rule["flows"] == [turned.get(row.flow, row.flow)]
        assert (rule["messages"], rule["key_exprs"]) == (list(row.messages), list(dict.fromkeys(row.keys)))
        assert role is TransportRole.ROUTER or role in row.roles
    used = {name for policy in access["policies"] for name in policy["rules"]}
    assert used == {rule["id"] for rule in access["rules"]}
    assert {name for policy in access["policies"] for name in policy["subjects"]} == {
        subject["id"] for subject in access["subjects"]
    }


@every_role
def test_links_are_mutual_tls_alone(role: TransportRole) -> None:
    link = configuration(role)["transport"]["link"]
    assert link["protocols"] == ["tls"]
    assert link["rx"] == {"max_message_size": 1_048_576}
    own = (f"/etc/cruiser/{role.value}-tls.pem", f"/etc/cruiser/{role.value}-tls.key")
    listens = role in {TransportRole.ROUTER, TransportRole.DESK}
    listen = {"listen_certificate": own[0], "listen_private_key": own[1]} if listens else {}
    assert link["tls"] == listen | {
        "root_ca_certificate": "/etc/cruiser/ca.pem",
        "connect_certificate": own[0],
        "connect_private_key": own[1],
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }


@every_role
def test_all_but_the_router_dial_out_and_listen_on_nothing(role: TransportRole) -> None:
    made = configuration(role)
    is_router = role is TransportRole.ROUTER
    assert made["mode"] == ("router" if is_router else "client")
    assert made["connect"]["endpoints"] == ([] if is_router else [ENDPOINT])
    assert made["listen"]["endpoints"] == ([ENDPOINT] if is_router else [])
    assert made["scouting"]["multicast"]["enabled"] is False


@every_role
def test_no_filter_is_on_a_stop(role: TransportRole) -> None:
    limits = configuration(role)["low_pass_filter"]
    expressions = [zenoh.KeyExpr(key) for limit in limits for key in limit["key_exprs"]]
    stops = [
        zenoh.KeyExpr(f"fleet/{robot}/@cmd/{who}/stop") for robot in ("cruiser-1", "*") for who in ("ann", "*")
    ]
    assert not [one for one in expressions for stop in stops if one.intersects(stop)]
    verbs = [command.verb for command in COMMANDS if command.verb != "stop"]
    limited = [zenoh.KeyExpr(f"fleet/cruiser-1/@cmd/ann/{verb}") for verb in verbs]
    assert all(any(one.includes(key) for one in expressions) for key in limited)


def test_people_have_no_double_wildcard() -> None:
    """It would allow any number of subscriptions, except for histories below one subject each."""
    people = {TransportRole.OPERATOR, TransportRole.VIEWER, TransportRole.DESK}
    keys = {key for row in access_table("fleet") if people & set(row.roles) for key in row.keys}
    assert not [key for key in keys if "**" in key.replace("/@adv/**", "")]


def test_a_robots_file_names_no_other_robot() -> None:
    rows = [row for row in access_table("fleet", "cruiser-1") if TransportRole.ROBOT in row.roles]
    taken = {key for row in rows if row.flow == "egress" and "put" in row.messages for key in row.keys}
    assert {key.split("/")[-1] for key in taken if key.startswith("fleet/*/")} == {"stop"}
    said = {key for row in rows if row.flow == "ingress" for key in row.keys}
    assert all(key.startswith("fleet/cruiser-1/") for key in said)


@pytest.mark.parametrize("endpoints", [[], ["tcp/router.example:7447"], [ENDPOINT, "udp/router.example:7447"]])
def test_an_endpoint_without_certificates_is_refused(endpoints: list[str]) -> None:
    """Plain TCP in a provisioned file would admit any client."""
    with pytest.raises(ValueError, match=r"tls|no endpoint"):
        zenoh_configuration(TransportRole.ROBOT, "fleet", DIRECTORY, endpoints, "cruiser-1")


def who_may(flow: str, message: str, key: str) -> set[str]:
    """The parties whose message passes the router, by Zenoh's own key expressions."""
    rows = [row for row in access_table("fleet") if row.flow == flow and message in row.messages]
    return {
        name for name, role in ROLES.items() if any(role in row.roles and _includes(row.keys, key) for row in rows)
    }


def _includes(expressions: Iterable[str], key: str) -> bool:
    return any(zenoh.KeyExpr(one).includes(zenoh.KeyExpr(key)) for one in expressions)


def test_the_table_is_the_oracle_of_the_tests_through_a_real_router() -> None:
    assert {key: who_may("ingress", "put", key) for key in PUTS} == PUTS
    assert {key: who_may("ingress", "declare_subscriber", key) for key in SUBSCRIPTIONS} == SUBSCRIPTIONS
    assert {key: who_may("ingress", "liveliness_token", key) for key in TOKENS} == TOKENS
    assert not any(who_may("ingress", "delete", key) for key in PUTS)
    own = [row for row in access_table("fleet", "cruiser-1") if TransportRole.ROBOT in row.roles]
    for key, askers in QUERIES.items():
        # A robot replies under its own name, also to a query for many.
        reply = re.sub(r"^fleet/c?\$?\*/", f"{R}/", key)
        reaches = any("query" in row.messages and row.flow == "egress" and _includes(row.keys, key) for row in own)
        replies = any(
            "reply" in row.messages and row.flow == "ingress" and _includes(row.keys, reply) for row in own
        )
        answered = who_may("ingress", "query", key) & who_may("egress", "reply", reply)
        # The router does not know the robots' names: each may query its own.
        robots = ROBOTS if key.endswith("gateway/info") else set()
        assert (answered if reaches and replies else set()) | robots == askers | robots, key
    for key, said_by in TOKENS.items():
        for message, flow in (("liveliness_query", "ingress"), ("liveliness_token", "egress")):
            assert ({"recorder", "operator"} <= who_may(flow, message, key)) == bool(said_by)
    names = [row.id for row in access_table("fleet")]
    assert len(set(names)) == len(names)

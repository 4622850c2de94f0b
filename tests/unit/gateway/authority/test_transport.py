"""The Zenoh configuration of each role: what holds for all. What they let through is tested through a router."""

from __future__ import annotations

import json
from pathlib import PurePosixPath
from typing import Any

import pytest
import zenoh

from gateway.authority.enrolment import TransportRole, access_table, zenoh_configuration
from schemas.subjects import COMMANDS, SUBJECTS

PLACE = PurePosixPath("/etc/cruiser")
ENDPOINT = "tls/router.example:7447"
every_role = pytest.mark.parametrize("role", [role for role in TransportRole if role is not TransportRole.NOTHING])


def configuration(role: TransportRole) -> dict[str, Any]:
    """The configuration of a node, as a file would hold it."""
    robot = "cruiser-1" if role is TransportRole.ROBOT else ""
    made: dict[str, Any] = json.loads(json.dumps(zenoh_configuration(role, "fleet", PLACE, [ENDPOINT], robot)))
    return made


@every_role
def test_everything_is_denied_that_is_not_allowed(role: TransportRole) -> None:
    """Every subject has names, for one without is everybody; every rule is used, allows, and has keys."""
    access = configuration(role)["access_control"]
    assert (access["enabled"], access["default_permission"]) == (True, "deny")
    assert all(subject["cert_common_names"] for subject in access["subjects"])
    assert {rule["permission"] for rule in access["rules"]} == {"allow"}
    assert all(rule["key_exprs"] and rule["messages"] and rule["flows"] for rule in access["rules"])
    used = {name for policy in access["policies"] for name in policy["rules"]}
    assert used == {rule["id"] for rule in access["rules"]}
    assert {name for policy in access["policies"] for name in policy["subjects"]} == {
        subject["id"] for subject in access["subjects"]
    }


@every_role
def test_a_file_has_the_rules_of_its_role(role: TransportRole) -> None:
    """All of the table's, and no other. Its flows are the router's: at the other end of a link they are turned."""
    access = configuration(role)["access_control"]
    robot = "cruiser-1" if role is TransportRole.ROBOT else "*"
    is_router = role is TransportRole.ROUTER
    table = {row.id: row for row in access_table("fleet", robot) if is_router or role in row.roles}
    assert {rule["id"]: rule["key_exprs"] for rule in access["rules"]} == {
        name: list(dict.fromkeys(row.keys)) for name, row in table.items()
    }
    turned = {"ingress": "egress", "egress": "ingress"}
    for rule in access["rules"]:
        flow = table[rule["id"]].flow
        assert rule["flows"] == [flow if is_router else turned[flow]]
    granted = {policy["subjects"][0]: set(policy["rules"]) for policy in access["policies"]}
    if is_router:
        assert granted == {
            one.value: {name for name, row in table.items() if one in row.roles}
            for row in table.values()
            for one in row.roles
        }
    else:
        assert granted == {"router": set(table)}


@every_role
def test_links_are_mutual_tls_alone(role: TransportRole) -> None:
    """Both ends show certificates, names are held against them, a link ends with its certificate."""
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
def test_zenoh_takes_the_file_and_its_admin_space_is_closed(role: TransportRole) -> None:
    """An unknown name or value would be an error; Zenoh's own start value lets everybody read what is on."""
    config = zenoh.Config.from_json5(json.dumps(configuration(role)))
    assert json.loads(config.get_json("access_control/enabled")) is True
    closed = {"enabled": False, "permissions": {"read": False, "write": False}}
    assert json.loads(config.get_json("adminspace")) == closed


@every_role
def test_all_but_the_router_dial_out_and_listen_on_nothing(role: TransportRole) -> None:
    """And nobody looks for others by multicast."""
    made = configuration(role)
    is_router = role is TransportRole.ROUTER
    assert made["mode"] == ("router" if is_router else "client")
    assert made["connect"]["endpoints"] == ([] if is_router else [ENDPOINT])
    assert made["listen"]["endpoints"] == ([ENDPOINT] if is_router else [])
    assert made["scouting"]["multicast"]["enabled"] is False


@every_role
def test_no_filter_is_on_a_stop(role: TransportRole) -> None:
    """No size limit includes its key, of one robot or of all."""
    limits = configuration(role)["low_pass_filter"]
    expressions = [zenoh.KeyExpr(key) for limit in limits for key in limit["key_exprs"]]
    stops = [
        zenoh.KeyExpr(f"fleet/{robot}/@cmd/{who}/stop") for robot in ("cruiser-1", "*") for who in ("ann", "*")
    ]
    assert not [one for one in expressions for stop in stops if one.intersects(stop)]
    verbs = [command.verb for command in COMMANDS if command.verb != "stop"]
    limited = [zenoh.KeyExpr(f"fleet/cruiser-1/@cmd/ann/{verb}") for verb in verbs]
    assert all(any(one.includes(key) for one in expressions) for key in limited)


def test_every_subject_of_the_table_can_be_published_and_seen() -> None:
    """A subject that is new is in, also its history."""
    published, seen = (
        [
            zenoh.KeyExpr(key)
            for row in access_table("fleet")
            if role in row.roles and message in row.messages and row.flow == flow
            for key in row.keys
        ]
        for role, message, flow in (
            (TransportRole.ROBOT, "put", "ingress"),
            (TransportRole.VIEWER, "put", "egress"),
        )
    )
    for subject in SUBJECTS:
        key = f"fleet/cruiser-1/{subject.name.format(bus='can0')}"
        wanted = [key, *([f"{key}/@adv/pub/1/2/_"] if subject.qos.history else [])]
        for one in map(zenoh.KeyExpr, wanted):
            assert any(expression.includes(one) for expression in published), one
            assert any(expression.includes(one) for expression in seen), one


def test_people_have_no_double_wildcard() -> None:
    """It would let them declare subscriptions without end, but for histories, below one subject each."""
    people = {TransportRole.OPERATOR, TransportRole.VIEWER, TransportRole.DESK}
    keys = {key for row in access_table("fleet") if people & set(row.roles) for key in row.keys}
    assert not [key for key in keys if "**" in key.replace("/@adv/**", "")]


def test_a_robots_file_names_no_other_robot() -> None:
    """What it takes is for itself, but for stops and statements, which may be for all."""
    rows = [row for row in access_table("fleet", "cruiser-1") if TransportRole.ROBOT in row.roles]
    taken = {key for row in rows if row.flow == "egress" and "put" in row.messages for key in row.keys}
    assert {key.split("/")[-1] for key in taken if key.startswith("fleet/*/")} == {"stop"}
    said = {key for row in rows if row.flow == "ingress" for key in row.keys}
    assert all(key.startswith("fleet/cruiser-1/") for key in said)


@pytest.mark.parametrize("endpoints", [[], ["tcp/router.example:7447"], [ENDPOINT, "udp/router.example:7447"]])
def test_an_endpoint_without_certificates_is_refused(endpoints: list[str]) -> None:
    """Plain TCP in a provisioned file would let anybody in."""
    with pytest.raises(ValueError, match=r"tls|no endpoint"):
        zenoh_configuration(TransportRole.ROBOT, "fleet", PLACE, endpoints, "cruiser-1")

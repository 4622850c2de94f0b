"""The table of access by role, against the oracle that the tests through real routers have too.

Zenoh lets pass what a rule's key expression includes; here its own key expressions say so, without a router.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import pytest
import zenoh

from gateway.authority.enrolment import AccessRow, TransportRole, access_table
from tests.support.access import OTHER, PUTS, QUERIES, ROBOT, ROLES, SUBSCRIPTIONS, TOKENS, R


def lets_pass(
    role: TransportRole, flow: str, message: str, key: str, table: Sequence[AccessRow] | None = None
) -> bool:
    """Does a row for this role, by default of the router, let this message pass? The flow is the router's."""
    expressions = (
        expression
        for row in table or access_table("fleet")
        if role in row.roles and row.flow == flow and message in row.messages
        for expression in row.keys
    )
    return any(zenoh.KeyExpr(one).includes(zenoh.KeyExpr(key)) for one in expressions)


def senders(flow: str, message: str, keys: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The parties whose message passes, by its key."""
    return {key: {name for name, role in ROLES.items() if lets_pass(role, flow, message, key)} for key in keys}


def test_who_may_put_on_which_key() -> None:
    """Whoever may sends what passes the router; what is for a robot goes out to it, and nothing else."""
    assert senders("ingress", "put", PUTS) == PUTS
    assert senders("ingress", "delete", PUTS) == {key: set() for key in PUTS}


@pytest.mark.parametrize("key", QUERIES)
def test_whose_query_is_answered(key: str) -> None:
    """It passes on the way in, on the way out to the robot, and so does the reply, both ways."""
    robot, of_robot = TransportRole.ROBOT, access_table("fleet", "cruiser-1")
    # Whoever is asked as one of many replies under its own name.
    reply = re.sub(r"^fleet/c?\$?\*/", f"{R}/", key)
    answered = {
        name
        for name, role in ROLES.items()
        if lets_pass(role, "ingress", "query", key)
        and lets_pass(robot, "egress", "query", key, of_robot)
        and lets_pass(robot, "ingress", "reply", reply, of_robot)
        and lets_pass(role, "egress", "reply", reply)
    }
    # The table of the router does not know robots' names: each may ask for its own.
    own = {ROBOT, OTHER} if key.endswith("gateway/info") else set()
    assert answered | own == QUERIES[key] | own


@pytest.mark.parametrize("key", SUBSCRIPTIONS)
def test_who_may_subscribe_to_what(key: str) -> None:
    """Nobody but robots subscribes to commands, and nobody to everything there is."""
    assert {
        name for name, role in ROLES.items() if lets_pass(role, "ingress", "declare_subscriber", key)
    } == SUBSCRIPTIONS[key]


def test_whose_token_says_that_somebody_is_there() -> None:
    """A gateway's and a recorder's; people look for them, and find them."""
    assert senders("ingress", "liveliness_token", TOKENS) == TOKENS
    for key, said_by in TOKENS.items():
        for message, flow in (("liveliness_query", "ingress"), ("liveliness_token", "egress")):
            assert lets_pass(TransportRole.RECORDER, flow, message, key) == bool(said_by)
            assert lets_pass(TransportRole.OPERATOR, flow, message, key) == bool(said_by)


def test_each_rule_has_a_name_of_its_own() -> None:
    """Zenoh's policies name rules."""
    names = [row.id for row in access_table("fleet")]
    assert len(set(names)) == len(names)
    assert all(name and name == name.lower() for name in names)

"""Access by role, subject by key by operation, through a real router with mutual TLS on loopback.

Attackers are clients, peers or other routers, or are connected to the robot itself. They have a certificate of a
role, and a Zenoh file without its rules. The oracle is the table of docs/authority.md.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest
import zenoh

from gateway.authority.enrolment import COMMAND_MAX_BYTES, TransportRole
from gateway.provisioning.key_files import LEAF_DAYS
from schemas.command_line import CommandError
from schemas.settings import ZenohSettings
from schemas.zenoh_session import open_session
from tests.support.access import (
    COMMANDING,
    DRIVE,
    IMPOSTORS,
    KEPT,
    NOTHING,
    OPERATOR,
    PEOPLE,
    PUTS,
    PUTS_REACHED,
    QUERIES,
    RECORDER,
    ROBOT,
    ROBOTS,
    ROLES,
    STOP,
    STOP_ALL,
    SUBSCRIPTIONS,
    TELEMETRY,
    TOKENS,
    VERB,
    R,
)
from tests.support.fakes.peer import free_endpoint
from tests.support.routers import EVERYTHING, WatchedRouter, routing
from tests.support.secured import Network
from tests.support.waiting import wait_until

MODES: Final = ("client", "peer")
"""Of the attacking sessions. Honest ones are clients, as provisioned."""


class Secured:
    """A router, an attacker of each role, and an honest robot, operator and recorder."""

    def __init__(self, directory: Path, mode: str) -> None:
        self.network = Network(directory, free_endpoint("tls"))
        router = self.network.node(TransportRole.ROUTER, "127.0.0.1")
        self.router = WatchedRouter(self.network, router / "router.json5")
        self.attackers = {
            name: self.network.session(role, name, mode=mode, access_control__enabled=False)
            for name, role in ROLES.items()
        }
        self.robot = self.network.session(TransportRole.ROBOT, "cruiser-1", "cruiser-1")
        self.operator = self.network.session(TransportRole.OPERATOR, "ann")
        self.recorder = self.network.session(TransportRole.RECORDER, "depot")

    def close(self) -> None:
        for session in (*self.attackers.values(), self.robot, self.operator, self.recorder):
            session.close()
        self.router.close()


@pytest.fixture(scope="module", params=MODES)
def secured(request: pytest.FixtureRequest) -> Iterator[Secured]:
    with tempfile.TemporaryDirectory() as directory:
        network = Secured(Path(directory), request.param)
        try:
            yield network
        finally:
            network.close()


class Arrivals:
    """Sender and key of arrived samples and queries, by their attachments."""

    def __init__(self) -> None:
        self.found: set[tuple[str, str]] = set()
        self.kinds: set[str] = set()

    def sample(self, sample: zenoh.Sample) -> None:
        self.kinds.add(str(sample.kind))
        attachment = sample.attachment
        if attachment is not None:
            self._note(attachment)

    def query(self, query: zenoh.Query) -> None:
        if query.attachment is not None:
            self._note(query.attachment)

    def answering(self, own: str) -> Callable[[zenoh.Query], None]:
        """Note a query, and reply under ``own`` if its key is a pattern."""

        def answer(query: zenoh.Query) -> None:
            self.query(query)
            key = str(query.key_expr)
            query.reply(own if "*" in key else key, b"yes", attachment=query.attachment)

        return answer

    def _note(self, attachment: zenoh.ZBytes) -> None:
        sender, _, key = attachment.to_bytes().decode().partition(" ")
        self.found.add((sender, key))


def allowed(table: dict[str, set[str]]) -> set[tuple[str, str]]:
    return {(sender, key) for key, senders in table.items() for sender in senders}


def fence(secured: Secured, arrivals: Arrivals) -> None:
    """Wait for a permitted put of every attacker, sent after all else."""
    keys = (
        dict.fromkeys(PEOPLE, STOP)
        | {RECORDER: "fleet/@recorder/depot/health"}
        | dict.fromkeys(ROBOTS, f"{R}/state")
    )
    flush(secured.attackers[NOTHING])
    for name, key in keys.items():
        secured.attackers[name].put(
            key, b"", attachment=f"{name} fence", congestion_control=zenoh.CongestionControl.BLOCK
        )
    wait_until(lambda: all((name, "fence") in arrivals.found for name in keys))


def flush(session: zenoh.Session) -> None:
    """Send a query that is denied: it ends after all that was sent before."""
    assert not [reply for reply in session.get(f"{R}/@auth", timeout=2) if reply.ok is not None]


def observe(secured: Secured, arrivals: Arrivals) -> list[Any]:
    return [secured.router.session.declare_subscriber(key, arrivals.sample) for key in EVERYTHING]


def undeclare(declared: list[Any]) -> None:
    for one in declared:
        one.undeclare()


def test_who_may_put_on_which_key(secured: Secured) -> None:
    passed, reached = Arrivals(), Arrivals()
    declared = observe(secured, passed)
    declared += [
        secured.robot.declare_subscriber(f"{R}/@cmd/*/{verb}", reached.sample) for verb in ("drive", "stop")
    ]
    wait_until(lambda: reaches(secured, reached))
    for name, session in secured.attackers.items():
        for key in PUTS:
            session.put(key, b"", attachment=f"{name} {key}", congestion_control=zenoh.CongestionControl.BLOCK)
    fence(secured, passed)
    wait_until(lambda: {(name, "fence") for name in PEOPLE} <= reached.found)
    undeclare(declared)
    assert {one for one in passed.found if one[1] in PUTS} == allowed(PUTS)
    expected = {(name, key) for name, key in allowed(PUTS) if key in PUTS_REACHED}
    assert {one for one in reached.found if one[1] in PUTS} == expected


def reaches(secured: Secured, arrivals: Arrivals) -> bool:
    """Send a stop of the operator, and report whether one has arrived."""
    secured.operator.put(STOP, b"", attachment="honest operator")
    return ("honest", "operator") in arrivals.found


def test_nobody_deletes_anything(secured: Secured) -> None:
    passed = Arrivals()
    declared = observe(secured, passed)
    for session in secured.attackers.values():
        for key in PUTS:
            session.delete(key, congestion_control=zenoh.CongestionControl.BLOCK)
    fence(secured, passed)
    undeclare(declared)
    assert passed.kinds == {str(zenoh.SampleKind.PUT)}


def test_whose_queries_reach_the_robot(secured: Secured) -> None:
    arrivals, answered = Arrivals(), set()
    own = {**{f"{R}/{name}": f"{R}/{name}" for name in KEPT}, f"{R}/@cmd/*/*": STOP, f"{R}/@auth": f"{R}/@auth"}
    declared: list[Any] = [
        secured.robot.declare_queryable(key, arrivals.answering(reply), complete=True)
        for key, reply in own.items()
    ]
    wait_until(lambda: any(one.ok for one in secured.operator.get(f"{R}/@auth", timeout=1)))
    pending = [
        (name, key, session.get(key, attachment=f"{name} {key}", timeout=2, target=zenoh.QueryTarget.ALL))
        for name, session in secured.attackers.items()
        for key in QUERIES
    ]
    for name, key, replies in pending:
        if any(reply.ok is not None for reply in replies):
            answered.add((name, key))
    undeclare(declared)
    expected = allowed(QUERIES) | {(ROBOT, key) for key in QUERIES if key.endswith("gateway/info")}
    assert arrivals.found == expected
    assert answered == expected


def round_trip(session: zenoh.Session) -> None:
    """Wait until all that this session sent before is routed."""
    wait_until(lambda: any(reply.ok for reply in session.get(f"{R}/gateway/info", timeout=1)))


@pytest.mark.parametrize("key", SUBSCRIPTIONS)
def test_who_receives_what(secured: Secured, key: str) -> None:
    answer = secured.robot.declare_queryable(f"{R}/gateway/info", Arrivals().answering(f"{R}/gateway/info"))
    found: set[str] = set()
    declared: list[Any] = [answer]
    for name, session in secured.attackers.items():

        def note(_sample: zenoh.Sample, name: str = name) -> None:
            found.add(name)

        declared.append(session.declare_subscriber(key, note))
        flush(session) if name == NOTHING else round_trip(session)
    publishers = {"fleet/@recorder/depot/health": secured.recorder, STOP: secured.operator} | {
        f"{R}/{name}": secured.robot for name in TELEMETRY
    }

    def publish() -> None:
        for published, session in publishers.items():
            session.put(published, b"", congestion_control=zenoh.CongestionControl.BLOCK)

    wait_until(lambda: found >= SUBSCRIPTIONS[key], publish)
    publish()
    for session in (secured.operator, secured.recorder, *(secured.attackers[name] for name in PEOPLE)):
        round_trip(session)
    undeclare(declared)
    assert found == SUBSCRIPTIONS[key]


@pytest.mark.parametrize("key", IMPOSTORS)
def test_whose_replies_reach_an_operator(secured: Secured, key: str) -> None:
    asked = Arrivals()
    declared: list[Any] = []
    for name, session in secured.attackers.items():

        def answer(query: zenoh.Query, name: str = name) -> None:
            asked.found.add((name, key))
            query.reply(str(query.key_expr), name.encode())

        declared.append(session.declare_queryable(key, answer, complete=True))
    found: set[str] = set()
    question = VERB if key == f"{R}/@cmd/*/*" else key

    def ask() -> None:
        replies = secured.operator.get(
            question, timeout=2, target=zenoh.QueryTarget.ALL, consolidation=zenoh.ConsolidationMode.NONE
        )
        found.update(reply.ok.payload.to_string() for reply in replies if reply.ok is not None)

    wait_until(lambda: found >= IMPOSTORS[key], ask)
    undeclare(declared)
    assert found == IMPOSTORS[key]
    assert {name for name, _ in asked.found} == IMPOSTORS[key]


def test_whose_liveliness_tokens_are_seen(secured: Secured) -> None:
    declared: list[Any] = []
    found: set[tuple[str, str]] = set()
    for name, session in secured.attackers.items():
        for key in TOKENS:
            chunks = key.split("/")
            own = "/".join(f"{chunk}-{name}" if chunk == "ghost" else chunk for chunk in chunks)
            declared.append(session.liveliness().declare_token(own))

    def look() -> None:
        expressions = (
            "fleet/*/gateway",
            "fleet/*/safety/*/@adv/**",
            "fleet/@recorder/*",
            "fleet/*",
            "operators/*",
        )
        for expression in expressions:
            for reply in secured.router.session.liveliness().get(expression, timeout=2):
                if reply.ok is not None and "ghost-" in (key := str(reply.ok.key_expr)):
                    name = next(one for one in ROLES if f"ghost-{one}" in key)
                    found.add((name, key.replace(f"-{name}", "")))

    wait_until(lambda: found >= allowed(TOKENS), look)
    undeclare(declared)
    assert found == allowed(TOKENS)


def test_a_stop_passes_whatever_its_size(secured: Secured) -> None:
    reached = Arrivals()
    declared = [
        secured.robot.declare_subscriber(f"{R}/@cmd/*/{verb}", reached.sample) for verb in ("drive", "stop")
    ]
    large = bytes(COMMAND_MAX_BYTES + 1)
    operator = secured.attackers[OPERATOR]

    def send() -> None:
        operator.put(DRIVE, large, attachment="drive large")
        operator.put(DRIVE, large[: COMMAND_MAX_BYTES // 2], attachment="drive small")
        operator.put(STOP, large, attachment="stop large")

    wait_until(lambda: {("stop", "large"), ("drive", "small")} <= reached.found, send)
    undeclare(declared)
    assert ("drive", "large") not in reached.found


def test_a_robot_refuses_what_a_router_without_rules_sends(secured: Secured) -> None:
    """The robot's own file applies to its router too."""
    network = Network(Path(tempfile.mkdtemp(dir=secured.network.directory)), free_endpoint("tls"))
    config = zenoh.Config.from_file(str(network.node(TransportRole.ROUTER, "127.0.0.1") / "router.json5"))
    config.insert_json5("access_control/enabled", "false")
    with zenoh.open(config) as router, network.session(TransportRole.ROBOT, "cruiser-1", "cruiser-1") as robot:
        reached = Arrivals()
        for key in (f"{R}/@cmd/*/*", "fleet/*/@cmd/*/*", "fleet/**", f"{R}/@auth"):
            robot.declare_subscriber(key, reached.sample)
        wrong = ("fleet/*/@cmd/ann/drive", "fleet/cruiser-2/state", f"{R}/state", f"{R}/@auth", f"{R}/@cmd/*/*")

        def send() -> None:
            for key in (*wrong, DRIVE, STOP_ALL):
                router.put(key, b"", attachment=f"router {key}")

        wait_until(lambda: {("router", DRIVE), ("router", STOP_ALL)} <= reached.found, send)
        assert reached.found == {("router", DRIVE), ("router", STOP_ALL)}


def test_a_link_ends_with_its_certificate(tmp_path: Path) -> None:
    network = Network(tmp_path, free_endpoint("tls"))
    router = network.node(TransportRole.ROUTER, "127.0.0.1")
    lives_s = 5
    ann = network.node(TransportRole.OPERATOR, "ann", born_s=int(time.time()) - LEAF_DAYS * 86_400 + lives_s)
    file = str(ann / "operator.json5")
    with routing(router / "router.json5"):
        with zenoh.open(zenoh.Config.from_file(file)) as session:
            assert session.info.routers_zid()
            wait_until(lambda: not session.info.routers_zid())
        assert not opens(zenoh.Config.from_file(file))


def opens(config: zenoh.Config) -> bool:
    try:
        session = zenoh.open(config)
    except zenoh.ZError:
        return False
    try:
        return bool(session.info.routers_zid())
    finally:
        session.close()


def configuration(network: Network, role: TransportRole, name: str) -> zenoh.Config:
    return zenoh.Config.from_file(str(network.node(role, name) / f"{role.value}.json5"))


HONEST: Final = b"of a robot or an operator"


def subscribe(session: zenoh.Session, name: str, keys: Iterable[str], received: set[tuple[str, str]]) -> None:
    """Subscribe, and note the samples of honest senders."""

    def note(sample: zenoh.Sample) -> None:
        if sample.attachment is not None and sample.attachment.to_bytes() == HONEST:
            received.add((name, str(sample.key_expr)))

    for key in keys:
        session.declare_subscriber(key, note)


def may_receive(name: str, key: str) -> bool:
    """Report whether a permitted subscription of this role includes the key."""
    allowed_keys = (expression for expression, names in SUBSCRIPTIONS.items() if name in names)
    return any(zenoh.KeyExpr(one).includes(zenoh.KeyExpr(key)) for one in allowed_keys)


def say_everything(session: zenoh.Session, name: str) -> None:
    for key in PUTS:
        session.delete(key)
        session.put(key, b"", attachment=f"{name} {key}")
    for key in QUERIES:
        session.get(key, lambda _reply: None, attachment=f"{name} {key}", target=zenoh.QueryTarget.ALL)


def test_who_plays_a_router_gets_no_more(tmp_path: Path) -> None:
    network = Secured(tmp_path, "router")
    passed, reached, asked = Arrivals(), Arrivals(), Arrivals()
    received: set[tuple[str, str]] = set()
    for key, reply in {f"{R}/@cmd/*/*": STOP, f"{R}/@auth": f"{R}/@auth"}.items():
        network.robot.declare_queryable(key, asked.answering(reply), complete=True)
    observe(network, passed)
    for verb in ("stop", "drive"):
        network.robot.declare_subscriber(f"{R}/@cmd/*/{verb}", reached.sample)
    for name, session in network.attackers.items():
        subscribe(session, name, SUBSCRIPTIONS, received)

    def attack() -> None:
        for name, session in network.attackers.items():
            say_everything(session, name)
        for key in TELEMETRY:
            network.robot.put(f"{R}/{key}", b"", attachment=HONEST)
        network.operator.put(STOP, b"", attachment=HONEST)

    stops, verbs = ({(name, key) for name in who} for who, key in ((PEOPLE, STOP), (COMMANDING, VERB)))
    seen = {(name, f"{R}/state") for name in PEOPLE}
    wait_until(lambda: stops <= reached.found and verbs <= asked.found and seen <= received, attack)
    attack()
    # What was sent after all of it has arrived.
    last = f"{OPERATOR} last"
    wait_until(
        lambda: (OPERATOR, "last") in reached.found,
        lambda: network.attackers[OPERATOR].put(STOP, b"", attachment=last),
    )
    network.close()
    assert passed.kinds == {str(zenoh.SampleKind.PUT)}
    assert {one for one in passed.found if one[1] in PUTS} <= allowed(PUTS)
    assert {one for one in reached.found if one[1] in PUTS} <= allowed(PUTS)
    assert {one for one in asked.found if one[1] in QUERIES} <= allowed(QUERIES)
    assert [one for one in received if not may_receive(*one)] == []


@pytest.mark.parametrize("mode", MODES)
def test_a_robot_that_listens_in_spite_of_its_file_obeys_a_router_alone(tmp_path: Path, mode: str) -> None:
    network = Network(tmp_path, free_endpoint("tls"))
    serving = network.node(TransportRole.ROUTER, "127.0.0.1")
    config = configuration(network, TransportRole.ROBOT, "cruiser-1")
    for path, value in {
        "mode": '"peer"',
        "connect/endpoints": "[]",
        "listen/endpoints": f'["{network.endpoint}"]',
        "transport/link/tls/listen_certificate": f'"{serving}/router-tls.pem"',
        "transport/link/tls/listen_private_key": f'"{serving}/router-tls.key"',
    }.items():
        config.insert_json5(path, value)
    reached = Arrivals()
    received: set[tuple[str, str]] = set()
    roles = ROLES | {"router": TransportRole.ROUTER}
    with zenoh.open(config) as robot:
        for verb in ("stop", "drive"):
            robot.declare_subscriber(f"{R}/@cmd/*/{verb}", reached.sample)
        for key in (f"{R}/@cmd/*/*", f"{R}/@auth", f"{R}/gateway/info"):
            robot.declare_queryable(key, reached.query, complete=True)
        sessions = {
            name: network.session(
                role,
                f"{name}-direct",
                mode=mode,
                access_control__enabled=False,
                connect__endpoints=[network.endpoint],
                listen__endpoints=[],
            )
            for name, role in roles.items()
        }
        for name, session in sessions.items():
            subscribe(session, name, (f"{R}/state", "fleet/**"), received)

        def attack() -> None:
            for name, session in sessions.items():
                say_everything(session, name)
            robot.put(f"{R}/state", b"", attachment=HONEST)

        expected = {("router", key) for key in (DRIVE, STOP, VERB, f"{R}/@auth")}
        wait_until(lambda: expected <= reached.found and bool(received), attack)
        attack()
        wait_until(
            lambda: ("router", "last") in reached.found,
            lambda: sessions["router"].put(STOP, b"", attachment="router last"),
        )
        for session in sessions.values():
            session.close()
    assert {name for name, _ in reached.found | received} == {"router"}


@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_robot_cannot_listen_by_its_settings(tmp_path: Path, protocol: str) -> None:
    network = Network(tmp_path, free_endpoint("tls"))
    file = network.node(TransportRole.ROBOT, "cruiser-1", "cruiser-1") / "robot.json5"
    listen = free_endpoint(protocol)
    for given in ((), ("mode",)):
        settings = ZenohSettings(config=str(file), mode="peer", given=frozenset(given))
        with pytest.raises(CommandError, match="cannot open Zenoh"):
            open_session(settings, [], [listen])


def test_who_has_no_certificate_of_the_authority_does_not_connect(secured: Secured, tmp_path: Path) -> None:
    network = secured.network
    right = configuration(network, TransportRole.OPERATOR, "bea")
    assert opens(right)
    bare = configuration(network, TransportRole.OPERATOR, "without")
    for entry in ("connect_certificate", "connect_private_key"):
        bare.insert_json5(f"transport/link/tls/{entry}", "null")
    bare.insert_json5("transport/link/tls/enable_mtls", "false")
    assert not opens(bare)
    foreign = Network(tmp_path, network.endpoint)
    stranger = configuration(foreign, TransportRole.OPERATOR, "stranger")
    ours = str(network.directory / "operator-bea" / "ca.pem")
    stranger.insert_json5("transport/link/tls/root_ca_certificate", f'"{ours}"')
    assert not opens(stranger)
    plain = configuration(network, TransportRole.OPERATOR, "plain")
    plain.insert_json5("transport/link/protocols", '["tcp"]')
    plain.insert_json5("connect/endpoints", f'["{network.endpoint.replace("tls/", "tcp/")}"]')
    assert not opens(plain)


def router_with_certificate_of(network: Network, role: TransportRole) -> zenoh.Config:
    config = configuration(network, TransportRole.ROUTER, "127.0.0.1")
    impostor = network.node(role, "127.0.0.1")
    for end in ("listen", "connect"):
        for kind, suffix in (("certificate", "pem"), ("private_key", "key")):
            config.insert_json5(f"transport/link/tls/{end}_{kind}", f'"{impostor / f"{role.value}-tls.{suffix}"}"')
    return config


@pytest.mark.parametrize("role", [TransportRole.OPERATOR, TransportRole.RECORDER, TransportRole.ROBOT])
def test_a_certificate_that_only_dials_out_serves_nobody(tmp_path: Path, role: TransportRole) -> None:
    network = Network(tmp_path, free_endpoint("tls"))
    with zenoh.open(router_with_certificate_of(network, role)):
        assert not opens(configuration(network, TransportRole.ROBOT, "cruiser-1"))
    with routing(network.directory / "router-127.0.0.1" / "router.json5"):
        assert opens(configuration(network, TransportRole.ROBOT, "cruiser-2"))


def test_a_desk_that_plays_the_router_commands_nobody(tmp_path: Path) -> None:
    network = Network(tmp_path, free_endpoint("tls"))
    config = router_with_certificate_of(network, TransportRole.DESK)
    config.insert_json5("access_control/enabled", "false")
    with zenoh.open(config) as impostor, network.session(TransportRole.ROBOT, "cruiser-1", "cruiser-1") as robot:
        wait_until(
            lambda: bool(impostor.info.peers_zid() or impostor.info.routers_zid() or list(impostor.info.links()))
        )
        reached, leaked, inner = Arrivals(), Arrivals(), Arrivals()
        robot.declare_subscriber(f"{R}/@cmd/*/*", reached.sample)
        impostor.declare_subscriber("fleet/**", leaked.sample)
        impostor.declare_subscriber("fleet/*/own", inner.sample)
        for number in range(50):
            impostor.put(DRIVE, b"", attachment=f"desk {number}")
            robot.put(f"{R}/state", b"", attachment=f"robot {number}")
        # A query that comes back empty went both ways after all of these.
        assert not [reply for reply in robot.get(f"{R}/gateway/info", timeout=1) if reply.ok is not None]
        assert (reached.found, leaked.found) == (set(), set())


@pytest.mark.parametrize("may_read", [False, True])
@pytest.mark.parametrize("has_rows", [True, False])
def test_a_router_says_nothing_of_itself(tmp_path: Path, has_rows: bool, may_read: bool) -> None:  # noqa: FBT001
    """With its admin space on, as in zenohd, rules or permissions suffice; with neither it answers."""
    network = Network(tmp_path, free_endpoint("tls"))
    with (
        network.session(
            TransportRole.ROUTER,
            "127.0.0.1",
            adminspace__enabled=True,
            adminspace__permissions__read=may_read,
            access_control__enabled=has_rows,
        ),
        network.session(TransportRole.VIEWER, "vic", access_control__enabled=False) as viewer,
    ):
        assert viewer.info.routers_zid()
        replies = viewer.get("@/*/router/**", timeout=2, target=zenoh.QueryTarget.ALL)
        answers = [reply for reply in replies if reply.ok is not None]
        assert bool(answers) is (may_read and not has_rows)

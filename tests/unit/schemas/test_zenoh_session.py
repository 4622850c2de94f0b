"""The Zenoh session settings that every process shares."""

import json
from pathlib import Path

import pytest

from schemas.configuration import merge
from schemas.settings import ZenohSettings
from schemas.zenoh_session import (
    CONNECT,
    LISTEN,
    MODE,
    MULTICAST,
    ROUTER_LOOKS,
    Json,
    _configuration,
    finds_router,
    is_loopback,
    lease_in_force_ms,
    next_ports,
    own_endpoint,
    said,
    said_of,
    with_command_ports,
)

ENDPOINT = "tcp/127.0.0.1:7447"
ASKS = """{
    scouting: { multicast: { enabled: true } },
    listen: { endpoints: ["tcp/127.0.0.1:7500"] },
    connect: { endpoints: ["tcp/127.0.0.1:7501"] },
}"""


OTHER = "tls/[::1]:7500"


@pytest.mark.parametrize(
    ("of_file", "settings", "mode", "connect", "listen"),
    [
        ({}, ZenohSettings(), "peer", [], []),
        ({CONNECT: [ENDPOINT], LISTEN: [OTHER]}, ZenohSettings(), "peer", [ENDPOINT], [OTHER]),
        ({LISTEN: {"peer": OTHER, "router": [ENDPOINT]}}, ZenohSettings(), "peer", [], [OTHER]),
        ({LISTEN: {"router": [ENDPOINT]}}, ZenohSettings(), "peer", [], []),
        ({MODE: "router", LISTEN: {"router": [ENDPOINT]}}, ZenohSettings(), "router", [], [ENDPOINT]),
        ({LISTEN: [OTHER]}, ZenohSettings(connect=[ENDPOINT]), "peer", [ENDPOINT], [OTHER]),
        ({LISTEN: [OTHER], CONNECT: [OTHER]}, ZenohSettings(listen=[ENDPOINT]), "peer", [OTHER], [ENDPOINT]),
        ({MODE: "client", LISTEN: [OTHER]}, ZenohSettings(), "client", [], []),
        ({MODE: "client"}, ZenohSettings(listen=[OTHER]), "client", [], []),
        ({MODE: "client", LISTEN: [OTHER]}, ZenohSettings(given=frozenset({"mode"})), "peer", [], [OTHER]),
    ],
)
def test_what_is_said_of_a_session(
    of_file: dict[str, Json], settings: ZenohSettings, mode: str, connect: list[str], listen: list[str]
) -> None:
    assert said(settings, of_file.get)[:3] == (mode, connect, listen)
    assert said(settings, of_file.get).is_mode_given == (MODE in of_file or "mode" in settings.given)


@pytest.mark.parametrize(
    ("listen", "beside", "own"),
    [
        ("tcp/0.0.0.0:7447", "tcp/0.0.0.0:7448", "tcp/127.0.0.1:7447"),
        ("tcp/[::]:1", "tcp/[::]:2", "tcp/[::1]:1"),
        ("tcp/10.0.0.7:0", "tcp/10.0.0.7:0", "tcp/10.0.0.7:0"),
        (
            "tcp/robot.example:7447?rel=1#iface=eth0",
            "tcp/robot.example:7448?rel=1#iface=eth0",
            "tcp/robot.example:7447?rel=1",
        ),
        ("tls/0.0.0.0:7447", "tls/0.0.0.0:7448", "tls/127.0.0.1:7447#verify_name_on_connect=false"),
        ("quic/[::1]:9#a=b", "quic/[::1]:10#a=b", "quic/[::1]:9#verify_name_on_connect=false"),
    ],
)
def test_a_second_session_stands_beside_the_first(listen: str, beside: str, own: str) -> None:
    assert (next_ports([listen]), own_endpoint(listen)) == ([beside], own)


@pytest.mark.parametrize(
    ("connect", "to"),
    [
        (["tcp/a:7447", "tls/b:9"], ["tcp/a:7447", "tls/b:9", "tcp/a:7448", "tls/b:10"]),
        (["tcp/a:7447", "tcp/a:7448"], ["tcp/a:7447", "tcp/a:7448", "tcp/a:7449"]),
        (["tcp/a:65535", "unixsock-stream//run/s", "nonsense", "tcp/a:1#exit_on_failure=true"],) * 2,
    ],
)
def test_commands_also_connect_to_the_next_port(connect: list[str], to: list[str]) -> None:
    assert with_command_ports(connect) == to


@pytest.mark.parametrize(
    ("listen", "fault"),
    [
        ("tcp/127.0.0.1:65535", "has the last port"),
        ("unixsock-stream//run/robot.sock", "has no port"),
        ("nonsense", "nonsense is not an endpoint, such as tcp"),
    ],
)
def test_where_no_port_comes_next_there_is_none(listen: str, fault: str) -> None:
    with pytest.raises(ValueError, match=fault):
        next_ports([listen])


class Nodes:
    """A session that is connected after this many checks."""

    def __init__(self, after: int, peers: int, routers: int) -> None:
        self.looks = 0
        self._after, self._peers, self._routers = after, peers, routers

    def peers_zid(self) -> list[int]:
        return [1] * self._peers if self.looks >= self._after else []

    def routers_zid(self) -> list[int]:
        return [1] * self._routers if self.looks >= self._after else []

    def pause(self, seconds: float) -> None:
        assert seconds > 0
        self.looks += 1


@pytest.mark.parametrize(
    ("peers", "routers", "after", "is_router"),
    [
        (0, 1, 0, True),
        (0, 1, ROUTER_LOOKS - 1, True),
        (0, 1, ROUTER_LOOKS, False),
        (1, 0, 3, False),
        (1, 1, 3, False),
        (0, 0, 0, False),
    ],
    ids=["at once", "in time", "too late", "a peer", "both", "nobody"],
)
def test_who_finds_a_router_and_no_peer_has_found_a_router(
    peers: int, routers: int, after: int, *, is_router: bool
) -> None:
    nodes = Nodes(after, peers, routers)
    assert finds_router(nodes, nodes.pause) is is_router
    assert nodes.looks == (min(after, ROUTER_LOOKS) if peers or routers else ROUTER_LOOKS)


@pytest.mark.parametrize(
    ("endpoint", "stays"),
    [
        (ENDPOINT, True),
        ("tls/localhost:1", True),
        ("tcp/[::1]:1", True),
        ("unixsock-stream//run/robot.sock", True),
        ("tcp/10.0.0.1:1", False),
        ("tcp/[::]:1", False),
        ("tcp/127.example:1", False),
        ("nonsense", False),
    ],
)
def test_an_endpoint_of_this_machine(endpoint: str, *, stays: bool) -> None:
    assert is_loopback(endpoint) is stays


@pytest.mark.parametrize(
    ("text", "connect", "in_force"),
    [
        ("{}", [ENDPOINT], (False, [], [ENDPOINT])),
        ("{ transport: { link: { tx: { keep_alive: 5 } } } }", [], (False, [], [])),
        (ASKS, [], (True, [], ["tcp/127.0.0.1:7501"])),
        (ASKS, [ENDPOINT], (True, [], [ENDPOINT])),
    ],
)
def test_a_session_neither_scouts_nor_listens_by_itself(
    tmp_path: Path, text: str, connect: list[str], in_force: tuple[bool, list[str], list[str]]
) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(text)
    config = _configuration(ZenohSettings(config=str(file)), connect, [])
    assert tuple(json.loads(config.get_json(path)) for path in (MULTICAST, LISTEN, CONNECT)) == in_force


def test_what_a_zenoh_file_says_holds_unless_a_setting_is_given(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(
        "{ mode: 'client', timestamping: { enabled: false },"
        " transport: { link: { tx: { lease: 3000, queue: { size: { data: 4 } } } } } }"
    )
    others = ("timestamping/enabled", "transport/link/tx/queue/size/data")

    def in_force_with(flags: dict[str, object]) -> list[object]:
        settings = merge(None, {"CRUISER_ZENOH_CONFIG": str(file)}, flags).zenoh
        config = _configuration(settings, [], [])
        read = [json.loads(config.get_json(path)) for path in others]
        return [said_of(settings).mode, lease_in_force_ms(settings), *read]

    assert in_force_with({}) == ["client", 3000, False, 4]
    assert in_force_with({"zenoh.mode": "peer", "zenoh.lease_ms": 1000}) == ["peer", 1000, False, 4]
    file.write_text("{}")
    assert in_force_with({}) == ["peer", 1000, True, 8]

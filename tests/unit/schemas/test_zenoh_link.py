"""The Zenoh session settings that every process shares."""

import pytest

from schemas.exit_codes import ExitCode
from schemas.settings import ZenohSettings
from schemas.zenoh_link import (
    CONNECT,
    LEASE,
    LISTEN,
    MODE,
    MULTICAST,
    ROUTER_LOOKS,
    SCOUTING,
    SCOUTING_MS,
    Json,
    SessionError,
    allows,
    finds_router,
    is_loopback,
    next_ports,
    own_endpoint,
    reason,
    said,
    session_settings,
)

ENDPOINT = "tcp/127.0.0.1:7447"


def test_multicast_is_off_unless_the_users_own_file_says_otherwise() -> None:
    """By default no session scouts by multicast; nothing in our own settings turns it on."""
    assert session_settings(ZenohSettings(), [], [])[MULTICAST] is False
    assert MULTICAST not in session_settings(ZenohSettings(), [], [], lambda path: path == MULTICAST)


def test_a_session_that_opens_waits_for_others_as_long_as_ours_or_the_users_own_file_says() -> None:
    """Not for the half second of Zenoh's own, which it often waits for nothing; a file's word holds."""
    assert session_settings(ZenohSettings(), [ENDPOINT], [])[SCOUTING] == SCOUTING_MS
    assert SCOUTING not in session_settings(ZenohSettings(), [ENDPOINT], [], lambda path: path == SCOUTING)


def test_a_files_endpoints_to_connect_to_hold_where_none_are_given() -> None:
    """Endpoints that are given win over the file; where none are, the file's own stay."""
    given = session_settings(ZenohSettings(), [ENDPOINT], [], lambda _: True)
    assert given[CONNECT] == [ENDPOINT]
    assert CONNECT not in session_settings(ZenohSettings(), [], [], lambda _: True)
    assert session_settings(ZenohSettings(), [], [])[CONNECT] == []


@pytest.mark.parametrize("listen", [[], [ENDPOINT]])
@pytest.mark.parametrize("of_file", [True, False])
def test_what_is_listened_on_is_what_is_given(listen: list[str], *, of_file: bool) -> None:
    """Neither a file nor Zenoh's own start value, which is every address, adds an endpoint to listen on."""
    assert session_settings(ZenohSettings(), [], listen, lambda _: of_file)[LISTEN] == listen


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
    """A setting wins over the file, the file is read in each of Zenoh's forms, and a client listens on nothing."""
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
    """It listens on the same address and the next port, and reaches the first one from this machine."""
    assert (next_ports([listen]), own_endpoint(listen)) == ([beside], own)


@pytest.mark.parametrize(
    ("listen", "fault"),
    [
        ("tcp/127.0.0.1:65535", "has the last port"),
        ("unixsock-stream//run/robot.sock", "has no port"),
        ("nonsense", "nonsense is no endpoint, as tcp/127.0.0.1:7447 is"),
    ],
)
def test_where_no_port_comes_next_there_is_none(listen: str, fault: str) -> None:
    """Nothing is made up: the caller has to say where."""
    with pytest.raises(ValueError, match=fault):
        next_ports([listen])


def test_protocols_that_a_file_does_not_name_are_not_allowed() -> None:
    """A file that says nothing of protocols allows all."""
    assert allows(None, ENDPOINT)
    assert allows(["tls", "tcp"], ENDPOINT)
    assert not allows(["tls"], ENDPOINT)


class Nodes:
    """A session that gets connected after so many looks."""

    def __init__(self, after: int, peers: int, routers: int) -> None:
        self.looks = 0
        self._after, self._peers, self._routers = after, peers, routers

    def peers_zid(self) -> list[int]:
        return [1] * self._peers if self.looks >= self._after else []

    def routers_zid(self) -> list[int]:
        return [1] * self._routers if self.looks >= self._after else []

    def pause(self, seconds: float) -> None:
        """Time passes."""
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
    """Looked for during half a second; a node that is there ends the wait."""
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
    """What may lead elsewhere counts as elsewhere."""
    assert is_loopback(endpoint) is stays


@pytest.mark.parametrize(("name", "path"), [("mode", MODE), ("lease_ms", LEASE)])
def test_a_files_word_holds_against_a_start_value_not_against_a_given_one(name: str, path: str) -> None:
    """A setting that a source gave wins over the file, even with its start value."""
    assert path in session_settings(ZenohSettings(), [], [])
    assert path not in session_settings(ZenohSettings(), [], [], lambda _: True)
    given = ZenohSettings(given=frozenset({name}))
    assert set(session_settings(given, [], [], lambda _: True)) == {path, LISTEN}


def test_a_reason_is_one_clean_line() -> None:
    """The places in Zenoh's own source, line breaks and control characters are left out."""
    message = "Can not bind\n tcp/x: [in use at /build/dir/tcp.rs:61.] at /build/dir/unicast.rs:338."
    assert reason(message) == "Can not bind tcp/x: [in use]"


@pytest.mark.parametrize(
    ("places", "says"),
    [
        (
            "Single(tcp/127.0.0.1:7447)",
            "nobody answers at tcp/127.0.0.1:7447: look at the router or gateway there, and at the network",
        ),
        (
            "Single(tls/[::1]:7447), Single(tls/r.example:7447)",
            "nobody at tls/[::1]:7447, tls/r.example:7447 lets",
        ),
    ],
)
def test_where_nobody_answers_it_is_said_in_plain_words(places: str, says: str) -> None:
    """With certificates there is more than one reason, and Zenoh knows none."""
    error = SessionError(
        "cannot open Zenoh", f"Unable to connect to any of [{places}]! at /build/x.rs:1.", "z.json5"
    )
    assert str(error).startswith(f"cannot open Zenoh: {says}")
    assert (error.code, error.config) == (ExitCode.UNREACHABLE, "z.json5")

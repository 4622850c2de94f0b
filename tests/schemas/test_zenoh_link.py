"""The Zenoh session settings that every process shares."""

import pytest

from schemas.settings import ZenohSettings
from schemas.zenoh_link import CONNECT, LEASE, LISTEN, MODE, MULTICAST, reason, session_settings

ENDPOINT = "tcp/127.0.0.1:7447"


def test_multicast_is_off_unless_the_users_own_file_says_otherwise() -> None:
    """By default no session scouts by multicast; nothing in our own settings turns it on."""
    assert session_settings(ZenohSettings(), [], [])[MULTICAST] is False
    assert MULTICAST not in session_settings(ZenohSettings(), [], [], lambda path: path == MULTICAST)


@pytest.mark.parametrize("path", [CONNECT, LISTEN])
def test_a_files_endpoints_hold_where_none_are_given(path: str) -> None:
    """Endpoints that are given win over the file; where none are, the file's own stay."""
    given = session_settings(ZenohSettings(), [ENDPOINT], [ENDPOINT], lambda _: True)
    assert given[path] == [ENDPOINT]
    assert path not in session_settings(ZenohSettings(), [], [], lambda _: True)
    assert session_settings(ZenohSettings(), [], [])[path] == []


@pytest.mark.parametrize(("name", "path"), [("mode", MODE), ("lease_ms", LEASE)])
def test_a_files_word_holds_against_a_start_value_not_against_a_given_one(name: str, path: str) -> None:
    """A setting that a source gave wins over the file, even with its start value."""
    assert path in session_settings(ZenohSettings(), [], [])
    assert path not in session_settings(ZenohSettings(), [], [], lambda _: True)
    given = ZenohSettings(given=frozenset({name}))
    assert list(session_settings(given, [], [], lambda _: True)) == [path]


def test_a_reason_is_one_clean_line() -> None:
    """The places in Zenoh's own source, line breaks and control characters are left out."""
    message = "Can not bind\n tcp/x: [in use at /build/dir/tcp.rs:61.] at /build/dir/unicast.rs:338."
    assert reason(message) == "Can not bind tcp/x: [in use]"

"""Shards: which robots a recorder records, and the recorder's name."""

import re
import socket
from collections import Counter
from hashlib import sha256

import pytest

from recorder.zenoh.remote_control import host_name
from recorder.zenoh.source import Shard, shard_of
from schemas import keys
from schemas.command_line import CommandError, ExitCode

ROBOTS = [f"cruiser-{number}" for number in range(200)]


def test_each_robot_is_recorded_once() -> None:
    for total in (1, 2, 4, 7):
        parts = [[one for one in ROBOTS if Shard(number, total).has(one)] for number in range(1, total + 1)]
        assert Counter(robot for part in parts for robot in part) == Counter(ROBOTS)
        assert all(len(part) > 100 / total for part in parts)


def test_the_rule_is_the_documented_one() -> None:
    assert [Shard(number, 3).has("cruiser-7") for number in (1, 2, 3)] == [
        int(sha256(b"cruiser-7").hexdigest(), 16) % 3 == number - 1 for number in (1, 2, 3)
    ]
    assert [next(n for n in (1, 2, 3, 4) if Shard(n, 4).has(f"cruiser-{robot}")) for robot in range(1, 7)] == [
        3,
        3,
        3,
        1,
        2,
        3,
    ]


@pytest.mark.parametrize("text", ["5/4", "0/4", "2", "2/", "a/b", "2/4/", "-1/4", "1/1000"])
def test_a_shard_that_is_none_is_refused(text: str) -> None:
    assert shard_of("2/4") == Shard(2, 4)
    with pytest.raises(CommandError, match="such as 2/4") as refused:
        shard_of(text)
    assert refused.value.code is ExitCode.USAGE


@pytest.mark.parametrize(
    ("host", "name"),
    [
        ("cruiser-7", "cruiser-7"),
        ("Depot_PC.example.org", "depot-pc"),
        ("--", "recorder"),
        ("", "recorder"),
        ("r\N{LATIN SMALL LETTER O WITH DIAERESIS}ver/2", "r-ver-2"),
    ],
)
def test_a_recorder_is_called_like_its_host(monkeypatch: pytest.MonkeyPatch, host: str, name: str) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: host)
    assert host_name() == name
    assert re.fullmatch(keys.ROBOT_PATTERN, host_name())

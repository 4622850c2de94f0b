import re
import socket

import pytest

from recorder.zenoh.remote_control import host_name
from schemas import keys


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
    """As far as that can be a chunk of a key."""
    monkeypatch.setattr(socket, "gethostname", lambda: host)
    assert host_name() == name
    assert re.fullmatch(keys.ROBOT_PATTERN, host_name())

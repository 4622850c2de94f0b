"""Asking other recorders over a real Zenoh, on the loopback."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from recorder.zenoh.recorder_client import RecorderClient
from schemas.exit_codes import CommandError, ExitCode
from schemas.keys import ALL
from schemas.recording import Backfill
from schemas.settings import ZenohSettings
from tests.support.backfill_logs import GEAR, SECOND, START_NS, gear_rows, log_of, row, rows_of, write
from tests.support.fakes.peer import free_endpoint
from tests.support.fakes.recorders import BackfillHost

WAIT_S = 20.0
REQUEST = Backfill("fleet/cruiser-1/**", START_NS, START_NS + 3600 * SECOND)


@pytest.fixture
def endpoint() -> str:
    """Where the other recorder listens."""
    return free_endpoint()


@pytest.fixture
def client(endpoint: str) -> Iterator[RecorderClient]:
    """Who asks."""
    with closing(RecorderClient(ZenohSettings(connect=[endpoint]), "fleet", "somebody")) as found:
        yield found


def test_an_answer_comes_in_pieces(endpoint: str, client: RecorderClient, tmp_path: Path) -> None:
    """As they were sent, from the recorder that was asked."""
    rows = [row(number, number * 10, data=bytes(1000)) for number in range(1000)]
    write(tmp_path / "a.mcap", log_of(rows))
    with BackfillHost(endpoint, tmp_path) as host:
        assert client.recorders(ALL, WAIT_S) == ["robot"]
        pieces = list(client.backfill("robot", REQUEST))
        assert host.requests == [REQUEST]
    assert len(pieces) > 3
    assert [piece.is_last for piece in pieces] == [False] * (len(pieces) - 1) + [True]
    assert rows_of(pieces) == rows


def test_a_refusal_is_a_piece_too(endpoint: str, client: RecorderClient, tmp_path: Path) -> None:
    """With its reason."""
    with BackfillHost(endpoint, tmp_path):
        client.recorders("robot", WAIT_S)
        (piece,) = client.backfill("robot", Backfill(GEAR, 5, 5))
    assert not piece.ok
    assert piece.detail


def test_a_recorder_that_is_not_there_does_not_answer(
    endpoint: str, client: RecorderClient, tmp_path: Path
) -> None:
    """Neither when nobody is there, nor when somebody else is."""
    with pytest.raises(CommandError, match="no Zenoh node answered") as caught:
        client.recorders(ALL, 0.1)
    assert caught.value.code == ExitCode.UNREACHABLE
    write(tmp_path / "a.mcap", log_of(gear_rows(5)))
    with BackfillHost(endpoint, tmp_path):
        client.recorders(ALL, WAIT_S)
        with pytest.raises(CommandError, match="recorder other does not answer"):
            client.recorders("other", 0.1)
        assert list(client.backfill("other", REQUEST)) == []


def test_a_stop_ends_the_waiting(endpoint: str) -> None:
    """At once."""
    settings = ZenohSettings(connect=[endpoint])
    with closing(RecorderClient(settings, "fleet", "somebody", lambda: True)) as client:
        with pytest.raises(CommandError):
            client.recorders(ALL, 1e6)
        assert list(client.backfill("robot", REQUEST)) == []

"""A peer that the recorder's processes connect to."""

from collections.abc import Iterator

import pytest

from tests.support.fakes.peer import Peer, free_endpoint


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def peer(endpoint: str) -> Iterator[Peer]:
    with Peer(endpoint) as one:
        yield one

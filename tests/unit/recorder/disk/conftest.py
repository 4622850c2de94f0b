"""A disk whose syncs wait and fail on demand."""

import pytest

from tests.support.fakes.recording import SlowDisk


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> SlowDisk:
    """The disk of the logs, which syncs at once until it is told otherwise."""
    return SlowDisk(monkeypatch)

"""A disk whose syncs wait and fail on demand."""

import pytest

from tests.support.fakes.recording import SlowDisk


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> SlowDisk:
    return SlowDisk(monkeypatch)

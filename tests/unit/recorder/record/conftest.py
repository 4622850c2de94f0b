"""A recorder for each test."""

from collections.abc import Iterator

import pytest

from tests.support.rigs.recorder import RecorderRig, messages


@pytest.fixture
def bench() -> Iterator[RecorderRig]:
    one = RecorderRig()
    yield one
    one.close()
    assert all(messages(file) is not None for files in one.writer.files.values() for file in files)

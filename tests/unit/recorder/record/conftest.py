"""A recorder for each test."""

from collections.abc import Iterator

import pytest

from tests.support.recorder_bench import Bench, messages


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A bench, of which every file is whole and readable in the end."""
    one = Bench()
    yield one
    one.close()
    assert all(messages(file) is not None for files in one.writer.files.values() for file in files)

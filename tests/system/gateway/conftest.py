"""What tests of the desk share."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from tests.support.processes.desk import chromium


@pytest.fixture(scope="module")
def running_browser() -> Iterator[Browser]:
    """One Chromium for all tests of a module; each has a context of its own."""
    with chromium() as running:
        yield running

"""Tests of the system go to the workers of pytest-xdist one by one, others file by file."""

from pathlib import Path

import pytest

from tests.support.spreading import scope_of

ROOT = Path(__file__).parents[2]
SYSTEM = "tests/system/test_signed.py"
SHARED = "tests/system/gateway/zenoh/test_access.py"
UNIT = "tests/unit/test_spreading.py"


@pytest.mark.parametrize(
    ("nodeid", "scope"),
    [
        (f"{SYSTEM}::test_one", f"{SYSTEM}::test_one"),
        (f"{SYSTEM}::test_one[tests/unit::2]", f"{SYSTEM}::test_one[tests/unit::2]"),
        (f"{SHARED}::test_one", SHARED),
        (f"{UNIT}::test_one[a::b]", UNIT),
        (f"{UNIT}::TestClass::test_one", UNIT),
    ],
)
def test_only_tests_of_the_system_that_share_nothing_go_one_by_one(nodeid: str, scope: str) -> None:
    """Those of a file with a fixture for all of them stay together, and so do those that only reckon."""
    assert scope_of(nodeid, ROOT) == scope

import pytest

from recorder.zenoh.session import key_matches
from tests.support.backfill_logs import GEAR


@pytest.mark.parametrize(
    ("expression", "topic", "expected"),
    [
        ("fleet/**", GEAR, True),
        ("fleet/*/chassis/*", GEAR, True),
        (GEAR, GEAR, True),
        ("fleet/cruiser-2/**", GEAR, False),
        ("fleet/**", "fleet/@recorder/depot/health", False),
        ("no//key", GEAR, False),
        ("@more", "@more", True),
        ("", GEAR, False),
        ("fleet/**", "no//key", False),
    ],
)
def test_keys_match_as_they_do_in_zenoh(expression: str, topic: str, expected: bool) -> None:  # noqa: FBT001 - pytest gives it
    """What is no key expression matches nothing but itself."""
    assert key_matches(expression, topic) == expected

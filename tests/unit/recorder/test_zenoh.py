import pytest

from recorder.replay import key_checked, key_matches
from schemas.command_line import CommandError, ExitCode


def test_a_key_expression_is_checked_before_anything_is_sent() -> None:
    """And brought into Zenoh's form."""
    assert key_checked("fleet/**/**") == "fleet/**"
    with pytest.raises(CommandError, match="no key expression") as caught:
        key_checked("fleet//x")
    assert caught.value.code is ExitCode.USAGE


@pytest.mark.parametrize(
    ("expression", "topic", "expected"),
    [
        ("fleet/**", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/*/chassis/*", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/cruiser-1/chassis/gear", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/cruiser-2/**", "fleet/cruiser-1/chassis/gear", False),
        ("fleet/**", "fleet/@recorder/depot/health", False),
        ("no//key", "fleet/cruiser-1/chassis/gear", False),
        ("@more", "@more", True),
        ("", "fleet/cruiser-1/chassis/gear", False),
        ("fleet/**", "no//key", False),
    ],
)
def test_keys_match_as_they_do_in_zenoh(expression: str, topic: str, expected: bool) -> None:  # noqa: FBT001 - pytest gives it
    """What is no key expression matches nothing but itself."""
    assert key_matches(expression, topic) == expected

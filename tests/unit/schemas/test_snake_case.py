"""CamelCase to snake_case."""

import pytest

from schemas.can_word import snake_case


@pytest.mark.parametrize(
    ("camel", "snake"),
    [
        ("RearLeftSpeed", "rear_left_speed"),
        ("Active", "active"),
        ("CanFrames", "can_frames"),
        ("Horn2Active", "horn2_active"),
        ("already_snake", "already_snake"),
        ("", ""),
    ],
)
def test_a_word_begins_where_a_capital_follows_a_small_letter_or_a_digit(camel: str, snake: str) -> None:
    """What is in snake_case already stays as it is."""
    assert snake_case(camel) == snake

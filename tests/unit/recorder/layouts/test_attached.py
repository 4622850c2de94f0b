"""The layouts that a recorder attaches to each log."""

from recorder.layouts.attached import COUNT, RobotKeys, layouts

LARGEST_BYTES = 16_000
"""All of them: each file of a recording repeats them."""


def test_they_are_few_and_small_and_always_the_same() -> None:
    """As many as room is kept for."""
    made = layouts(RobotKeys("fleet/cruiser-1", "can0"))
    assert len(made) == len({layout.name for layout in made}) == COUNT
    assert sum(len(layout.data) for layout in made) < LARGEST_BYTES
    assert made == layouts(RobotKeys("fleet/cruiser-1", "can0"))

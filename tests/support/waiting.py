"""Waiting for conditions with a deadline, never for luck."""

import time
from collections.abc import Callable

DEADLINE_S = 60.0  # only keeps a failure from hanging


def nothing() -> None:
    """Do nothing between two looks."""


def wait_until(
    condition: Callable[[], object], act: Callable[[], None] = nothing, *, deadline_s: float = DEADLINE_S
) -> None:
    """Look, act, and look again until the condition holds."""
    end_s = time.monotonic() + deadline_s
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError(f"{condition} never came true")
        act()
        time.sleep(0.01)


class StopWhen:
    """A command's ``stopped``: acts at each call, and is true once the condition holds."""

    def __init__(self, condition: Callable[[], bool], act: Callable[[], None] = nothing) -> None:
        self._condition = condition
        self._act = act
        self._deadline_s = time.monotonic() + DEADLINE_S

    def __call__(self) -> bool:
        if time.monotonic() > self._deadline_s:
            raise TimeoutError(f"{self._condition} never came true")
        self._act()
        return self._condition()

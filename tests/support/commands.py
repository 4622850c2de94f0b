"""Commands of ``cruiser``, run in this process as a user runs them."""

import argparse
from collections.abc import Callable
from typing import Protocol

from recorder.cli import review as review_command
from schemas.settings import Settings


class Command(Protocol):
    """The module of a command."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare its words."""

    def run(self, arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
        """Run it; the exit code."""


def run_command(
    command: Command, *words: object, settings: Settings | None = None, stopped: Callable[[], bool] = lambda: False
) -> int:
    """Run the command of a module with these words, until ``stopped``; its exit code."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return command.run(parser.parse_args([str(word) for word in words]), settings or Settings(), stopped)


def review(*words: object, is_stopped: bool = False) -> int:
    """``cruiser review`` with these words; its exit code."""
    return run_command(review_command, *words, stopped=lambda: is_stopped)

"""Commands of ``cruiser``, run in this process as a user runs them."""

import argparse
import signal
from collections.abc import Callable
from types import ModuleType

from gateway.cli.main import main
from recorder.cli import review as review_command
from schemas.settings import Settings


def parsed(command: ModuleType, *words: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def run_command(
    command: ModuleType,
    *words: object,
    settings: Settings | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Run a module's command with these words until ``stopped``. Returns its exit code."""
    code: int = command.run(parsed(command, *words), settings or Settings(), stopped)
    return code


def review(*words: object, is_stopped: bool = False) -> int:
    return run_command(review_command, *words, stopped=lambda: is_stopped)


def in_process(*words: str) -> int:
    """Run a command line in this process, then restore the signal handlers. Returns its exit code."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        return main(words)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)

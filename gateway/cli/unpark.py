"""``cruiser unpark``: allow drive commands to release the parking brake."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from gateway.cli.engaged import add_action_arguments, run_action
from schemas.requests import Unpark
from schemas.settings import Settings

EXAMPLE = """\
  cruiser unpark cruiser-1 --lease 123456789
  cruiser unpark cruiser-1 --seconds 10        engaged and unparked for ten seconds"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_action_arguments(parser, lasts=True)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Do it.

    Raises:
        CommandError: it is refused, or nobody answers.
    """
    return run_action(arguments, settings, stopped, lambda lease: Unpark(lease=lease), lasts=True)

"""``cruiser park``: apply the parking brake."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from gateway.cli.engaged import add_action_arguments, run_action
from schemas.requests import Park
from schemas.settings import Settings

EXAMPLE = """\
  cruiser park cruiser-1
  cruiser park cruiser-1 --lease 123456789"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_action_arguments(parser, lasts=False)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Do it.

    Raises:
        CommandError: it is refused, or nobody answers.
    """
    return run_action(arguments, settings, stopped, lambda lease: Park(lease=lease), lasts=False)

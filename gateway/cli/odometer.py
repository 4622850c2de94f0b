"""``cruiser odometer``: set the total mileage to zero."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from gateway.cli.engaged import add_action_arguments, run_action
from schemas.requests import ClearOdometer
from schemas.settings import Settings

EXAMPLE = """\
  cruiser odometer cruiser-1 --clear"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_action_arguments(parser, lasts=False)
    parser.add_argument("--clear", action="store_true", required=True, help="there is no way back")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Do it.

    Raises:
        CommandError: it is refused, or nobody answers.
    """
    return run_action(arguments, settings, stopped, lambda lease: ClearOdometer(lease=lease), lasts=False)

"""``cruiser light``: headlamp and indicators."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from gateway.cli.engaged import add_action_arguments, run_action
from schemas.requests import Light
from schemas.settings import Settings

EXAMPLE = """\
  cruiser light cruiser-1 --headlamp --left --lease 123456789
  cruiser light cruiser-1 --lease 123456789        all of them off"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_action_arguments(parser, lasts=True)
    for lamp in ("headlamp", "left", "right"):
        parser.add_argument(f"--{lamp}", action="store_true", help="on; off if not given")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Do it.

    Raises:
        CommandError: it is refused, or nobody answers.
    """
    return run_action(
        arguments,
        settings,
        stopped,
        lambda lease: Light(lease=lease, headlamp=arguments.headlamp, left=arguments.left, right=arguments.right),
        lasts=True,
    )

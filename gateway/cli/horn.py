"""``cruiser horn``: sound the horn."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from gateway.cli.engaged import add_action_arguments, run_action
from schemas.requests import Horn
from schemas.settings import Settings

EXAMPLE = """\
  cruiser horn cruiser-1
  cruiser horn cruiser-1 on --lease 123456789"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_action_arguments(parser, lasts=True, default_s=1.0)
    parser.add_argument("switch", nargs="?", choices=["on", "off"], default="on", help="on (the default) or off")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Do it.

    Raises:
        CommandError: it is refused, or nobody answers.
    """
    return run_action(
        arguments, settings, stopped, lambda lease: Horn(lease=lease, on=arguments.switch == "on"), lasts=True
    )

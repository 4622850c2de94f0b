"""``cruiser review``: find the question and run it.

Each question is a module with ``EXAMPLE``, ``DESCRIPTION``, ``add_arguments`` and ``run``, like a command. It is
imported only when it is needed, since some load large libraries.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from importlib import import_module
from shutil import get_terminal_size
from textwrap import fill
from typing import Any, Final

from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review info logs\n  cruiser review QUESTION --help"

QUESTIONS: Final[dict[str, tuple[str, str]]] = {
    "find": ("recorder.cli.find", "find stops, incidents, events, drives and logs in directories"),
    "info": ("recorder.cli.info", "show what logs hold"),
    "check": ("recorder.cli.check", "check whether logs are whole, and what they lack"),
    "events": ("recorder.cli.events", "list what happened, in order: stops, faults, refusals"),
    "why": ("recorder.cli.why", "explain why the robot stopped, or did not move, at a time"),
    "verify": (
        "recorder.cli.verify",
        "prove who commanded, with which grant, and that nothing is missing or changed",
    ),
    "rerun": ("recorder.cli.rerun", "run recorded inputs through today's arbiter again, or with other settings"),
    "report": ("recorder.cli.report", "make one HTML page of a drive"),
    "layouts": ("recorder.cli.layouts", "make layouts of Foxglove, Lichtblick, PlotJuggler and rerun for a log"),
    "replay": ("recorder.cli.replay", "publish a log again on Zenoh"),
    "export": ("recorder.cli.export", "write logs as Parquet or CSV, raw frames for the tools of CAN"),
    "query": ("recorder.cli.query", "ask logs, or an exported dataset, in SQL"),
    "cut": ("recorder.cli.cut", "cut a part out of a log, as a log"),
    "recover": ("recorder.cli.recover", "make logs whole that their recorder could not finish"),
}
"""Each question's module, and its line in the help."""


class _QuestionParser(argparse.ArgumentParser):
    """A question's parser, which declares its flags when it is used."""

    def __init__(self, *, module: str, **given: Any) -> None:  # noqa: ANN401 - argparse's own arguments
        super().__init__(**given, formatter_class=argparse.RawDescriptionHelpFormatter)
        self._module = module
        self._is_ready = self._is_parsing = False

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        if not self._is_ready:
            module = import_module(self._module)
            # The formatter keeps the examples' lines, and would not break those of the description.
            self.description = fill(module.DESCRIPTION, get_terminal_size().columns - 2)
            self.epilog = f"example:\n{module.EXAMPLE}"
            module.add_arguments(self)
            self._is_ready = True
        if self._is_parsing:
            return super().parse_known_args(args, namespace)
        self._is_parsing = True
        try:
            # Options may stand between a statement and the logs. This calls the present method again.
            return self.parse_known_intermixed_args(args, namespace)
        finally:
            self._is_parsing = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    questions = parser.add_subparsers(
        dest="question", required=True, metavar="QUESTION", parser_class=_QuestionParser
    )
    for name, (module, about) in QUESTIONS.items():
        questions.add_parser(name, help=about, module=module)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    module = import_module(QUESTIONS[arguments.question][0])
    return int(module.run(arguments, settings, stopped))

"""``cruiser review why``: explain why the robot stopped, or did not move."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from textwrap import wrap
from typing import Any, Final

import msgspec

from recorder.cli.asking import Asked, add_logs, end_with, find, in_short, no_robot, progress_bar
from recorder.cli.show import show
from recorder.reading.logs import Faults, logs_of
from recorder.reading.survey import survey
from recorder.reading.times import FORMS, in_words, time_of
from recorder.review.why import Explainer, Explanation
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import Settings

EXAMPLE: Final = """\
  cruiser review why logs                  # the last stop, or the death of a gateway in command
  cruiser review why logs --at 23.3
  cruiser review why logs --at 03:04:05.678 --robot cruiser-1 --json | jq -r '.chain[].text'"""
DESCRIPTION: Final = (
    "Explain why the robot stopped, or did not move, at a time: its motion, the requests and frames that led to "
    "the decision, the actions, what is latched, and the cure. What is not in the log is named. Exit code 1 if "
    "the log does not show the arbiter, or does not cover that time; 3 if a file is not whole."
)

_LAST: Final = "the last stop, or the death of a gateway in command if that was later"

_WIDTH: Final = 110


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help="print one JSON object, with the chain as data")
    parser.add_argument("--at", metavar="TIME", help=f"the moment (default: {_LAST}): {FORMS}")
    parser.add_argument("--robot", metavar="NAME", help="the robot, if the logs hold several")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    asked = find(arguments, settings, stopped)
    at_ns = None if arguments.at is None else time_of(arguments.at, asked.start_ns, asked.end_ns)
    # With hundreds of robots the others' logs need not be opened.
    logs = asked.logs if arguments.robot is None else logs_of(arguments.robot, asked.logs)
    found = survey(logs, asked.faults)
    robot = _robot(arguments.robot, found.robots, asked.faults)
    with progress_bar("why", asked.bytes, stopped) as progress:
        explainer = Explainer(robot, logs, found, asked.faults, progress)
        explanation = explainer.last() if at_ns is None else explainer.at(at_ns)
    show(record_of(explanation, asked.start_ns), describe(explanation, asked), as_json=arguments.json)
    code = end_with(asked.faults)
    return code if code or explanation.is_answered else int(ExitCode.FAILURE)


def _robot(name: str | None, robots: list[str], faults: Faults) -> str:
    """The robot of the question. Raises CommandError if it is not clear, after printing the logs' faults."""
    shown = in_short(robots)
    if not robots:
        raise no_robot(faults)
    if name is None and len(robots) > 1:
        end_with(faults)
        raise CommandError(f"the logs hold several robots: give --robot, one of {shown}", ExitCode.USAGE)
    if name is not None and name not in robots:
        end_with(faults)
        raise CommandError(f"the log holds nothing of {plain(name)}, but of {shown}", ExitCode.USAGE)
    return name or robots[0]


def record_of(explanation: Explanation, start_ns: int) -> dict[str, Any]:
    """The explanation as a JSON object, with each time also in words and relative.

    ``since_s`` counts from the start of the logs, ``from_at_s`` from the moment, negative before it.
    """
    at_ns = explanation.at_ns
    chain = [
        {
            **msgspec.structs.asdict(link),
            "time": None if link.time_ns is None else in_words(link.time_ns),
            "since_s": None if link.time_ns is None else round((link.time_ns - start_ns) / 1e9, 6),
            "from_at_s": None if link.time_ns is None else round((link.time_ns - at_ns) / 1e9, 6),
        }
        for link in explanation.chain
    ]
    return {
        "time": in_words(at_ns),
        "since_s": round((at_ns - start_ns) / 1e9, 6),
        **msgspec.structs.asdict(explanation),
        "chain": chain,
    }


def describe(explanation: Explanation, asked: Asked) -> Iterator[str]:
    at_ns = explanation.at_ns
    since_s = (at_ns - asked.start_ns) / 1e9
    yield f"{explanation.robot} at {since_s:.3f} s, {in_words(at_ns)}: {explanation.headline}"
    yield ""
    for when, clock, step, sentence in chain_in_words(explanation):
        head = f"  {when:>12}  {clock:12}  {step:8}  "
        lines = wrap(plain(sentence), _WIDTH - 12) or [""]
        yield f"{head}{lines[0]}"
        yield from (f"{'':{len(head)}}{line}" for line in lines[1:])


def chain_in_words(explanation: Explanation) -> Iterator[tuple[str, str, str, str]]:
    """Yield time since the moment, time of day (both may be empty), step and sentence of each link."""
    for link in explanation.chain:
        when, clock = "", ""
        if link.time_ns is not None:
            when = f"{(link.time_ns - explanation.at_ns) / 1e9:+.3f} s"
            clock = in_words(link.time_ns).split(" ")[-2]
        yield when, clock, link.step.value, _sentence(link.text)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"

"""``cruiser demo-fleet``: a first fleet in signed mode on this machine: driven, attacked, and what was seen."""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import msgspec

from gateway.cli.child import fresh, load
from gateway.cli.demo_drive import Interrupted
from gateway.cli.fleet_machines import OPERATOR, OPERATOR_LIMIT_MPS, ROBOTS, VIEWER, FleetMachines
from gateway.cli.fleet_story import FleetStory, JudgedFact, line_of
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import Settings

EXAMPLE: Final = """\
  cruiser demo-fleet                   an operator drives; an intruder gets nothing; the operator is locked out
  cruiser demo-fleet --hold            the fleet alone, until Ctrl-C, for clients of your own"""

ATTEMPTS: Final = 3
POLL_S: Final = 0.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.description = (
        f"{parser.description or ''}\n\n"
        "Authority, site, router, two robots, desk, recorder, operator and viewer are let in, each in a\n"
        "directory of its own as if on a machine of its own. What runs are real commands, which it prints.\n"
        "Keys have no passphrase: they are good for this fleet alone."
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("demo-fleet"),
        metavar="DIR",
        help="where the machines' files go, or DIR-2 and so on if that holds something (default demo-fleet)",
    )
    parser.add_argument("--hold", action="store_true", help="let in, start, and keep running until Ctrl-C")
    parser.add_argument("--json", action="store_true", help="print facts, or with --hold the places, as JSON")


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Play the story, as often as a busy machine needs. Exit code 1 if anything is not as it should be.

    Raises:
        CommandError: the fleet cannot be made, or does not start.
    """
    if arguments.log_level == "warning":
        # Whatever is refused is shown as a fact.
        logging.getLogger("gateway.client").setLevel(logging.ERROR)

    def tell(line: str) -> None:
        if not arguments.json:
            sys.stdout.write(f"{line}\n")
            sys.stdout.flush()

    if arguments.hold:
        return _hold(_machines(arguments.out, tell, stopped), arguments, stopped)
    begin_s = time.monotonic()
    machines, facts = _play(arguments.out, stopped, tell)
    if arguments.json:
        summary = {"directory": str(machines.directory), "facts": facts, "holds": code_of(facts) is ExitCode.OK}
        sys.stdout.write(f"{msgspec.json.encode(summary).decode()}\n")
    tell(describe(facts))
    tell(f"{time.monotonic() - begin_s:.0f} s. Files, log and keys: {machines.directory}")
    return int(code_of(facts))


def code_of(facts: Sequence[JudgedFact]) -> ExitCode:
    """The exit code that the facts ask for."""
    return ExitCode.OK if facts and all(fact.holds for fact in facts) else ExitCode.FAILURE


def describe(facts: Sequence[JudgedFact]) -> str:
    """Return the facts and the verdict as text for people."""
    wrong = sum(not fact.holds for fact in facts)
    verdict = f"{wrong} of {len(facts)} NOT AS THEY SHOULD BE" if wrong else "all of it as it should be"
    return "\n".join(["\nwhat was seen", *map(line_of, facts), verdict])


def _play(
    out: Path, stopped: Callable[[], bool], tell: Callable[[str], None]
) -> tuple[FleetMachines, Sequence[JudgedFact]]:
    """Play the story, once more where a busy machine has stopped the robot. Returns the last of them."""
    for attempt in range(1, ATTEMPTS + 1):
        machines = _machines(out, tell, stopped)
        story = FleetStory(machines, stopped, tell)
        try:
            story.play()
        except Interrupted:
            raise
        except CommandError as error:
            if attempt < ATTEMPTS and story.was_held_up:
                sys.stderr.write(f"demo-fleet: {error}. That happens on a busy machine: {load()}. Once more\n")
                continue
            story.judge("the story ends early", str(error), holds=False)
        break
    return machines, story.facts


def _machines(out: Path, tell: Callable[[str], None], stopped: Callable[[], bool]) -> FleetMachines:
    machines = FleetMachines(fresh(out), tell, stopped)
    tell(f"each machine has its files in a directory of its own; all commands run in {machines.directory}")
    return machines


def _hold(machines: FleetMachines, arguments: argparse.Namespace, stopped: Callable[[], bool]) -> int:
    """Keep the fleet running until it is stopped."""
    machines.let_all_in()
    with ExitStack() as stack:
        machines.start_all(stack)
        places = {
            "router": machines.endpoint,
            "robots": list(ROBOTS),
            "operator": str(machines.directory / OPERATOR),
            "viewer": str(machines.directory / VIEWER),
            "directory": str(machines.directory),
        }
        if arguments.json:
            sys.stdout.write(f"{json.dumps(places)}\n")
        else:
            sys.stdout.write(_HELD.format(**places, limit_mps=OPERATOR_LIMIT_MPS, robot=ROBOTS[0]))
        sys.stdout.flush()
        while not stopped():
            machines.check()
            time.sleep(POLL_S)
        machines.end()
    return int(ExitCode.OK)


_HELD: Final = """
the fleet runs until Ctrl-C
  router    {router}
  operator  {operator} (at most {limit_mps:g} m/s)
  viewer    {viewer}
in another terminal:
  cruiser drive {robot} --config {operator}/operator.toml
  cruiser watch {robot} --config {viewer}/viewer.toml
"""

"""``cruiser stop``: the remote stop of a robot, or of all."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Final

import msgspec

from gateway.cli.operator_arguments import add_operator_arguments
from gateway.client import remote_stop
from gateway.client.reasons_text import LOOK
from gateway.client.remote_stop import NotSentError, StopReport, Unverified
from gateway.client.roll import who_is_there
from gateway.zenoh.client import place
from schemas import keys
from schemas.arguments import robot_name
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.reasons import cure_of
from schemas.settings import Settings

EXAMPLE = """\
  cruiser stop cruiser-1
  cruiser stop --all"""

BUTTON: Final = "Use the button on the robot"
BUTTONS: Final = "Use the buttons on the robots"
NOTHING_SENT: Final = "NOT STOPPED: NOTHING WAS SENT"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.description = (
        f"{parser.description or ''}\n\n"
        "It wants no lease, and is latched until 'cruiser reset'. It is said again and again until it was\n"
        "answered, and the robot is seen to stand. It is no emergency stop: that is the button on the robot."
    )
    parser.add_argument("robot", nargs="?", type=robot_name, metavar="ROBOT", help="the robot")
    parser.add_argument("--all", action="store_true", help="every robot under the root")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    add_operator_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Stop. Exit code 0 if all that are there are seen to stop, 3 if one is not, 4 if all are silent.

    It is 3 too where an answer cannot be verified, and where nobody knows whether those are all.

    Raises:
        CommandError: nobody answered, no session opens, or the arguments are wrong.
    """
    if bool(arguments.robot) is arguments.all:
        raise CommandError("name a robot, or give --all", ExitCode.USAGE)
    robot = arguments.robot or keys.ALL
    report = _stop(arguments, robot, settings, stopped)
    if arguments.json:
        sys.stdout.write(f"{msgspec.json.encode(report).decode()}\n")
    else:
        sys.stdout.writelines(f"{name}: stops, latched until a reset\n" for name in report.stopped)
    sys.stdout.flush()
    for name, why in report.refused.items():
        sys.stderr.write(f"{name}: NOT STOPPED: {plain(why)}. {BUTTON}\n")
    for name, why in report.unconfirmed.items():
        sys.stderr.write(f"{name}: NOT SEEN TO STOP: {plain(why)}. {BUTTON}\n")
    for name, word in report.unverified.items():
        sys.stderr.write(f"{name}: {_unverified(name, word)}\n")
    for name in report.silent:
        sent = "it was sent all the same" if report.linked else "it could NOT BE SENT: there is no link"
        if not report.reached_all:
            sent = f"a viewer's certificate stops one robot at a time: 'cruiser stop {name}'"
        seen = f"; {plain(report.seen[name])}" if name in report.seen else ""
        sys.stderr.write(f"{name}: NO ANSWER; {sent}{seen}. {BUTTON}\n")
    if report.linked and not report.counted:
        sys.stderr.write("there may be more robots: who is connected was not said in time\n")
    waited = "before it was ended" if stopped() else f"within {arguments.timeout:g} s at {place(settings.zenoh)}"
    return int(_code(report, robot, settings, waited))


def _stop(
    arguments: argparse.Namespace, robot: str, settings: Settings, stopped: Callable[[], bool]
) -> StopReport:
    """Stop, and say it first where nothing was sent, or nobody can look: the line with the cause is long."""
    who, button = ("all robots", BUTTONS) if robot == keys.ALL else (robot, BUTTON)
    try:
        report = remote_stop.stop_from_here(settings, robot, arguments.operator or "", arguments.timeout, stopped)
    except NotSentError as error:
        sys.stderr.write(f"{who}: {NOTHING_SENT}. {button}\n")
        raise error.cause from error
    except CommandError:
        sys.stderr.write(f"{who}: NOT SEEN TO STOP: it was sent, and nothing is seen. {button}\n")
        raise
    if robot == keys.ALL and not report.linked:
        sys.stderr.write(f"{who}: {NOTHING_SENT}: there is no link. {button}\n")
    return report


def _unverified(name: str, word: Unverified) -> str:
    """The line on a robot whose answer cannot be verified: what it says, why, and the cure."""
    verdict = "SAYS THAT IT STOPS, NOT VERIFIED" if word.stops else "NOT KNOWN TO STOP, NOT VERIFIED"
    look = LOOK if word.stops else BUTTON
    cure = f". Cure: {cure_of(word.cure, name)}" if word.cure else ""
    return plain(f"{verdict}: {word.says}. This cannot be verified: {word.why}{cure}. {look}")


def _code(report: StopReport, robot: str, settings: Settings, waited: str) -> ExitCode:
    unstopped = report.refused or report.unconfirmed or report.unverified
    if not report.stopped and not unstopped:
        who = "nobody answered" if report.linked else "no Zenoh node answered"
        others = who_is_there(settings, robot) if robot != keys.ALL else ""
        raise CommandError(f"{who} {waited}{others}", ExitCode.UNREACHABLE)
    return ExitCode.PARTIAL if report.silent or unstopped or not report.counted else ExitCode.OK

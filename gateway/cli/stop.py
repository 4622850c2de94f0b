"""``cruiser stop``: the remote stop of a robot, of several, or of all."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import msgspec

from gateway.cli.operator_arguments import add_operator_arguments
from gateway.client import remote_stop
from gateway.client.remote_stop import NotSentError, StopReport, who_is_there
from schemas import keys
from schemas.arguments import robot_names
from schemas.command_line import CommandError, ExitCode, plain
from schemas.reasons import cure_of
from schemas.settings import Settings
from schemas.zenoh_session import place

EXAMPLE = """\
  cruiser stop cruiser-1
  cruiser stop cruiser-1 'depot-*'
  cruiser stop cruiser-1 && cruiser reset cruiser-1
  cruiser stop --all"""

BUTTON: Final = "Use the button on the robot"
BUTTONS: Final = "Use the buttons on the robots"
NOTHING_SENT: Final = "NOT STOPPED: NOTHING WAS SENT"

# fields of a report that name robots
NAMED: Final = ("stopped", "refused", "unconfirmed", "silent", "unverified", "unfinished")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        f"{parser.description or ''}\n\n"
        "Needs no lease, and is latched until 'cruiser reset'. Repeats the stop until the robot has replied and\n"
        "its feedback shows standstill, then waits for the end of the stop sequence: no reset works before.\n"
        "Not an emergency stop: that is the button on the robot."
    )
    about = "robots; '*' stands for any characters, as in 'cruiser-1*'"
    parser.add_argument("robots", nargs="*", type=robot_names, metavar="ROBOT", help=about)
    parser.add_argument("--all", action="store_true", help="all robots under the root")
    parser.add_argument(
        "--no-wait", dest="wait", action="store_false", help="no wait for the end of the stop sequences"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object")
    add_operator_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Stop. Exit code 0 if all robots are seen to stop, 3 if one is not or may not be, 4 if none replies."""
    if bool(arguments.robots) is arguments.all:
        raise CommandError("name a robot, or give --all", ExitCode.USAGE)
    robots = list(dict.fromkeys(arguments.robots)) or [keys.ALL]
    # Each in its own time: none waits for another, nor for another's words.
    with ThreadPoolExecutor(len(robots)) as threads:
        stops = [threads.submit(_stop, arguments, robot, settings, stopped) for robot in robots]
    reports = [stop.result() for stop in stops]
    if arguments.json:
        sys.stdout.write(f"{msgspec.json.encode(_together(reports)).decode()}\n")
        sys.stdout.flush()
    waited = "before Ctrl-C" if stopped() else f"within {arguments.timeout:g} s at {place(settings.zenoh)}"
    return int(_code(_together(reports), robots, settings, waited))


def _tell(report: StopReport, *, as_json: bool) -> None:
    """Print the report as soon as it is known. JSON is printed at the end."""
    if not as_json:
        sys.stdout.write("".join(f"{name}: stopped, latched until a reset\n" for name in report.stopped))
        sys.stdout.flush()
    for name, why in report.refused.items():
        sys.stderr.write(f"{name}: NOT STOPPED: {plain(why)}. {BUTTON}\n")
    for name, why in report.unconfirmed.items():
        sys.stderr.write(f"{name}: NOT CONFIRMED STOPPED: {plain(why)}. {BUTTON}\n")
    for name, unmet in report.unverified.items():
        cure = f". Cure: {cure_of(unmet.cure, name)}" if unmet.cure else ""
        sys.stderr.write(f"{name}: REPLY NOT VERIFIED: {plain(f'{unmet.text}{cure}')}. {BUTTON}\n")
    for name in report.silent:
        sent = "the stop was sent" if report.linked else "the stop was NOT SENT: no link"
        if not report.reached_all:
            sent = f"a viewer's certificate stops one robot at a time: 'cruiser stop {name}'"
        sys.stderr.write(f"{name}: NO REPLY; {sent}. {BUTTON}\n")
    if report.linked and not report.counted:
        sys.stderr.write("there may be more robots: the list of connected robots did not arrive in time\n")


def _together(reports: list[StopReport]) -> StopReport:
    """Merge reports, and name each robot once."""

    def joined(field: str) -> Any:  # noqa: ANN401 - lists, and maps
        found = [getattr(one, field) for one in reports]
        if isinstance(found[0], dict):
            return {name: why for one in found for name, why in one.items()}
        return sorted({name for one in found for name in one}, key=keys.in_order)

    named = {field: joined(field) for field in NAMED}
    return StopReport(
        **named,
        linked=any(one.linked for one in reports),
        counted=all(one.counted for one in reports),
        reached_all=all(one.reached_all for one in reports),
    )


def _stop(
    arguments: argparse.Namespace, robot: str, settings: Settings, stopped: Callable[[], bool]
) -> StopReport:
    """Stop a robot or a pattern. Print first if nothing was sent or seen: the line with the cause is long."""
    who, button = "all robots" if robot == keys.ALL else robot, BUTTONS if "*" in robot else BUTTON
    silent: list[str] = []

    def tell(report: StopReport) -> None:
        if robot == keys.ALL and not report.linked:
            sys.stderr.write(f"{who}: {NOTHING_SENT}: no link. {button}\n")
        if "*" in robot and robot != keys.ALL and not any(getattr(report, field) for field in NAMED):
            # A pattern without replies counts as silent.
            silent.append(robot)
        _tell(msgspec.structs.replace(report, silent=silent or report.silent), as_json=arguments.json)

    try:
        report = remote_stop.stop_from_here(
            settings, robot, arguments.operator or "", arguments.timeout, stopped, wait=arguments.wait, told=tell
        )
    except NotSentError as error:
        sys.stderr.write(f"{who}: {NOTHING_SENT}. {button}\n")
        raise error.cause from error
    except CommandError:
        sys.stderr.write(f"{who}: NOT CONFIRMED STOPPED: the stop was sent, but no state arrives. {button}\n")
        raise
    for name in report.unfinished:
        sys.stderr.write(f"{name}: at standstill, but its stop sequence has not ended: 'cruiser why {name}'\n")
    return msgspec.structs.replace(report, silent=silent or report.silent)


def _code(report: StopReport, robots: list[str], settings: Settings, waited: str) -> ExitCode:
    unstopped = report.refused or report.unconfirmed or report.unverified
    if not report.stopped and not unstopped:
        who = "no robot replied" if report.linked else "no Zenoh node answered"
        others = who_is_there(settings, robots[0]) if len(robots) == 1 and "*" not in robots[0] else ""
        raise CommandError(f"{who} {waited}{others}", ExitCode.UNREACHABLE)
    is_partial = report.silent or unstopped or report.unfinished or not report.counted
    return ExitCode.PARTIAL if is_partial else ExitCode.OK

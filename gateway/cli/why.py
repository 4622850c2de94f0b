"""``cruiser why``: why a robot does not move."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Collection
from typing import Final

import msgspec

from gateway.cli.operator_arguments import add_robot_arguments, connect
from gateway.client.refusal import (
    Refused,
    Unreachable,
    event_line,
    is_idle,
    link_line,
    reason_line,
    state_line,
    text_of,
)
from gateway.client.robot import Robot
from schemas.command_line import ExitCode, plain
from schemas.reasons import Reason
from schemas.settings import Settings

EXAMPLE = """\
  cruiser why cruiser-1
  cruiser why cruiser-1 --json | jq -r '.blocked_by[].cure'"""

EVENTS_SHOWN: Final = 5

POLL_S: Final = 0.02

EVENTS_S: Final = 0.3  # past events come a moment after the state
HEALTH_S: Final = 1.2  # the longest wait for the gateway's health, which is published once a second


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_robot_arguments(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Print what blocks the robot. Exit code 1 if something does, 0 if only a driver is missing.

    In signed mode a robot that cannot be verified is asked too, because its own keys may be the cause. Its answer
    is marked, and the exit code is 1.
    """
    try:
        with connect(arguments, settings, stopped) as robot:
            return _report(robot, arguments, None)
    except Refused as refusal:
        unsigned = msgspec.structs.replace(settings.authority, mode="open")
        try:
            with connect(arguments, msgspec.structs.replace(settings, authority=unsigned), stopped) as robot:
                return _report(robot, arguments, refusal)
        except Unreachable:
            raise refusal from None


def _report(robot: Robot, arguments: argparse.Namespace, unmet: Refused | None) -> int:
    """Print what blocks a robot; ``unmet`` says why it cannot be verified."""
    time.sleep(EVENTS_S)
    deadline_s = time.monotonic() + HEALTH_S - EVENTS_S
    while (sighting := robot.state()).health is None and time.monotonic() < deadline_s:
        time.sleep(POLL_S)
    events = robot.events()[-EVENTS_SHOWN:]
    state, health = sighting.state, sighting.health
    slowed_by = [Reason.NO_REALTIME] if health is not None and not health.realtime else []
    notes = health.notes if health is not None else []
    travel_mps = state.travel_speed_limit_mps
    if travel_mps is not None and travel_mps < min(state.speed_limit_mps, abs(state.target_speed_mps)):
        slowed_by.insert(0, Reason.LINK_TOO_SLOW)
    if arguments.json:
        record = {
            "robot": robot.name,
            "age_s": sighting.age_s,
            "state": state,
            "blocked_by": _in_words(state.blocked_by, robot.name),
            "slowed_by": _in_words(slowed_by, robot.name),
            "notes": notes,
            "events": events,
        }
        if unmet is not None:
            record["unverified"] = {"reason": unmet.reason, "detail": unmet.detail, "cure": unmet.cure}
        sys.stdout.write(f"{msgspec.json.encode(record).decode()}\n")
    else:
        if unmet is not None:
            # The cure of some is this command.
            cure = "" if "cruiser why" in unmet.cure else f" -> {plain(unmet.cure)}"
            why = f"{plain(unmet.detail)} ({unmet.reason.value}){cure}"
            sys.stdout.write(f"{robot.name}: UNVERIFIED: {why}\n")
        sys.stdout.write(f"{robot.name}: {state_line(state)}\n")
        sys.stdout.write(f"  link: {link_line(state) or 'no drive commands'}\n")
        sys.stdout.writelines(
            f"  {reason_line(reason, robot.name, state.blocked_by)}\n" for reason in state.blocked_by
        )
        if not state.blocked_by:
            sys.stdout.write("  blockers: none\n")
        elif is_idle(state.blocked_by):
            sys.stdout.write("  nothing is wrong: no operator is driving\n")
        sys.stdout.writelines(
            f"  needs attention: {plain(note)}\n" for note in (health.notes if health is not None else ())
        )
        sys.stdout.writelines(f"  slowed by {reason_line(reason, robot.name)}\n" for reason in slowed_by)
        if events:
            sys.stdout.write("last events:\n")
            now_ns = state.time_ns + round(sighting.age_s * 1e9)
            sys.stdout.writelines(f"  {event_line(event, now_ns)}\n" for event in events)
    return int(ExitCode.OK if is_idle(state.blocked_by) and unmet is None else ExitCode.FAILURE)


def _in_words(reasons: Collection[Reason], robot: str) -> list[dict[str, object]]:
    return [{"reason": reason, **msgspec.structs.asdict(text_of(reason, robot, reasons))} for reason in reasons]

"""``cruiser record status`` and ``mark``: requests to a running recorder, and the check of roles.

A router denies silently what a role may not do, so the role is checked first.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import closing
from pathlib import Path
from typing import Final

import msgspec

from recorder.zenoh.remote_control import RecorderClient
from schemas import keys
from schemas.arguments import add_zenoh_arguments, operator_name, recorder_name, robot_name, seconds
from schemas.command_line import CommandError, ExitCode, plain
from schemas.keys import login_operator
from schemas.recording import Mark, RecorderHealth, RecorderReply, Status
from schemas.settings import Settings, ZenohSettings
from schemas.zenoh_session import of_file

CERTIFICATE: Final = "transport/link/tls/connect_certificate"

RECORDING: Final = frozenset({"recorder", "router"})
ORDERING: Final = frozenset({"operator", "desk", "router"})

_PROVISIONED: Final = frozenset({"robot", "viewer"}) | RECORDING | ORDERING
"""Roles of 'cruiser provision'; the rights of others are unknown."""


def check_role(settings: ZenohSettings, roles: Collection[str], allowed: str) -> None:
    """Check that this machine's certificate is of one of these roles; ``allowed`` is the rule, and the cure."""
    file = str(of_file(settings, CERTIFICATE) or "")
    if not file:
        return
    from schemas.authority.key_files import certificate_role  # noqa: PLC0415 - only with a certificate

    role = certificate_role(Path(file))
    if role in _PROVISIONED and role not in roles:
        raise CommandError(f"{plain(file)} is a certificate of the role {role}: {allowed}", ExitCode.USAGE)


def check_recording(settings: ZenohSettings, expressions: Sequence[str]) -> None:
    """Check that routers let this machine receive these key expressions."""
    if any("**" in expression for expression in expressions):
        check_role(
            settings,
            RECORDING,
            "routers let only recorders receive everything; make a recorder's keys by 'cruiser provision recorder "
            "NAME', or name single subjects by -k",
        )


Replies = list[tuple[str, RecorderReply]]
"""Replies with the recorder's name; two on different hosts may have the same one."""

ABOUT: Final = {
    "status": "state, counts and losses of recorders",
    "mark": "record the time around now as an incident",
}

TIMEOUT_S: Final = 3.0  # of the search for recorders, and of the reply
LOOK_S: Final = 0.3  # timeout of one query of the search


def add_arguments(parser: argparse.ArgumentParser, action: str) -> None:
    parser.add_argument(
        "recorder",
        nargs="?",
        type=recorder_name,
        default=None,
        metavar="RECORDER",
        help="the recorder's name (default: the only one)",
    )
    if action == "mark":
        parser.add_argument(
            "-m", "--text", default="", metavar="TEXT", help="the reason, which is written into the log"
        )
        parser.add_argument(
            "--robot", type=robot_name, default=None, help="the robot whose log is marked (default: all)"
        )
    parser.add_argument(
        "--operator",
        type=operator_name,
        default=None,
        metavar="NAME",
        help="operator's name (default: login name)",
    )
    parser.add_argument(
        "--timeout", type=seconds, default=TIMEOUT_S, metavar="S", help=f"time to wait (default {TIMEOUT_S:g})"
    )
    add_zenoh_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print each reply as a line of JSON")


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Send a request, and print the replies. ``status`` goes to all recorders, ``mark`` to one."""
    action: str = arguments.action
    check_role(settings.zenoh, ORDERING, "routers let only operators and desks send requests to recorders")
    operator = arguments.operator or login_operator()
    with closing(RecorderClient(settings.zenoh, settings.robot.root, operator, stopped)) as client:
        found = _find(client, arguments, stopped)
        if action == "status":
            replies = found
        else:
            name = _only(found)
            mark = Mark(arguments.text, arguments.robot or "")
            replies = list(client.ask(name, action, mark, arguments.timeout))
            if not replies:
                raise CommandError(f"recorder {name} does not answer", ExitCode.UNREACHABLE)
    for name, reply in sorted(replies, key=lambda one: one[0]):
        sys.stdout.write(_as_json(name, reply) if arguments.json else describe(name, action, reply) + "\n")
    return int(ExitCode.OK if all(reply.ok for _, reply in replies) else ExitCode.REFUSED)


def _find(client: RecorderClient, arguments: argparse.Namespace, stopped: Callable[[], bool]) -> Replies:
    """The status of all recorders, or of the named one."""
    end_s = time.monotonic() + arguments.timeout
    while not stopped():
        found = list(client.ask(arguments.recorder or keys.ALL, "status", Status(), LOOK_S))
        if found:
            return found
        if time.monotonic() > end_s:
            break
    raise client.no_answer(arguments.recorder or keys.ALL)


def _only(found: Replies) -> str:
    names = {name for name, _ in found}
    if len(names) > 1:
        raise CommandError(f"there are several recorders: {', '.join(sorted(names))}; name one", ExitCode.USAGE)
    return names.pop()


def _as_json(name: str, reply: RecorderReply) -> str:
    # json escapes everything but ASCII, which protects the terminal.
    return json.dumps({"recorder": name, **msgspec.to_builtins(reply)}) + "\n"


def describe(name: str, action: str, reply: RecorderReply) -> str:
    head = f"{name}: {reply.detail}" if reply.ok else f"{name}: refused: {reply.detail}"
    lines = [head, *(f"  {file}" for file in reply.files)]
    if action == "status":
        lines += _health_lines(reply.health)
    # The reply is untrusted: protect the terminal.
    return "\n".join(map(plain, lines))


def _health_lines(health: RecorderHealth) -> list[str]:
    dropped = ", ".join(f"{count} {reason}" for reason, count in health.dropped.items()) or "none"
    running = f"running for {health.uptime_s:.0f} s, version {health.recorder_version}"
    disk = f"{_size(health.disk_used_bytes)} of logs, {_size(health.incident_bytes)} of them incidents"
    return [
        f"  in this state for {health.state_since_s:.0f} s, {running}",
        f"  robots: {health.robots}, keys: {health.keys}, {health.received_per_s:.0f} samples/s",
        f"  {health.received} samples received, {health.missed} missed, {health.written} messages written",
        f"  dropped: {dropped}",
        f"  files: {health.files} open, {health.files_ended} ended; incidents: {health.incidents}",
        f"  disk: {disk}, {_size(health.disk_free_bytes)} free",
        f"  processor: {health.cpu_percent:.0f} %",
    ]


def _size(count: int) -> str:
    return f"{count / 1e9:.1f} GB" if count >= 1e9 else f"{count / 1e6:.1f} MB"

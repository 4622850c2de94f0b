"""Finds the command, reads the configuration, runs it, and turns every expected failure into one clear line.

Each command is a module, or an object in one, with

- ``EXAMPLE``, for its help;
- ``add_arguments(parser)``, which declares its flags. A ``dest`` with a dot, ``can.channel``, sets that setting;
- ``run(arguments, settings, stopped)``, which returns the exit code. SIGINT, SIGTERM and SIGHUP make ``stopped()``
  true.

It is imported only when it is asked for, so that ``cruiser --help`` answers at once. This table alone names
commands of both the gateway and the recorder; it does so by name, and neither package imports the other.
"""

from __future__ import annotations

import argparse
import logging
import os
import shlex
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from io import TextIOWrapper
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Final

from gateway.cli.parent import end_with_parent

if TYPE_CHECKING:
    from schemas.command_line import CommandError

GROUPS: Final[dict[str, dict[str, tuple[str, str]]]] = {
    "try it": {
        "demo": ("gateway.cli.demo", "run a virtual robot, a recorder and two operators; with --desk a fleet"),
        "sim": ("gateway.cli.sim", "run a virtual chassis on a CAN bus"),
        "fault": ("gateway.cli.sim_fault", "cause a fault in a running virtual chassis"),
    },
    "on a robot": {
        "setup": ("gateway.cli.setup", "set this computer up as a robot's gateway"),
        "gateway": ("gateway.cli.gateway", "connect a chassis to Zenoh"),
        "halt": ("gateway.cli.halt", "stop a robot that no gateway commands"),
        "doctor": ("gateway.cli.doctor", "find what is wrong with a robot, and the cure"),
        "decode": ("gateway.cli.decode", "decode candump lines to JSON lines"),
    },
    "operate": {
        "list": ("gateway.cli.list_robots", "list all robots, lost ones too: state, speed, driver, health"),
        "watch": ("gateway.cli.watch", "show a robot live; without a name all robots"),
        "desk": ("gateway.cli.desk", "see, drive and stop a fleet in a browser"),
        "ros": ("gateway.cli.ros", "put robots on a ROS 2 graph; with --drive take its commands"),
        "view": ("recorder.cli.view", "show robots live in Foxglove and Lichtblick"),
        "drive": ("gateway.cli.drive", "drive a robot with the keys of a terminal, or from a script"),
        "stop": ("gateway.cli.stop", "stop a robot, several, or all: the remote stop"),
        "why": ("gateway.cli.why", "explain why a robot does not move"),
        "reset": ("gateway.cli.reset", "clear a robot's latches, so that it can be engaged again"),
        "lease": ("gateway.cli.lease", "show, acquire, take or keep the right to command a robot"),
        "park": ("gateway.cli.verbs:PARK", "engage a robot and apply its parking brake"),
        "unpark": ("gateway.cli.verbs:UNPARK", "engage a robot and let drive commands release its parking brake"),
        "light": ("gateway.cli.verbs:LIGHT", "engage a robot and switch headlamp and indicators"),
        "horn": ("gateway.cli.verbs:HORN", "engage a robot and sound its horn"),
        "odometer": ("gateway.cli.verbs:ODOMETER", "set a robot's total mileage, or its odometry's pose, to zero"),
    },
    "record and review": {
        "record": ("recorder.cli.record", "write MCAP logs"),
        "upload": ("recorder.cli.upload", "copy finished logs to an object store, incidents first"),
        "review": ("recorder.cli.review", "find, explain, check and export what is in logs"),
    },
    "run a fleet": {
        "provision": ("gateway.cli.provision", "make keys, certificates and grants"),
        "router": ("gateway.cli.router", "run a Zenoh router that grants access by role"),
        "metrics": ("gateway.cli.metrics", "serve a fleet's health to Prometheus"),
    },
}
"""Commands by group: name, module (and object in it), line in the help."""

COMMANDS: Final = {name: row for commands in GROUPS.values() for name, row in commands.items()}

TAKE_HANGUPS: Final = frozenset({"record"})
"""Commands that handle SIGHUP themselves; until they do, it is ignored. Others end on it as on SIGTERM."""

END_AT_ONCE: Final = frozenset({"upload"})
"""Commands whose process ends without Python's finalization, which a thread of obstore turns into an abort."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``cruiser``, and return the exit code; commands of ``END_AT_ONCE`` do not return."""
    # Until a command takes its signals, Ctrl-C ends the process at once, without a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if sys.stdout is None or sys.stderr is None:
        # A closed stream is None. Nothing is left to say there, but a command need not know that.
        nowhere = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - it lives as long as the process
        sys.stdout, sys.stderr = sys.stdout or nowhere, sys.stderr or nowhere
    for stream in (sys.stdout, sys.stderr):
        # Logs hold any text, and a terminal's encoding may lack some of it.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    words = list(sys.argv[1:] if argv is None else argv)
    end_with_parent()
    code = _written_answer(words)
    if words and words[0] in END_AT_ONCE:
        sys.stderr.flush()
        os._exit(code)
    return code


def _written_answer(words: list[str]) -> int:
    """Run the command, and flush its output."""
    try:
        code = _answer(words)
        sys.stdout.flush()
    except BrokenPipeError:
        _silence_stdout()
        return 0
    except OSError as error:
        _silence_stdout()
        logging.getLogger(__name__).debug("where that came from", exc_info=True)
        sys.stderr.write(f"cruiser {' '.join(words[:1])}: {error.strerror or error}\n")
        return 1
    return code


def _silence_stdout() -> None:
    """Discard further output: its reader has gone, as with '| head', or its disk is full."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _answer(words: list[str]) -> int:
    if words[:1] == ["help"] and words[1:]:
        words = [*words[1:], "--help"]
    if not words or words[0] in {"-h", "--help", "help"}:
        print(_help())  # noqa: T201 - the help is this command's output
        return 0 if words else 2
    if words[0] == "--version":
        from importlib.metadata import version  # noqa: PLC0415 - only when asked for

        print(f"cruiser {version('cruiser-gateway')}")  # noqa: T201 - the version is the output
        return 0
    if words[0] not in COMMANDS:
        from difflib import get_close_matches  # noqa: PLC0415 - only for a mistake

        near = get_close_matches(words[0], COMMANDS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else "; 'cruiser --help' lists them"
        sys.stderr.write(f"cruiser: unknown command {words[0]!r}{hint}\n")
        return 2
    return _run(words[0], words[1:])


def _help() -> str:
    lines = [
        "usage: cruiser COMMAND [...]",
        "",
        "Connects drive-by-wire robots to Zenoh, safely; records and reviews their logs.",
    ]
    width = max(map(len, COMMANDS))
    for group, commands in GROUPS.items():
        lines += ["", f"{group}:", *(f"  {name:{width}}  {about}" for name, (_, about) in commands.items())]
    lines += ["", "'cruiser help COMMAND' explains a command, with an example."]
    lines += ["exit codes: 0 ok, 1 findings or failure, 2 usage, 3 partial, 4 unreachable, 5 refused"]
    return "\n".join(lines)


def _run(name: str, words: list[str]) -> int:
    place, about = COMMANDS[name]
    if name in TAKE_HANGUPS and signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
        signal.signal(signal.SIGHUP, _not_yet)
    # Imported late for the same reason as the commands: they cost more than the help itself.
    from pkgutil import resolve_name  # noqa: PLC0415

    from gateway.cli.configuration_file import load_settings, settings_file, unread_file  # noqa: PLC0415
    from schemas.command_line import CommandError, ExitCode, plain  # noqa: PLC0415

    command = resolve_name(place)
    parser = argparse.ArgumentParser(
        prog=f"cruiser {name}",
        description=about[0].upper() + about[1:] + ".",
        epilog=f"example:\n{command.EXAMPLE}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--config", metavar="FILE", help="TOML file of settings (also CRUISER_CONFIG)")
    parser.add_argument(
        "--log-level",
        default="warning",
        choices=["debug", "info", "warning", "error"],
        help="lowest level of the log on stderr (default warning)",
    )
    command.add_arguments(parser)
    arguments = parser.parse_args(words)
    logging.basicConfig(
        level=arguments.log_level.upper(),
        stream=sys.stderr,
        format="%(asctime)s %(levelname)s %(name)s: %(message)s",
    )
    flags = {key: value for key, value in vars(arguments).items() if "." in key and value is not None}
    try:
        named = settings_file(name, arguments.config, os.environ, getattr(arguments, "action", None))
        settings = load_settings(named, os.environ, flags)
        if file := unread_file(name, named, os.environ, settings):
            sys.stderr.write(
                f"cruiser {name}: warning: open mode, as no settings file was named; {plain(file)} exists and "
                f"was not read; to use it: {plain(shlex.join(['cruiser', name, *words, '--config', file]))}, or "
                "CRUISER_CONFIG\n"
            )
        stopped = _stop_on_signals()
        while True:
            try:
                return int(command.run(arguments, settings, stopped))
            except CommandError as error:
                from gateway.cli.shut_out import has_waited, is_service  # noqa: PLC0415 - the same

                if not is_service(name, arguments) or not has_waited(error, settings.zenoh, stopped):
                    raise
                if stopped():
                    return int(ExitCode.OK)
    except CommandError as error:
        return _fail(name, error)
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


def _fail(name: str, error: CommandError) -> int:
    """Print why the command ended; if no session opened, by the keys and certificates of the Zenoh file."""
    from schemas.command_line import ExitCode  # noqa: PLC0415 - only for a failure
    from schemas.zenoh_session import SessionError  # noqa: PLC0415 - only for a failure

    text, code = str(error), error.code
    if isinstance(error, SessionError):
        from gateway.cli.shut_out import why_away, why_shut_out  # noqa: PLC0415 - only for a failure

        text, code = why_away(error) or text, ExitCode.USAGE if why_shut_out(error.config) else code
    sys.stderr.write(f"cruiser {name}: {text}\n")
    return int(code)


def _not_yet(_number: int, _frame: FrameType | None) -> None:
    """Ignore a signal until the command handles it."""


def _stop_on_signals() -> Callable[[], bool]:
    """Return a flag that SIGINT, SIGTERM and SIGHUP raise; a second SIGINT or SIGTERM ends the process as usual.

    SIGHUP comes twice when a terminal is closed, so the second one is no wish to end at once.
    """
    raised = threading.Event()

    def handle(number: int, _frame: FrameType | None) -> None:
        raised.set()
        if number != signal.SIGHUP:
            signal.signal(number, signal.SIG_DFL if number == signal.SIGTERM else signal.default_int_handler)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handle)
    if signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
        signal.signal(signal.SIGHUP, handle)
    return raised.is_set

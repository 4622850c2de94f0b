"""A first fleet on one machine: a directory for each machine and person, and the commands that run there."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Final

import msgspec

from gateway.cli.child import CRUISER, Child, address_of, free_port
from gateway.cli.configuration_file import load_settings
from gateway.cli.demo_drive import Interrupted
from schemas.exit_codes import CommandError
from schemas.settings import Settings

ROBOTS: Final = ("cruiser-1", "cruiser-2")
OPERATOR, VIEWER, SITE, INTRUDER = "ann", "vic", "depot", "mallory"
OPERATOR_LIMIT_MPS: Final = 0.5
HOST: Final = "127.0.0.1"

COMMAND_TIMEOUT_S: Final = 60.0

Newcomer = tuple[str, str, str]
"""Role, name and directory of somebody who is let in."""

MACHINES: Final[tuple[Newcomer, ...]] = (
    ("router", HOST, "router"),
    *(("robot", name, name) for name in ROBOTS),
    ("recorder", "archive", "recorder"),
    ("desk", HOST, "desk"),
    ("site", SITE, SITE),
)
PEOPLE: Final[tuple[Newcomer, ...]] = (("operator", OPERATOR, OPERATOR), ("viewer", VIEWER, VIEWER))


class Done(msgspec.Struct, frozen=True):
    """The result of a command.

    Attributes:
        code: its exit code.
        text: all of its output.
    """

    code: int
    text: str

    @property
    def last(self) -> str:
        """The last line, without the command's name."""
        lines = self.text.strip().splitlines() or [""]
        return lines[-1].partition(": ")[2] if lines[-1].startswith("cruiser ") else lines[-1]


class FleetMachines:
    """Runs real commands for machines whose files are below one directory, which is where all of them run.

    Attributes:
        directory: absolute.
        endpoint: of the router.
        children: the running processes by name, in the order in which they were started.
    """

    def __init__(self, directory: Path, tell: Callable[[str], None], stopped: Callable[[], bool]) -> None:
        self.directory = directory.absolute()
        self.endpoint = f"tls/{HOST}:{free_port()}"
        self.children: dict[str, Child] = {}
        self._fingerprint = ""
        self._tell = tell
        self._stopped = stopped
        # What is set for another robot, or another fleet, is not meant for this one.
        self._environment = {name: text for name, text in os.environ.items() if not name.startswith("CRUISER_")}
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CommandError(f"cannot write in {directory}: {error.strerror}") from error

    def run(self, *words: str) -> Done:
        """Run a command to its end.

        Raises:
            Interrupted: somebody has ended all of it.
            CommandError: it does not end.
        """
        if self._stopped():
            raise Interrupted
        self._tell(f"  $ cruiser {shlex.join(words)}")
        try:
            done = subprocess.run(  # noqa: S603 - our own command
                [*CRUISER, *words],
                cwd=self.directory,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=COMMAND_TIMEOUT_S,
                check=False,
                start_new_session=True,
            )
        except subprocess.TimeoutExpired as error:
            raise CommandError(f"cruiser {shlex.join(words)} does not end") from error
        return Done(done.returncode, done.stdout)

    def run_all(self, commands: Iterable[Iterable[str]]) -> list[Done]:
        """Run commands at the same time, each to its end."""
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            return list(pool.map(lambda words: self.run(*words), commands))

    def provision(self, commands: Iterable[Iterable[str]]) -> list[Done]:
        """Run ``cruiser provision`` with each of these words, at the same time; all succeed.

        Raises:
            CommandError: one does not; its last line.
        """
        all_done = self.run_all(("provision", *words) for words in commands)
        for done in all_done:
            if done.code:
                raise CommandError(done.last)
        return all_done

    def start(self, stack: ExitStack, name: str, *words: str) -> Child:
        """Start what runs until the end of the stack."""
        self._tell(f"  $ cruiser {shlex.join(words)} &")
        child = stack.enter_context(Child(words[0], words[1:], self.directory, self._environment))
        self.children[name] = child
        return child

    def settings(self, who: str, role: str) -> Settings:
        """The settings of somebody who was let in."""
        return load_settings(str(self.directory / who / f"{role}.toml"), {}, {})

    def let_all_in(self) -> None:
        """Make the authority, and let in machines and people: these by a site, as far as the site may."""
        self._make_authority("")
        self._let_in("authority", MACHINES)
        self._let_in(SITE, PEOPLE)

    def make_intruder(self) -> None:
        """Somebody with an authority of their own, who was let in by that one, and knows ours."""
        self._make_authority(f"{INTRUDER}-")
        self._let_in(f"{INTRUDER}-authority", (("operator", INTRUDER, INTRUDER),))
        # The certificate of an authority is no secret. With it the intruder believes our router.
        ours, theirs = (self.directory / who / "ca.pem" for who in (VIEWER, INTRUDER))
        self._tell(f"  $ cp {VIEWER}/ca.pem {INTRUDER}/ca.pem")
        shutil.copyfile(ours, theirs)

    def start_all(self, stack: ExitStack) -> None:
        """Start chassis, router, recorder and gateways. The recorder is ready before the gateways' samples."""
        buses = {
            robot: self.start(stack, f"chassis of {robot}", "sim", "--listen", f"{HOST}:0") for robot in ROBOTS
        }
        router = self.start(stack, "router", "router", "--directory", "router")
        for robot, chassis in buses.items():
            self._complete(robot, address_of(chassis))
        router.wait_ready()
        words = ("record", "--config", "recorder/recorder.toml", "-o", "recorder/log", "--json")
        self.start(stack, "recorder", *words).wait_ready()
        gateways = [
            self.start(stack, f"gateway of {robot}", "gateway", "--config", f"{robot}/robot.toml")
            for robot in ROBOTS
        ]
        for gateway in gateways:
            gateway.wait_ready()

    def check(self) -> None:
        """Raise a CommandError if anything that was started has ended."""
        for child in self.children.values():
            child.check()

    def end(self) -> None:
        """End all of them, the gateways before the recorder, which receives their last samples.

        Raises:
            CommandError: one ended before, or does not end.
        """
        for name in sorted(self.children, key=lambda name: not name.startswith("gateway")):
            self.children[name].end()

    def _make_authority(self, prefix: str) -> None:
        """Make an authority; its fingerprint is what is compared from then on."""
        standby, authority = f"{prefix}standby", f"{prefix}authority"
        self.provision([("standby", "--directory", standby, "--no-passphrase")])
        words = ("--standby", f"{standby}/standby.pub", "--router", self.endpoint, "--no-passphrase")
        [done] = self.provision([("authority", "--directory", authority, *words)])
        self._fingerprint = done.text.partition("authority ")[2].partition(" ")[0]

    def _let_in(self, issuer: str, newcomers: Iterable[Newcomer]) -> None:
        self.provision((role, name, "--directory", where) for role, name, where in newcomers)
        for role, name, _ in newcomers:
            # One after the other: each gets a number of its own.
            self.provision([("sign", f"{role}-{name}.request", "--directory", issuer, *_GRANTED.get(role, ()))])
        self.provision(
            ("install", f"{role}-{name}.bundle", "--directory", where, "--fingerprint", self._fingerprint)
            for role, name, where in newcomers
        )

    def _complete(self, robot: str, address: str) -> None:
        """Add the settings that ``install`` does not write: the robot's bus, and the directory of its state."""
        state = str(self.directory / robot / "state")
        own = {"can": {"interface": "socketcand", "channel": address}, "gateway": {"state_dir": state}}
        self._tell(f"  robot.toml of {robot} gets its bus, {address}")
        with (self.directory / robot / "robot.toml").open("a", encoding="utf-8") as file:
            for table, entries in own.items():
                file.write(f"\n[{table}]\n")
                file.writelines(f"{key} = {json.dumps(value)}\n" for key, value in entries.items())


_GRANTED: Final = {
    "site": ("--robots", "cruiser-*"),
    "operator": ("--robots", "cruiser-*", "--speed-limit", f"{OPERATOR_LIMIT_MPS:g}"),
}
"""Restrictions of the grants that do not allow everything, as flags, by role."""

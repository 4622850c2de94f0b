"""The machine that ``cruiser setup`` sets up: files that it writes, programs that it runs, each of them said."""

from __future__ import annotations

import os
import pwd
import subprocess
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from gateway.host.computer_look import owning
from gateway.provisioning.key_store import replace_whole
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain

PROGRAM_TIMEOUT_S: Final = 120.0

Program = Callable[[Sequence[str]], str]
"""Runs a program. Returns why it failed; empty if it did not."""


def run_to_end(words: Sequence[str]) -> str:
    """Run a program of the system. Returns why it failed, in one line; empty if it did not."""
    try:
        done = subprocess.run(  # noqa: S603 - programs of the system, named in this tree
            list(words), capture_output=True, text=True, check=False, timeout=PROGRAM_TIMEOUT_S
        )
    except OSError as error:
        return (error.strerror or str(error)).lower()
    except subprocess.TimeoutExpired:
        return f"it did not end within {PROGRAM_TIMEOUT_S:g} s"
    if done.returncode == 0:
        return ""
    said = (done.stderr.strip() or done.stdout.strip()).splitlines()
    return plain(said[-1]) if said else f"exit code {done.returncode}"


class Machine:
    """A machine, or what a test has in its place.

    Attributes:
        root: where its file system begins.
        is_dry: nothing is done, only said.
        has_systemd: it is the machine's first process.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        *,
        is_dry: bool = False,
        root: Path = Path("/"),
        program: Program = run_to_end,
        has_systemd: bool | None = None,
    ) -> None:
        self.root = root
        self.is_dry = is_dry
        self.has_systemd = (root / "run/systemd/system").is_dir() if has_systemd is None else has_systemd
        self._say = say
        self._program = program

    def path(self, name: str) -> Path:
        """Where a file is."""
        return self.root / name.lstrip("/")

    def write(self, name: str, text: str) -> None:
        """Write a file that all may read, whole or not at all. What was there before is kept beside it.

        Raises:
            CommandError: it cannot be written.
        """
        path = self.path(name)
        try:
            before = path.read_text("utf-8") if path.exists() else None
            if before == text:
                self._say(f"{name}: is as it should be")
                return
            kept = f"{path.name}.before-{datetime.now(UTC):%Y%m%dT%H%M%SZ}" if before is not None else ""
            self._say(
                f"{'would write' if self.is_dry else 'writes'} {name}{f', and keeps {kept}' if kept else ''}"
            )
            if self.is_dry:
                for line in text.splitlines():
                    self._say(f"    {line}".rstrip())
                return
            path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
            if before is not None:
                replace_whole(path.with_name(kept), before, 0o644)
            replace_whole(path, text, 0o644)
        except (OSError, UnicodeDecodeError) as error:
            why = (error.strerror or str(error)).lower() if isinstance(error, OSError) else "it is no text"
            raise CommandError(f"{name} cannot be written: {why}") from error

    def run(self, programs: Iterable[Sequence[str]]) -> None:
        """Run programs, one after the other.

        Raises:
            CommandError: one failed, or is not there.
        """
        for words in programs:
            shown = " ".join(words)
            self._say(f"{'would run' if self.is_dry else 'runs'}: {shown}")
            why_not = "" if self.is_dry else self._program(words)
            if why_not:
                raise CommandError(f"'{shown}' failed: {why_not}")

    @contextmanager
    def keys_of(self, service: str) -> Iterator[Path]:
        """The directory of a service's keys, which is made if it is not there; as its user, where root asks.

        Raises:
            CommandError: it cannot be made.
        """
        directory = self.path(f"/etc/cruiser/{service}")
        try:
            if not directory.exists() and not self.is_dry:
                directory.mkdir(mode=0o700, parents=True)
                if os.geteuid() == 0 and (user := _user(f"cruiser-{service}")) is not None:
                    os.chown(directory, user.pw_uid, user.pw_gid)
        except OSError as error:
            raise CommandError(f"{directory} cannot be made: {error.strerror}") from error
        with owning(directory):
            yield directory

    def check_root(self) -> None:
        """Refuse to begin what only root can end.

        Raises:
            CommandError: somebody else asks.
        """
        if not self.is_dry and self.root == Path("/") and os.geteuid() != 0:
            raise CommandError(
                "this writes files of the system: run it as root, or with --dry-run", ExitCode.USAGE
            )


def _user(name: str) -> pwd.struct_passwd | None:
    try:
        return pwd.getpwnam(name)
    except KeyError:
        return None

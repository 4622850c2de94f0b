"""Renewed keys and certificates: seen on the disk, tried, and taken over while the robot stands.

Zenoh reads certificates once, when a session opens, and a gateway its keys when it starts. So a gateway whose
files were replaced starts again by itself: never in a drive, or while anybody holds the lease. What is latched
stays so: see ``gateway.command.carried``.
"""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path
from typing import Final

from gateway.authority.transport import SHUT_OUT_FILE
from gateway.provisioning.key_files import directory_of, read_identity
from gateway.provisioning.tls_files import check_shut_out, check_tls_files, tls_files
from gateway.zenoh.client import close_session, open_session
from schemas.authority.identity import AUTHORITY_FILE, GRANT_FILE, KEY_FILE
from schemas.authority.statement import Grant
from schemas.authority.trust import Objection
from schemas.exit_codes import CommandError
from schemas.settings import Settings
from schemas.zenoh_link import MODE

log = logging.getLogger(__name__)

ROBOT: Final = "robot"

LOOK_S: Final = 1.0
"""Period at which the files are looked at. Two looks have to find the same: an installation writes several."""

LIVES_S: Final = 600.0
"""Period at which the lives of certificates are looked at."""

AGAIN_S: Final = 10.0
"""Period at which files that could not be used are tried again: the router may not accept them yet."""

CLOSE_TIMEOUT_S: Final = 3.0

WAITS: Final = (
    "the keys or certificates were renewed; the gateway starts again with them once the robot stands, and nobody "
    "holds its lease or asks anything for 5 s"
)

FileStamp = tuple[int, int, int, int, int]
Stamp = tuple[FileStamp | None, ...]


class Renewal:
    """Watches the files, on a thread of its own.

    Attributes:
        is_ready: they were replaced, and what is there now can be used.
        is_taken: somebody has begun to start again with them.
    """

    def __init__(self, settings: Settings) -> None:
        """Take the present files as those in use."""
        self.is_ready = False
        self.is_taken = False
        self._settings = settings
        self._connect: list[str] = []
        self._is_watched = settings.authority.mode == "signed"
        self._in_use = self._stamp() if self._is_watched else ()
        self._waiting = self._ending = ""
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, name="renewal", daemon=True)

    def begin(self, connect: list[str]) -> None:
        """Watch from now on; in open mode there is nothing to watch.

        Args:
            connect: endpoints that the gateway dials out to.
        """
        self._connect = connect
        if self._is_watched:
            self._thread.start()

    def notes(self) -> tuple[str, ...]:
        """Return notes for people, each one line."""
        return tuple(filter(None, (self._ending, self._waiting)))

    def close(self) -> None:
        """End, within a bounded time."""
        self._ends.set()
        if self._thread.is_alive():
            self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        before, lives_due_s, try_due_s = self._in_use, 0.0, 0.0
        while not self._ends.is_set():
            now_s = time.monotonic()
            if now_s >= lives_due_s:
                lives_due_s = now_s + LIVES_S
                self._ending = self._noted(self._ending, self._look_at_lives())
            stamp = self._stamp()
            if stamp != before:
                self.is_ready, try_due_s = False, 0.0
            elif stamp != self._in_use and now_s >= try_due_s:
                try_due_s = now_s + AGAIN_S
                fault = self._fault()
                self.is_ready = not fault
                words = f"the renewed files are not used: {fault}" if fault else WAITS
                self._waiting = self._noted(self._waiting, words)
            before = stamp
            self._ends.wait(LOOK_S)

    def _look_at_lives(self) -> str:
        try:
            return self._check_tls()
        except CommandError as error:
            return str(error)

    def _fault(self) -> str:
        """Why the files that are there now cannot be used; empty if they can."""
        directory = directory_of(self._settings.authority)
        try:
            identity = read_identity(directory, ROBOT)
            # At its beginning, if this computer's clock is behind: the gateway knows better what time it is.
            starts = [one.statement.not_before for one in identity.chain if isinstance(one.statement, Grant)]
            held = identity.trust.judge(identity.chain, max([int(time.time()), *starts]))
            if isinstance(held, Objection):
                return f"{directory / GRANT_FILE.format(who=ROBOT)}: {held.text}"
            self._check_tls()
            if (directory / SHUT_OUT_FILE).exists():
                check_shut_out(directory, time.time())
            if self._connect:
                # Somebody who accepts them: a gateway that starts again and finds none would be away.
                close_session(open_session(self._settings.zenoh, self._connect, [], changes={MODE: "client"}))
        except CommandError as error:
            return str(error)
        return ""

    def _check_tls(self) -> str:
        config = self._settings.zenoh.config
        return check_tls_files(Path(config), ROBOT, time.time()) if config else ""

    def _stamp(self) -> Stamp:
        directory, config = directory_of(self._settings.authority), self._settings.zenoh.config
        names = (KEY_FILE.format(who=ROBOT), GRANT_FILE.format(who=ROBOT), AUTHORITY_FILE, SHUT_OUT_FILE)
        files = [directory / name for name in names]
        if config:
            files += [Path(config), *tls_files(Path(config))]
        return tuple(map(_stamp, files))

    @staticmethod
    def _noted(before: str, now: str) -> str:
        if now and now != before:
            log.warning("%s", now)
        return now


def _stamp(file: Path) -> FileStamp | None:
    """Return numbers that change when a file is replaced, or given to others; None if it is missing."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino, found.st_size, found.st_mode, found.st_uid

"""Signed mode on this computer: keys, statements that outlive a restart, and renewed files.

Keys, grants and certificates are read once, at the start. After a new installation the gateway exits as soon as
the robot stands unused, and its service manager starts it again. Without a service manager it stays and says so.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import msgspec

from gateway.authority.admission import SignedAdmission, StatementSieve
from gateway.authority.robot_authority import Kept, RobotAuthority, TimeFloor, resume
from gateway.authority.session import RobotSigner
from gateway.core import Core
from gateway.host.notes import Aside, StateNote, write_whole
from gateway.provisioning.key_files import RENEW_S, certificate_ends_s
from schemas.authority.key_files import AUTHORITY_FILE, GRANT_FILE, directory_of, read_identity, renewed
from schemas.authority.proof import GrantRole, Signed, read_chain
from schemas.authority.trust import Objection, Trust
from schemas.command_line import CommandError, ExitCode, check_regular
from schemas.settings import Settings

log = logging.getLogger(__name__)

CURE: Final = (
    "remove it, start the gateway again, and show the robot the newest list of revocations "
    "('cruiser provision show'), and each rotation since the robot was provisioned"
)


class AuthorityNote(StateNote):
    """Statements of the authority that must outlive a restart.

    Attributes:
        report: called on the writer's thread with the reason why the file could not be written; empty once it was.
    """

    ENDING = "authority.json"

    def __init__(self, path: Path | None) -> None:
        super().__init__(path)
        self.report: Callable[[str], None] = lambda _: None
        self._aside = Aside("authority-note", self._store)

    def read(self) -> Kept | str:
        """Return the statements saved last, none if there is no file; or why it cannot be read, as text."""
        if self.path is None:
            return "gateway.state_dir is empty, but revocations must outlive a restart"
        try:
            check_regular(self.path, self.path.stat().st_mode)
            return msgspec.json.decode(self.path.read_bytes(), type=Kept)
        except FileNotFoundError:
            return Kept()
        except CommandError as error:
            return str(error)
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
            return f"{self.path}, which holds revocations, is damaged: {error}; {CURE}"

    def save(self, kept: Kept) -> None:
        self._aside.add(kept)

    def close(self) -> None:
        self._aside.close()

    def _store(self, kept: Kept) -> None:
        fault = ""
        try:
            if self.path is not None:
                write_whole(self.path, msgspec.json.encode(kept))
        except OSError as error:
            fault = f"{self.path} cannot be written: {error.strerror}"
            log.warning("%s", fault)
        self.report(fault)


BOOT_BYTES: Final = 8

AHEAD_S: Final = 3600  # a note whose time is further ahead of the clock is reported

_DAY_S: Final = 86_400


class SignedMode:
    """The authority of a robot, and its note."""

    def __init__(self, settings: Settings, core: Core) -> None:
        directory = directory_of(settings.authority)
        identity = read_identity(directory, "robot")
        self.certificate_ends_s = certificate_ends_s(settings.zenoh)
        self._note = AuthorityNote.of(settings)
        kept = self._note.read()
        if isinstance(kept, str):
            raise CommandError(kept, ExitCode.USAGE)
        resumed = resume(identity.trust, kept)
        if isinstance(resumed, Objection):
            raise CommandError(f"{self._note.path}: {resumed.text}; {CURE}", ExitCode.USAGE)
        trust, kept = resumed
        ahead_s = kept.floor_s - int(time.time())
        if ahead_s > AHEAD_S:
            log.warning(
                "%s: the newest time in it is %.1f days after this computer's clock, and grants are judged by it. "
                "Set the clock if that is behind; if the time in the file is wrong, %s",
                self._note.path,
                ahead_s / _DAY_S,
                CURE,
            )
        signer = RobotSigner(identity.private, os.urandom(BOOT_BYTES))
        boot_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        self.authority = RobotAuthority(
            settings,
            SignedAdmission(settings, trust, signer, core.challenge_age_ns),
            signer,
            TimeFloor(kept.floor_s, boot_ns),
            _own(identity.chain, kept, trust, settings),
            kept,
        )
        # A statement may arrive before the first tick.
        self.authority.know_time(boot_ns, time.time_ns())
        self._note.report = self._report_unsaved

    def _report_unsaved(self, fault: str) -> None:
        self.authority.unsaved = fault

    def sieve(self) -> StatementSieve[Any]:
        return StatementSieve(self.authority.admission)

    def note(self, now_s: float) -> str:
        """Return a line if the certificate expires soon; else nothing."""
        left_s = RENEW_S if self.certificate_ends_s is None else self.certificate_ends_s - now_s
        ends = f"the robot's certificate ends in {left_s / _DAY_S:.1f} days; {renewed('robot')}"
        return ends if left_s < RENEW_S else ""

    def save(self, kept: Kept) -> None:
        self._note.save(kept)

    def close(self) -> None:
        self._note.close()


def _own(provisioned: list[Signed], kept: Kept, trust: Trust, settings: Settings) -> list[Signed]:
    """Return the chain of the robot's own grant: the shown or the installed one, whichever is valid longer."""
    shown = read_chain(kept.own.encode()) if kept.own else provisioned
    now_s = int(time.time())

    def worth(chain: list[Signed]) -> tuple[bool, int]:
        held = trust.judge(chain, now_s)
        return (False, 0) if isinstance(held, Objection) else (True, held.grant.not_after)

    chain = max(shown, provisioned, key=worth) if isinstance(shown, list) else provisioned
    grant = chain[0].statement
    if getattr(grant, "role", None) is not GrantRole.ROBOT or getattr(grant, "name", "") != settings.robot.name:
        raise CommandError(
            f"{directory_of(settings.authority)}/robot.grant is not of a robot called {settings.robot.name}: "
            "'cruiser provision robot' makes it",
            ExitCode.USAGE,
        )
    return chain


LOOK_NS: Final = 1_000_000_000  # period at which the files are checked while the gateway is not needed

ENDS: Final = "new keys or certificates were installed: the gateway restarts to load them"
WAITS: Final = "new keys or certificates were installed: restart the gateway to load them"

FileStamp = tuple[int, int]


class Renewal:
    """Watches the files that every installation writes."""

    def __init__(self, settings: Settings, *, is_managed: bool) -> None:
        """Take the present files as those in use; ``is_managed``: a service manager restarts the gateway."""
        self.is_taken = False  # they were replaced, and the gateway must exit
        self.note = ""  # a restart is needed, in one line; else empty
        directory = directory_of(settings.authority)
        self._files = [directory / GRANT_FILE.format(who="robot"), directory / AUTHORITY_FILE]
        self._is_managed = is_managed
        self._in_use = self._before = self._stamps()

    def look(self) -> bool:
        """Return True if the gateway must exit: two looks agree, because an installation writes several files."""
        stamps = self._stamps()
        is_new = stamps == self._before != self._in_use and None not in stamps
        self._before = stamps
        self.is_taken = is_new and self._is_managed
        self.note = WAITS if is_new and not self._is_managed else ""
        return self.is_taken

    def ending(self, ends: Callable[[], bool], core: Core) -> Callable[[], bool]:
        """Return the loop's end condition: ``ends``, or new files while the gateway may restart."""
        due_ns = 0

        def is_over() -> bool:
            nonlocal due_ns
            now_ns = time.monotonic_ns()
            if now_ns >= due_ns and not self.is_taken:
                due_ns = now_ns + LOOK_NS
                if core.may_start_again(now_ns) and self.look():
                    core.warn(ENDS, now_ns)
            return self.is_taken or ends()

        return is_over

    def _stamps(self) -> list[FileStamp | None]:
        return [_stamp(file) for file in self._files]


def _stamp(file: Path) -> FileStamp | None:
    """Return values that change when a file is replaced; None if it is missing."""
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino

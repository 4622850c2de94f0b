"""Signed mode on a robot: its keys, its authority, and the statements that it has taken over since."""

from __future__ import annotations

import logging
import os
import time
from typing import Final

from gateway.authority.admission import SignedAdmission
from gateway.authority.floor import TimeFloor
from gateway.authority.robot_authority import Kept, RobotAuthority, resume
from gateway.authority.signer import RobotSigner
from gateway.core import Core
from gateway.host.authority_note import CURE, AuthorityNote
from gateway.provisioning.key_files import directory_of, read_identity
from gateway.provisioning.tls_files import certificate_ends_s
from schemas.authority.proof import GrantRole, Signed, read_chain
from schemas.authority.trust import Objection, Trust
from schemas.command_line import CommandError, ExitCode
from schemas.settings import Settings

BOOT_BYTES: Final = 8

AHEAD_S: Final = 3600
"""A note of a later time than this after the clock's is said."""

_DAY_S: Final = 86_400

log = logging.getLogger(__name__)


class SignedMode:
    """The authority of a robot, and where it keeps what it learns.

    Attributes:
        authority: what the robot knows of it.
        certificate_ends_s: when the certificate ends that the gateway connects with, seconds since 1970.
    """

    def __init__(self, settings: Settings, core: Core) -> None:
        """Read the keys.

        Raises:
            CommandError: a file is missing or wrong; the text names it, and the cure.
        """
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
        # Before the first tick a statement may wait that somebody has shown.
        self.authority.know_time(boot_ns, time.time_ns())
        self._note.report = self._report_unsaved

    def _report_unsaved(self, fault: str) -> None:
        self.authority.unsaved = fault

    def save(self, kept: Kept) -> None:
        """Keep this across a restart, without waiting for the disk."""
        self._note.save(kept)

    def close(self) -> None:
        """Wait for what is being saved."""
        self._note.close()


def _own(provisioned: list[Signed], kept: Kept, trust: Trust, settings: Settings) -> list[Signed]:
    """The chain of the robot's own grant: of what it was shown and what was installed, what holds, and longer."""
    renewed = read_chain(kept.own.encode()) if kept.own else provisioned
    now_s = int(time.time())

    def worth(chain: list[Signed]) -> tuple[bool, int]:
        held = trust.judge(chain, now_s)
        return (False, 0) if isinstance(held, Objection) else (True, held.grant.not_after)

    chain = max(renewed, provisioned, key=worth) if isinstance(renewed, list) else provisioned
    grant = chain[0].statement
    if getattr(grant, "role", None) is not GrantRole.ROBOT or getattr(grant, "name", "") != settings.robot.name:
        raise CommandError(
            f"{directory_of(settings.authority)}/robot.grant is not of a robot called {settings.robot.name}: "
            "'cruiser provision robot' makes it",
            ExitCode.USAGE,
        )
    return chain

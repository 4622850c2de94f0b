"""The note of a robot's total mileage: one that is far off at a start may be that of another chassis.

A computer that was moved to another chassis, or a configuration that was copied with its name, drives on under
that name: logs, grants and people take it for the robot that it was.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import Final, Self

import msgspec

from gateway.host.state_directory import state_directory, write_whole
from schemas.settings import MILEAGE_DIFFERS_KM, Settings

log = logging.getLogger(__name__)

STEP_KM: Final = 0.1
"""The note is written again after this way: a power cut leaves it no further off."""

NOTE_MAX_BYTES: Final = 256


class MileageNote:
    """The file of one robot, read at the start, and written by a thread of its own: a disk may stall."""

    def __init__(self, path: Path | None, name: str) -> None:
        """Read it, and start the thread. A file that is missing or damaged says nothing."""
        self._path = path
        self._name = name
        self._noted_km = None if path is None else _read(path)
        self._is_first = True
        self._waiting: SimpleQueue[float] = SimpleQueue()
        threading.Thread(target=self._run, name="mileage-note", daemon=True).start()

    @classmethod
    def of(cls, settings: Settings, environment: Mapping[str, str] = os.environ) -> Self:
        """The note of the robot that the settings name."""
        directory = state_directory(settings.gateway.state_dir, environment)
        robot = f"{settings.robot.root}/{settings.robot.name}".replace("/", ".")
        return cls(None if directory is None else directory / f"{robot}.mileage.json", settings.robot.name)

    def follow(self, mileage_km: float | None) -> str:
        """Each tick: have the mileage noted if it has changed enough, without waiting.

        Returns:
            Once, after a start with another mileage, the question whether it is the same chassis; else nothing.
        """
        if self._path is None or mileage_km is None or not self._waiting.empty():
            return ""
        noted_km, is_first, self._is_first = self._noted_km, self._is_first, False
        if noted_km is not None and abs(mileage_km - noted_km) < STEP_KM:
            return ""
        self._noted_km = mileage_km
        self._waiting.put(mileage_km)
        if not is_first or noted_km is None or abs(mileage_km - noted_km) <= MILEAGE_DIFFERS_KM:
            return ""
        return (
            f"its mileage reads {mileage_km:.1f} km, and read {noted_km:.1f} km when this computer last saw "
            f"{self._name}: is this the same chassis? If not, give it a name of its own (robot.name)"
        )

    def _run(self) -> None:
        while self._path is not None:
            _write(self._path, self._waiting.get())


def _read(path: Path) -> float | None:
    try:
        with path.open("rb") as file:
            return msgspec.json.decode(file.read(NOTE_MAX_BYTES), type=float)
    except (OSError, ValueError):
        return None


def _write(path: Path, mileage_km: float) -> None:
    try:
        write_whole(path, msgspec.json.encode(mileage_km))
    except OSError as error:
        log.warning("the mileage cannot be noted: %s: %s", path, error.strerror)

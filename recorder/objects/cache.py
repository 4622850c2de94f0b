"""Local copies of logs in object stores, so that each is fetched once.

A copy is fetched in pieces, resumed after an interruption, and valid when it has the store's length and its
manifest's SHA-256, if there is one. The least recently used copies are removed first.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final

import msgspec

from recorder.disk.log_names import lock_own
from recorder.objects.address import Objects, StoreAddress, StoredObject, StoreError, shown_url
from schemas.command_line import CommandError, ExitCode

PIECE_BYTES: Final = 4 * 1024 * 1024  # the longest range of one request
SMALL_MAX_BYTES: Final = 65_536  # a longer manifest or signature is ignored
BESIDE: Final = (".json", ".sig")  # suffixes of a log's manifest and signature
WAIT_S: Final = 0.1  # pause between two looks at a copy that another process is fetching
PART: Final = ".fetched"


class _Manifest(msgspec.Struct):
    """The parts of an upload's manifest used here."""

    bytes: int
    sha256: str


def cache_directory(environment: Mapping[str, str], home: Path) -> Path:
    given = Path(environment.get("XDG_CACHE_HOME", ""))
    return (given if given.is_absolute() else home / ".cache") / "cruiser" / "logs"


class LogCache:
    """The copies in a directory, with a limit of their total size that does not affect logs in use."""

    def __init__(self, directory: Path, limit_bytes: int) -> None:
        self._directory = directory
        self._limit = limit_bytes
        self._wanted: set[Path] = set()  # the copies in use

    def fetch(self, objects: Objects, place: StoreAddress, name: str, progress: Callable[[int], None]) -> Path:
        url = shown_url(place.join(name).url)
        try:
            found = objects.look(name)
            if found is None:
                raise CommandError(f"cannot read {url}: there is no such object")
            mark = f"{place.join(name).url}\0{found.bytes}\0{found.e_tag}"
            home = self._directory / hashlib.sha256(mark.encode()).hexdigest()[:32]
            self._wanted.add(home)
            path = home / (name.rpartition("/")[2])
            home.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not path.exists():
                self._make_room(found.bytes)
                self._fetch(objects, name, found, path, progress)
            else:
                progress(found.bytes)
            os.utime(home)
        except StoreError as error:
            raise CommandError(f"cannot read {url}: {error}", ExitCode.UNREACHABLE) from error
        except OSError as error:
            raise CommandError(
                f"cannot store a copy of {url} in {self._directory}: {error.strerror or error}"
            ) from error
        return path

    def _fetch(
        self, objects: Objects, name: str, found: StoredObject, path: Path, progress: Callable[[int], None]
    ) -> None:
        part = path.with_name(path.name + PART)
        with part.open("ab") as stream:
            while not lock_own(stream.fileno()):
                progress(0)
                time.sleep(WAIT_S)
            if path.exists():  # Another process has fetched it meanwhile.
                progress(found.bytes)
                return
            at = min(stream.tell(), found.bytes)
            stream.truncate(at)
            progress(at)
            for start in range(at, found.bytes, PIECE_BYTES):
                end = min(start + PIECE_BYTES, found.bytes)
                stream.write(objects.read(name, start, end, found.e_tag))
                progress(end - start)
            stream.flush()
            os.fsync(stream.fileno())
            for suffix in BESIDE:
                data = _small(objects, name + suffix)
                if data:
                    path.with_name(path.name + suffix).write_bytes(data)
            if (said := _sha256_of(path)) and said != _sha256(part):
                part.unlink()
                raise StoreError("it differs from the upload: its SHA-256 is not its manifest's")
            part.rename(path)

    def _make_room(self, size: int) -> None:
        """Remove the least recently used copies until another one of this size fits."""
        homes = sorted((one for one in self._directory.iterdir() if one.is_dir()), key=_asked_s)
        sizes = {home: _bytes_in(home) for home in homes}
        total = sum(sizes.values()) + size
        for home in homes:
            if total <= self._limit:
                return
            if home not in self._wanted:
                shutil.rmtree(home, ignore_errors=True)
                total -= sizes[home]


def _small(objects: Objects, name: str) -> bytes:
    """A small object beside a log; empty if there is none, or it is too long."""
    # Without the right to list, a missing object is an error.
    with suppress(StoreError):
        found = objects.look(name)
        if found is not None and 0 < found.bytes <= SMALL_MAX_BYTES:
            return objects.read(name, 0, found.bytes, found.e_tag)
    return b""


def _sha256_of(path: Path) -> str:
    with suppress(OSError, msgspec.MsgspecError, UnicodeDecodeError):
        return msgspec.json.decode(path.with_name(path.name + BESIDE[0]).read_bytes(), type=_Manifest).sha256
    return ""


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _asked_s(home: Path) -> float:
    with suppress(OSError):
        return home.stat().st_mtime
    return 0.0


def _bytes_in(home: Path) -> int:
    with suppress(OSError):
        return sum(one.stat().st_size for one in home.iterdir())
    return 0

"""Logs in object stores, by their cached copies."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import msgspec

from recorder.disk.log_names import PART_SUFFIX, SUFFIX
from recorder.objects.address import SCHEMES, Objects, StoreAddress, StoreError, shown_url
from recorder.objects.cache import LogCache, cache_directory
from recorder.objects.store import ObstoreObjects
from recorder.reading.logs import Faults, LogFile, look_at
from recorder.reading.rows import Progress
from schemas.command_line import CommandError, ExitCode, plain
from schemas.settings import UploadSettings


def find_stored(
    addresses: Sequence[StoreAddress],
    upload: UploadSettings,
    faults: Faults,
    progress_of: Callable[[int], AbstractContextManager[Progress]],
) -> list[LogFile]:
    """Fetch the logs at these addresses, and all logs of a place, into the cache."""
    wanted = {
        place.join(name): (objects, place, name, size)
        for address in addresses
        for objects, place, name, size in _objects_at(address, upload)
    }
    cache = open_cache(upload)
    found = []
    total = sum(size for *_, size in wanted.values())
    with progress_of(total) as progress:
        for address, (objects, place, name, _) in wanted.items():
            try:
                path = cache.fetch(objects, place, name, progress)
                found.append(_look_at(path, address))
            except CommandError as error:
                if error.code is ExitCode.UNREACHABLE or len(wanted) == 1:
                    raise
                faults.add(str(error))
    return found


def _objects_at(address: StoreAddress, upload: UploadSettings) -> Iterator[tuple[Objects, StoreAddress, str, int]]:
    """Yield the logs at an address: objects and address of their place, name and size."""
    if is_log(address.name):
        objects = open_objects(address.parent, upload)
        yield objects, address.parent, address.name, _length_of(objects, address)
        return
    objects = open_objects(address, upload)
    listed = log_names(objects, address)
    if not listed:
        raise CommandError(f"there is no log in {shown_url(address.url)}")
    yield from ((objects, address, name, size) for name, size in listed)


def _length_of(objects: Objects, address: StoreAddress) -> int:
    try:
        found = objects.look(address.name)
    except StoreError as error:
        raise CommandError(f"cannot read {shown_url(address.url)}: {error}", ExitCode.UNREACHABLE) from error
    if found is None:
        raise CommandError(f"cannot read {shown_url(address.url)}: there is no such object")
    return found.bytes


def _look_at(path: Path, address: StoreAddress) -> LogFile:
    """The log of a copy, under its address."""
    try:
        return msgspec.structs.replace(look_at(path), url=address.url)
    except CommandError as error:
        raise CommandError(str(error).replace(plain(str(path)), shown_url(address.url)), error.code) from error


def open_cache(upload: UploadSettings) -> LogCache:
    return LogCache(cache_directory(os.environ, Path.home()), upload.cache_bytes)


def is_log(name: str) -> bool:
    return name.endswith((SUFFIX, PART_SUFFIX))


def log_names(objects: Objects, place: StoreAddress) -> list[tuple[str, int]]:
    """The names and sizes of the logs of a place, by name."""
    if not place.has_list:
        raise CommandError(
            f"{shown_url(place.url)} names no log, and such a server has no list: name one", ExitCode.USAGE
        )
    try:
        return sorted((one.name, one.bytes) for one in objects.names() if is_log(one.name))
    except StoreError as error:
        raise CommandError(f"cannot list {shown_url(place.url)}: {error}", ExitCode.UNREACHABLE) from error


def open_objects(place: StoreAddress, upload: UploadSettings) -> Objects:
    return ObstoreObjects(place, options_of(place, upload))


def options_of(place: StoreAddress, upload: UploadSettings) -> Mapping[str, Any]:
    """The options of the settings that are for a place of this kind."""
    kind = next((one for one in SCHEMES if upload.store.startswith(one)), "")
    if kind in {"", place.scheme}:
        return upload.options
    # Plain HTTP is read only if the options allow it.
    return {key: value for key, value in upload.options.items() if key == "allow_http"}

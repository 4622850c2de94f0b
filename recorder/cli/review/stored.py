"""Logs at addresses in object stores, for the questions that read them there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, BinaryIO

from recorder.disk.log_directory import PART_SUFFIX, SUFFIX
from recorder.objects.address import SCHEMES, StoreAddress, shown_url
from recorder.objects.interface import Objects, StoreError
from recorder.objects.ranged import RangedObject
from recorder.objects.store import ObstoreObjects
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.logs import look_at_stored
from schemas.exit_codes import CommandError, ExitCode
from schemas.recorder_settings import UploadSettings


class LogObject:
    """A log that is an object of a store.

    Args:
        objects: of the place.
        place: the address of that.
        name: of the log in it.

    Attributes:
        url: the address of the log.
        ranged: the bytes of it that have been read.

    Raises:
        CommandError: it is not there, or the store does not answer.
    """

    def __init__(self, objects: Objects, place: StoreAddress, name: str) -> None:
        self.url = place.join(name).url
        try:
            found = objects.look(name)
        except StoreError as error:
            raise CommandError(f"cannot read {shown_url(self.url)}: {error}", ExitCode.UNREACHABLE) from error
        if found is None:
            raise CommandError(f"cannot read {shown_url(self.url)}: there is no such object")
        self.size = found.bytes
        self.ranged = RangedObject(objects, name, found.bytes, found.e_tag)

    def open(self) -> BinaryIO:
        """Return a stream of it."""
        return self.ranged.open()

    def fetch(self, start: int, end: int) -> None:
        """Have the bytes of a place ready."""
        self.ranged.fetch(start, end)


def find_stored(addresses: Sequence[StoreAddress], upload: UploadSettings, faults: Faults) -> list[LogFile]:
    """Return the logs at these addresses: single ones, and all of a place.

    Args:
        addresses: in object stores.
        upload: whose options are those of the store, if it is one of the same kind.
        faults: takes logs of a place that cannot be read.

    Raises:
        CommandError: there is none, or a store does not answer.
    """
    found = []
    for address in dict.fromkeys(addresses):
        if is_log(address.name):
            found.append(
                look_at_stored(LogObject(open_objects(address.parent, upload), address.parent, address.name))
            )
            continue
        objects = open_objects(address, upload)
        before = len(found)
        for name in log_names(objects, address):
            try:
                found.append(look_at_stored(LogObject(objects, address, name)))
            except CommandError as error:
                if error.code is ExitCode.UNREACHABLE:
                    raise
                faults.add(str(error))
        if len(found) == before and not faults:
            raise CommandError(f"there is no log in {shown_url(address.url)}")
    return found


def is_log(name: str) -> bool:
    """True of the name of a log."""
    return name.endswith((SUFFIX, PART_SUFFIX))


def log_names(objects: Objects, place: StoreAddress) -> Iterator[str]:
    """Return the names of the logs of a place, in their order.

    Raises:
        CommandError: its store does not tell.
    """
    if not place.has_list:
        raise CommandError(
            f"{shown_url(place.url)} names no log, and such a server lists none: name one", ExitCode.USAGE
        )
    try:
        yield from sorted(one.name for one in objects.names() if is_log(one.name))
    except StoreError as error:
        raise CommandError(f"cannot list {shown_url(place.url)}: {error}", ExitCode.UNREACHABLE) from error


def open_objects(place: StoreAddress, upload: UploadSettings) -> Objects:
    """Open a place of a store, with the options of the settings if they are of a store of this kind.

    Raises:
        CommandError: there is no such store.
    """
    return ObstoreObjects(place, options_of(place, upload))


def options_of(place: StoreAddress, upload: UploadSettings) -> Mapping[str, Any]:
    """Return the options for a place: those of the settings, as far as they are of its kind."""
    kind = next((one for one in SCHEMES if upload.store.startswith(one)), "")
    if kind in {"", place.scheme}:
        return upload.options
    # A server of plain HTTP is read only where that is said, whatever else the options are for.
    return {key: value for key, value in upload.options.items() if key == "allow_http"}

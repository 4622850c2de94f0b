"""The objects of obstore's stores: S3, GCS, Azure, a directory, an HTTPS server.

A request is given up after ``REQUEST_S``, and tried once more.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import obstore
from obstore.exceptions import (
    BaseError,
    GenericError,
    NotFoundError,
    NotSupportedError,
    PermissionDeniedError,
    PreconditionError,
    UnauthenticatedError,
)
from obstore.store import ObjectStore, from_url

from recorder.objects.address import ListedObject, StoreAddress, StoredObject, StoreError, shown_url
from schemas.command_line import CommandError, ExitCode, plain, short

REQUEST_S: Final = 30.0  # time limit of a request for at most 4 MiB
CONNECT_S: Final = 5.0
RETRIES: Final = 1  # of the library within ``REQUEST_S``
TRIES: Final = 2  # requests for a range: a link may break in its middle
LISTED_MAX: Final = 1_000_000  # objects of a place that are listed

if TYPE_CHECKING:
    from obstore import GetOptions

_RETRIES: Final = re.compile(r" in [\d.]+\S*s(, after [^-]*retry_timeout: \S+)? *- ")

_ADDRESS: Final = re.compile(r"https?://\S+")

_REFUSED: Final = ("403 forbidden", "401 unauthorized", "credential", "imds")

_GIVES_CREDENTIALS: Final = "//169.254.169.254/"  # where the library looks for a cloud machine's credentials

_CREDENTIALS: Final = {
    "s3://": "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
    "gs://": "GOOGLE_APPLICATION_CREDENTIALS",
    "az://": "AZURE_STORAGE_ACCOUNT_KEY",
}


class ObstoreObjects:
    """The objects of a place that obstore reads."""

    def __init__(self, place: StoreAddress, options: Mapping[str, Any]) -> None:
        self._place = place
        client: dict[str, Any] = {
            "timeout": timedelta(seconds=REQUEST_S),
            "connect_timeout": timedelta(seconds=CONNECT_S),
        }
        retries = {"max_retries": RETRIES, "retry_timeout": timedelta(seconds=REQUEST_S)}
        self._store = open_store(place.url, options, client, retries, may_make=False)

    def look(self, name: str) -> StoredObject | None:
        with self._errors():
            try:
                found = obstore.head(self._store, name)
            except (FileNotFoundError, NotFoundError):
                return None
        return StoredObject(found["size"], _mark(found["e_tag"]))

    def read(self, name: str, start: int, end: int, e_tag: str) -> bytes:
        with self._errors():
            for tried in range(1, TRIES + 1):
                try:
                    return self._range(name, start, end, e_tag)
                except (GenericError, OSError):
                    if tried == TRIES:
                        raise
        raise AssertionError("unreachable")

    def names(self) -> Iterator[ListedObject]:
        count = 0
        with self._errors():
            for page in obstore.list(self._store):
                for one in page:
                    count += 1
                    if count > LISTED_MAX:
                        raise StoreError(f"it holds more than {LISTED_MAX} objects: name a place within it")
                    yield ListedObject(one["path"], one["size"])

    def _range(self, name: str, start: int, end: int, e_tag: str) -> bytes:
        options: GetOptions = {"range": (start, end)}
        if e_tag and self._place.has_list:
            # A plain file server may not support conditions: its answer is checked below.
            options["if_match"] = f'"{e_tag}"'
        try:
            found = obstore.get(self._store, name, options=options)
            # One byte more shows an answer that is too long.
            data = bytes(next(iter(found.stream(end - start + 1)), b""))
        except (PreconditionError, NotFoundError, FileNotFoundError):
            raise StoreError("it was changed or removed while it was read: try again") from None
        if e_tag and _mark(found.meta["e_tag"]) not in {"", e_tag}:
            raise StoreError("it was changed or removed while it was read: try again")
        if len(data) != end - start:
            sent = f"{len(data)} bytes" if len(data) < end - start else "more"
            raise StoreError(f"the store sent {sent} instead of {end - start}: try again")
        return data

    @contextmanager
    def _errors(self) -> Generator[None, None, None]:
        """Turn the library's errors into a StoreError with a cure."""
        try:
            yield
        except (PermissionDeniedError, UnauthenticatedError, PermissionError) as error:
            names = _CREDENTIALS.get(self._place.scheme, "")
            cure = f"give credentials that may read it, {names}" if names else "this user may not read it"
            raise StoreError(f"the store refuses it: {cure}") from error
        except NotSupportedError as error:
            raise StoreError(f"the store cannot do that: {line_of(error)}") from error
        except (BaseError, OSError) as error:
            raise StoreError(_with_cure(line_of(error))) from error


def _with_cure(line: str) -> str:
    # The address may contain any of these words.
    said = _ADDRESS.sub("", line).lower()
    if _GIVES_CREDENTIALS in line or any(word in said for word in _REFUSED):
        return f"{line}: give credentials that may read it"
    if any(word in said for word in ("timed out", "timeout", "connect", "sending request", "dns")):
        return f"{line}: check the store's endpoint and the network"
    return line


def _mark(e_tag: str | None) -> str:
    return (e_tag or "").removeprefix("W/").strip('"')


def open_store(
    url: str,
    options: Mapping[str, Any],
    client: dict[str, Any],
    retries: dict[str, Any],
    *,
    may_make: bool,
) -> ObjectStore:
    """Open the store at a URL of obstore, without using the network. ``may_make`` creates a missing directory."""
    config = dict(options)
    client["allow_http"] = bool(config.pop("allow_http", False))
    # Options of S3, GCS and Azure have different types.
    opened: Any = from_url
    try:
        if url.startswith("memory://"):
            store: ObjectStore = opened(url)
        elif url.startswith("file://"):
            if not may_make and not Path(url.removeprefix("file://")).is_dir():
                raise CommandError(f"cannot use the store {shown_url(url)}: no such directory")
            store = opened(url, mkdir=may_make, **config)
        else:
            store = opened(url, config=config, client_options=client, retry_config=retries)
    except (BaseError, ValueError, TypeError, OSError) as error:
        raise CommandError(f"cannot use the store {shown_url(url)}: {line_of(error)}", ExitCode.USAGE) from error
    return store


def line_of(error: Exception) -> str:
    """The first line of an error of the library, without its count of retries; the rest is internal."""
    line = _RETRIES.sub(": ", str(error).partition("\n")[0]).rstrip(": ")
    return short(plain(line or type(error).__name__))

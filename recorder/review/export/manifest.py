"""The contents and sources of a dataset: ``manifest.json`` in its directory, written last.

A directory without it is no dataset, or one whose export was interrupted.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Final

import msgspec
import pyarrow as pa

from recorder.review.columns.tables import UNIT_KEY
from schemas.command_line import CommandError, plain

MANIFEST_NAME: Final = "manifest.json"
FORMAT: Final = "cruiser-dataset"
VERSION: Final = 1

_BLOCK_BYTES: Final = 1 << 20


class Column(msgspec.Struct, frozen=True):
    """A column.

    Attributes:
        type: by Arrow's name.
        unit: empty if it has none, or none is known.
    """

    name: str
    type: str
    unit: str = ""


class Input(msgspec.Struct, frozen=True):
    """A log that was read.

    Attributes:
        path: as it was given; with escapes where it cannot be printed.
        sha256: of the whole file, in hexadecimal.
        rows: of it that are in the dataset.
        faults: parts that could not be read; ``fault_count`` of them, the first ones listed.
    """

    path: str
    bytes: int
    sha256: str
    rows: int
    faults: list[str]
    fault_count: int


class Part(msgspec.Struct, frozen=True):
    """A Parquet file.

    Attributes:
        path: within the dataset.
        table: its table's name in SQL.
        topic: the log's topic.
        robot: empty if it is no robot's.
        date: of the log times, UTC.
        start_ns, end_ns: the earliest and the latest log time.
        columns: key into the manifest's ``schemas``.
        sha256: of the log that its rows are from.
    """

    path: str
    table: str
    topic: str
    robot: str
    date: str
    rows: int
    bytes: int
    start_ns: int
    end_ns: int
    columns: str
    sha256: str


class Manifest(msgspec.Struct, frozen=True):
    """The manifest.

    Attributes:
        product: the last writer.
        schemas: columns by a hash of them.
    """

    format: str
    version: int
    product: str
    inputs: list[Input]
    files: list[Part]
    schemas: dict[str, list[Column]]


def read_manifest(directory: Path) -> Manifest | None:
    """The manifest of a dataset; None if the directory has none.

    Raises:
        CommandError: it has one that cannot be read.
    """
    path = directory / MANIFEST_NAME
    try:
        text = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise CommandError(f"cannot read {plain(str(path))}: {error.strerror or error}") from error
    try:
        manifest = msgspec.json.decode(text, type=Manifest)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise CommandError(f"{plain(str(path))} is no manifest of a dataset: {plain(str(error))}") from error
    if manifest.format != FORMAT or manifest.version != VERSION:
        raise CommandError(f"{plain(str(path))} is of another format, or of another version of it")
    return manifest


def write_manifest(directory: Path, manifest: Manifest) -> None:
    """Write it in one step: whoever reads meanwhile sees the old one or the new one.

    Raises:
        OSError: the disk does not take it.
    """
    path = directory / MANIFEST_NAME
    beside = directory / f".{MANIFEST_NAME}.new"
    with beside.open("wb") as stream:
        stream.write(msgspec.json.format(msgspec.json.encode(manifest), indent=1) + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
    beside.replace(path)


def described(schema: pa.Schema) -> tuple[str, list[Column]]:
    """The columns of a table, and their key."""
    columns = [
        Column(field.name, str(field.type), (field.metadata or {}).get(UNIT_KEY, b"").decode()) for field in schema
    ]
    return hashlib.sha256(msgspec.json.encode(columns)).hexdigest()[:12], columns


def sha256_of(path: Path, size: int) -> str:
    """The hash of a file's first bytes: it may be growing.

    Raises:
        OSError: it cannot be read.
    """
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(min(_BLOCK_BYTES, size)):
            digest.update(block)
            size -= len(block)
    return digest.hexdigest()

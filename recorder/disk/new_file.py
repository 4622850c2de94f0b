"""A new file: written beside as a part, and named when it is whole. Nothing is overwritten."""

from __future__ import annotations

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from io import BufferedWriter
from pathlib import Path

from recorder.disk.log_directory import lock
from schemas.command_line import CommandError, plain


@contextmanager
def new_file(path: Path) -> Generator[BufferedWriter, None, None]:
    """Opens it for writing. Where that ends in an exception nothing is left.

    Raises:
        CommandError: there is such a file, or the disk does not take it.
    """
    part = path.with_name(f"{path.name}.part")
    shown = plain(str(path))
    if path.exists() or part.exists():
        raise CommandError(f"{plain(str(path if path.exists() else part))} exists, and is not overwritten")
    try:
        with part.open("xb") as stream:
            try:
                # Or somebody takes it for what a recorder has left.
                with suppress(OSError):
                    lock(stream.fileno())
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
                give_name(part, path)
            except BaseException:
                part.unlink(missing_ok=True)
                raise
    except FileExistsError:
        raise CommandError(f"{shown} exists, and is not overwritten") from None
    except OSError as error:
        raise CommandError(f"cannot write {shown}: {error.strerror or error}") from error


def give_name(part: Path, path: Path) -> None:
    """A whole part becomes the file.

    Raises:
        FileExistsError: somebody else has put one there meanwhile.
        OSError: the disk does not take it.
    """
    try:
        # Unlike a rename, a link does not replace what somebody else has put there meanwhile.
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:
        if path.exists():
            raise FileExistsError(0, "it exists") from None
        part.rename(path)
    else:
        part.unlink()

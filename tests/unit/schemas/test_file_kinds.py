"""Files that are read are regular ones."""

import os
import stat
from pathlib import Path

import pytest

from schemas.command_line import CommandError, ExitCode, check_regular


def test_a_file_or_a_link_to_one_is_regular(tmp_path: Path) -> None:
    """Nothing is said of it."""
    file, link = tmp_path / "file", tmp_path / "link"
    file.write_text("")
    link.symlink_to(file)
    for path in (file, link):
        check_regular(path, path.stat().st_mode)


def test_what_is_no_file_is_named_with_its_kind(tmp_path: Path) -> None:
    """Directories, FIFOs, sockets and devices, in one printable line."""
    fifo, place = tmp_path / "fi\nfo", tmp_path / "socket"
    os.mkfifo(fifo)
    os.mknod(place, stat.S_IFSOCK | 0o600)
    for path, kind in (
        (tmp_path, "a directory"),
        (fifo, "a FIFO"),
        (place, "a socket"),
        (Path("/dev/zero"), "a device"),
    ):
        with pytest.raises(CommandError, match=f"is {kind}, and has to be a regular file") as caught:
            check_regular(path, path.stat().st_mode)
        assert caught.value.code is ExitCode.USAGE
        assert str(caught.value).isprintable()

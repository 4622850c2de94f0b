"""A machine below a directory."""

import errno
import os
from collections.abc import Sequence
from pathlib import Path

import pytest

from gateway.host.machine import Machine
from schemas.exit_codes import CommandError


class Recording:
    """What was said, and which programs were run; one of them fails."""

    def __init__(self, fails: str = "") -> None:
        self.lines: list[str] = []
        self.programs: list[str] = []
        self._fails = fails

    def __call__(self, words: Sequence[str]) -> str:
        self.programs.append(" ".join(words))
        return "no such unit" if self._fails and self._fails in words else ""


def machine(root: Path, said: Recording, *, is_dry: bool = False) -> Machine:
    """One below this directory."""
    return Machine(said.lines.append, root=root, program=said, is_dry=is_dry)


def test_a_file_is_written_said_and_what_was_there_is_kept(tmp_path: Path) -> None:
    """One that is as it should be is left alone."""
    said = Recording()
    here = machine(tmp_path, said)
    file = tmp_path / "etc/cruiser/cruiser.toml"
    here.write("/etc/cruiser/cruiser.toml", "first\n")
    here.write("/etc/cruiser/cruiser.toml", "first\n")
    here.write("/etc/cruiser/cruiser.toml", "second\n")
    assert file.read_text() == "second\n"
    assert file.stat().st_mode & 0o777 == 0o644
    (kept,) = file.parent.glob("cruiser.toml.before-*")
    assert kept.read_text() == "first\n"
    assert said.lines == [
        "writes /etc/cruiser/cruiser.toml",
        "/etc/cruiser/cruiser.toml: is as it should be",
        f"writes /etc/cruiser/cruiser.toml, and keeps {kept.name}",
    ]


def test_a_dry_run_does_nothing_and_says_all(tmp_path: Path) -> None:
    """The text of the file among it."""
    said = Recording()
    here = machine(tmp_path, said, is_dry=True)
    here.write("/etc/cruiser/cruiser.toml", "[robot]\n")
    here.run([["systemctl", "daemon-reload"]])
    with here.keys_of("gateway") as directory:
        assert not directory.exists()
    assert said.lines == [
        "would write /etc/cruiser/cruiser.toml",
        "    [robot]",
        "would run: systemctl daemon-reload",
    ]
    assert said.programs == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "words"), [(errno.EROFS, "read-only file system"), (errno.ENOSPC, "no space left")]
)
def test_a_disk_that_takes_nothing_is_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: int, words: str
) -> None:
    """Read-only, or full: what was there stays."""
    here = machine(tmp_path, Recording())
    here.write("/etc/cruiser.toml", "first\n")

    def refuse(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(CommandError, match=f"^/etc/cruiser.toml cannot be written: {words}"):
        here.write("/etc/cruiser.toml", "second\n")
    assert (tmp_path / "etc/cruiser.toml").read_text() == "first\n"


def test_the_first_program_that_fails_ends_it(tmp_path: Path) -> None:
    """With its own last words."""
    said = Recording(fails="restart")
    with pytest.raises(CommandError, match=r"^'systemctl restart x' failed: no such unit$"):
        machine(tmp_path, said).run([["systemctl", "restart", "x"], ["true"]])
    assert said.programs == ["systemctl restart x"]


def test_a_directory_of_keys_is_made_for_nobody_else(tmp_path: Path) -> None:
    """As the package makes it."""
    with machine(tmp_path, Recording()).keys_of("gateway") as directory:
        assert directory == tmp_path / "etc/cruiser/gateway"
        assert directory.stat().st_mode & 0o777 == 0o700

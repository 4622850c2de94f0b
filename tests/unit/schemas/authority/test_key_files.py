"""The files of a machine or a person: each fault is one line that names the file and the cure."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.authority.key_files import read_identity, read_trust
from schemas.command_line import CommandError, ExitCode
from tests.support.authority import Fleet
from tests.support.provisioned import provision, write_authority

NEW_KEY = "'cruiser provision operator NAME --replace' makes another, and a request to the authority"
ANOTHER = "'cruiser provision renew operator' asks for another"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """The directory of an operator."""
    fleet = Fleet()
    return provision(tmp_path / "ann", "operator", fleet.operator(), fleet)


def fault(place: Path) -> str:
    """The line about what is wrong."""
    with pytest.raises(CommandError) as caught:
        read_identity(place, "operator")
    assert caught.value.code is ExitCode.USAGE
    assert str(caught.value).isprintable()
    return str(caught.value)


def test_files_that_belong_together_are_read(place: Path) -> None:
    """Key, grant, authority."""
    assert read_identity(place, "operator").trust == read_trust(place)


@pytest.mark.parametrize("name", ["operator.key", "operator.grant", "authority.json"])
def test_what_is_no_regular_file_is_not_waited_for(place: Path, name: str) -> None:
    """A FIFO that nobody writes, a directory, a device that never ends."""
    file = place / name
    makers: tuple[Callable[[], None], ...] = (
        lambda: os.mkfifo(file, 0o600),
        file.mkdir,
        lambda: file.symlink_to("/dev/zero"),
    )
    for make in makers:
        file.rmdir() if file.is_dir() else file.unlink()
        make()
        assert re.fullmatch(rf"{file} is a \w+, and has to be a regular file", fault(place))


@pytest.mark.parametrize(
    ("name", "says", "cure"),
    [
        ("operator.key", "is no private key, or damaged", NEW_KEY),
        ("operator.grant", "is no grant", ANOTHER),
        ("authority.json", "is damaged", ANOTHER),
    ],
)
def test_a_damaged_file_has_the_cure_of_its_kind(place: Path, name: str, says: str, cure: str) -> None:
    """A key is made here; grant and authority are the authority's answer. None is a link to other pages."""
    (place / name).write_text("-----BEGIN PRIVATE KEY-----\nMC4CAQA=\n-----END PRIVATE KEY-----\n")
    text = fault(place)
    assert text.startswith(f"{place / name} {says}")
    assert text.endswith(f"; {cure}")
    assert "http" not in text


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("operator.key", "'cruiser provision operator NAME' makes it"),
        ("operator.grant", "'cruiser provision install' writes it"),
        ("authority.json", "'cruiser provision install' writes it"),
    ],
)
def test_a_missing_file_has_the_cure_of_its_kind(place: Path, name: str, cure: str) -> None:
    """A key is made here; grant and authority come in a bundle."""
    (place / name).unlink()
    assert fault(place).startswith(f"{place / name} is not there; {cure}")


def test_an_authority_of_another_fleet_is_named(place: Path) -> None:
    """No robot would believe the grant, and no robot would be believed."""
    write_authority(place, Fleet())
    text = fault(place)
    assert text.startswith(f"{place}/authority.json is not of the authority that signed {place}/operator.grant")
    assert ANOTHER in text

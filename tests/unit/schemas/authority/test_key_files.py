"""The files of a machine or a person: each fault is one line that names the file and the cure."""

import os
import re
from collections.abc import Callable
from pathlib import Path, PurePath

import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from schemas.authority.key_files import read_identity, read_trust
from schemas.authority.proof import chain_text
from schemas.command_line import CommandError, ExitCode
from schemas.configuration import directory_of
from schemas.settings import AuthoritySettings
from tests.support.authority import Fleet
from tests.support.provisioned import provision, write_authority

FLEET = Fleet()
ANN = FLEET.operator()
RENEW = "; 'cruiser provision renew operator' asks for another"
REMAKE = "; 'cruiser provision operator NAME --replace' makes another and a request to the authority"
ANSWERED = "; 'cruiser provision install' writes it from the authority's bundle"
OTHER_CURVE = generate_private_key(SECP256R1()).private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())

Damage = Callable[[Path], object]


@pytest.fixture
def place(tmp_path: Path) -> Path:
    return provision(tmp_path / "ann", "operator", ANN, FLEET)


def fault(place: Path) -> str:
    with pytest.raises(CommandError) as caught:
        read_identity(place, "operator")
    assert caught.value.code is ExitCode.USAGE
    return str(caught.value).replace(f"{place}/", "")


def test_files_that_belong_together_are_an_identity(place: Path) -> None:
    found = read_identity(place, "operator")
    assert found.private.public_key().public_bytes_raw() == ANN.key
    assert (found.chain, found.trust, read_trust(place)) == (ANN.chain, FLEET.trust, FLEET.trust)


@pytest.mark.parametrize(
    ("damage", "line"),
    [
        (
            lambda place: (place / "operator.grant").write_text(chain_text(FLEET.operator("bob").chain)),
            "operator.grant is not the grant of operator.key: one of them belongs to another" + RENEW,
        ),
        (
            lambda place: write_authority(place, Fleet()),
            "authority.json is not of the authority that signed operator.grant: one of them is of another fleet, "
            "or from before a rotation" + RENEW,
        ),
        (
            lambda place: (place / "operator.key").write_bytes(OTHER_CURVE),
            "operator.key is not an Ed25519 key" + REMAKE,
        ),
        (
            lambda place: (place / "operator.key").chmod(0o640),
            "operator.key can be read by others; chmod 600 operator.key",
        ),
        (
            lambda place: (place / "operator.key").write_text("-----BEGIN PRIVATE KEY-----\nMC4CAQA=\n"),
            "operator.key is not a private key, or damaged" + REMAKE,
        ),
        (lambda place: (place / "operator.grant").write_text("x"), "operator.grant is not a grant: "),
        (lambda place: (place / "authority.json").write_text("x"), "authority.json is damaged: "),
        (
            lambda place: (place / "operator.key").unlink(),
            "operator.key is not there; 'cruiser provision operator NAME' makes it",
        ),
        (lambda place: (place / "operator.grant").unlink(), "operator.grant is not there" + ANSWERED),
        (lambda place: (place / "authority.json").unlink(), "authority.json is not there" + ANSWERED),
    ],
)
def test_each_fault_is_one_line_with_the_cure_of_its_kind(place: Path, damage: Damage, line: str) -> None:
    damage(place)
    text = fault(place)
    assert text.startswith(line)
    assert text.isprintable()
    assert "http" not in text


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
def test_a_key_of_another_user_is_refused(place: Path) -> None:
    os.chown(place / "operator.key", 65534, 65534)
    assert fault(place) == "operator.key belongs to another user; chown it to yours"


@pytest.mark.parametrize("name", ["operator.key", "operator.grant", "authority.json"])
def test_what_is_no_regular_file_is_not_waited_for(place: Path, name: str) -> None:
    file = place / name
    makers: tuple[Callable[[], None], ...] = (
        lambda: os.mkfifo(file, 0o600),
        file.mkdir,
        lambda: file.symlink_to("/dev/zero"),
    )
    for make in makers:
        file.rmdir() if file.is_dir() else file.unlink()
        make()
        assert re.fullmatch(rf"{name} is a \w+, not a regular file", fault(place))


@pytest.mark.parametrize(
    ("directory", "environment", "found"),
    [
        ("/etc/keys", {"XDG_CONFIG_HOME": "/x"}, "/etc/keys"),
        ("auto", {"XDG_CONFIG_HOME": "/x"}, "/x/cruiser"),
        ("auto", {"XDG_CONFIG_HOME": ""}, "/home/ann/.config/cruiser"),
        ("auto", {}, "/home/ann/.config/cruiser"),
    ],
)
def test_the_directory_of_keys_is_the_settings_or_of_the_desktop(
    directory: str, environment: dict[str, str], found: str
) -> None:
    settings = AuthoritySettings(directory=directory)
    assert directory_of(settings, environment, PurePath("/home/ann")) == PurePath(found)

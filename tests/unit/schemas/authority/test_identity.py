"""Who a machine is, by its files: what belongs together is taken, all else is one line with the cure."""

import os
import re
from collections.abc import Callable
from pathlib import Path, PurePath

import msgspec
import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from schemas.authority.identity import FoundFile, identity_of
from schemas.authority.key_files import read_identity, read_trust
from schemas.authority.proof import chain_text
from schemas.command_line import CommandError, ExitCode
from schemas.configuration import directory_of
from schemas.settings import AuthoritySettings
from tests.support.authority import Fleet, Party
from tests.support.provisioned import private_pem, provision

PLACE = PurePath("/keys")
FLEET = Fleet()
ANN = FLEET.operator()
FOREIGN = "one of them is somebody else's"
MIXED = "one of them is of another fleet, or of before a rotation"
RENEW = "'cruiser provision renew operator' asks for another"
REMAKE = "'cruiser provision operator NAME --replace' makes another, and a request to the authority"


def file(name: str, content: bytes) -> FoundFile:
    """A file as its owner alone can read it."""
    return FoundFile(PLACE / name, content, 0o100600, is_own=True)


def grant_of(party: Party) -> FoundFile:
    return file("operator.grant", chain_text(party.chain).encode())


def authority_of(fleet: Fleet) -> FoundFile:
    keys = {"active": fleet.authority.key.hex(), "standby": fleet.standby.key.hex()}
    return file("authority.json", msgspec.json.encode(keys))


KEY, GRANT, AUTHORITY = file("operator.key", private_pem(ANN)), grant_of(ANN), authority_of(FLEET)
OTHER_CURVE = generate_private_key(SECP256R1()).private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def test_key_grant_and_authority_that_belong_together_are_an_identity() -> None:
    """With what each file holds."""
    identity = identity_of(KEY, GRANT, AUTHORITY, "operator")
    assert private_pem(ANN) == KEY.content
    assert identity.private.public_key().public_bytes_raw() == ANN.key
    assert (identity.chain, identity.trust) == (ANN.chain, FLEET.trust)


@pytest.mark.parametrize(
    ("files", "line"),
    [
        (
            (KEY, grant_of(FLEET.operator("bob")), AUTHORITY),
            f"/keys/operator.grant is not the grant of /keys/operator.key: {FOREIGN}; {RENEW}",
        ),
        (
            (KEY, GRANT, authority_of(Fleet())),
            f"/keys/authority.json is not of the authority that signed /keys/operator.grant: {MIXED}; {RENEW}",
        ),
        (
            (file("operator.key", b"x"), GRANT, AUTHORITY),
            f"/keys/operator.key is no private key, or damaged; {REMAKE}",
        ),
        (
            (file("operator.key", OTHER_CURVE), GRANT, AUTHORITY),
            f"/keys/operator.key is no Ed25519 key; {REMAKE}",
        ),
        (
            (msgspec.structs.replace(KEY, mode=0o100640), GRANT, AUTHORITY),
            "/keys/operator.key can be read by others; chmod 600 /keys/operator.key",
        ),
        (
            (msgspec.structs.replace(KEY, is_own=False), GRANT, AUTHORITY),
            "/keys/operator.key belongs to another user; chown it to yours",
        ),
    ],
    ids=["another's grant", "another authority", "no key", "another curve", "readable", "another's key"],
)
def test_what_does_not_belong_together_is_one_line_with_the_cure(
    files: tuple[FoundFile, FoundFile, FoundFile], line: str
) -> None:
    """Which names the files."""
    with pytest.raises(CommandError) as refused:
        identity_of(*files, "operator")
    assert (str(refused.value), refused.value.code) == (line, ExitCode.USAGE)


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
    """As the XDG Base Directory Specification has it."""
    settings = AuthoritySettings(directory=directory)
    assert directory_of(settings, environment, PurePath("/home/ann")) == PurePath(found)


# The files of a machine or a person.


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

"""Who a machine is, by its files: what belongs together is taken, all else is one line with the cure."""

import errno
from collections.abc import Callable
from pathlib import PurePath

import msgspec
import pytest
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from schemas.authority.identity import FoundFile, identity_of, installed, not_found
from schemas.authority.proof import chain_text
from schemas.command_line import CommandError, ExitCode
from schemas.configuration import directory_of
from schemas.settings import AuthoritySettings
from tests.support.authority import Fleet, Party
from tests.support.provisioned import private_pem

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
    ("error", "cure", "line"),
    [
        (FileNotFoundError, "", "/keys/x is not there"),
        (FileNotFoundError, "make it", "/keys/x is not there; make it"),
        (
            lambda: PermissionError(errno.EACCES, "Permission denied"),
            "",
            "/keys/x cannot be read: Permission denied",
        ),
    ],
)
def test_a_file_that_cannot_be_read_is_one_line(error: Callable[[], OSError], cure: str, line: str) -> None:
    """With the cure, where there is one."""
    refused = not_found(PLACE / "x", error(), cure)
    assert (str(refused), refused.code) == (line, ExitCode.USAGE)


def test_what_the_authority_answers_is_installed_or_asked_for_again() -> None:
    """By the commands of who lacks it."""
    assert "operator-NAME.bundle" in installed("operator")
    assert RENEW in installed("operator")


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

"""The recorder's name, and its signing key."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from recorder.cli.record import own_name, signer_of
from recorder.record.signed_mode import LogSignature
from recorder.zenoh.remote_control import host_name
from schemas.authority.proof import GrantRole, chain_text
from schemas.settings import AuthoritySettings, RecorderSettings, Settings
from tests.support.authority import Fleet, Party
from tests.support.provisioned import provision


def provisioned(directory: Path, name: str = "depot-1", mode: str = "signed") -> Settings:
    recorder = Party(name)
    Fleet().authority.grant(recorder, role=GrantRole.RECORDER)
    (directory / "recorder.grant").write_text(chain_text(recorder.chain))
    authority = msgspec.convert({"mode": mode, "directory": str(directory)}, AuthoritySettings)
    return Settings(authority=authority)


GRANTED, DAMAGED = "as it was granted", "{}\ned25519 00 00\n"


@pytest.mark.parametrize(
    ("granted", "mode", "grant", "name", "expected"),
    [
        ("depot-1", "signed", GRANTED, "", "depot-1"),
        ("depot-1", "signed", GRANTED, "second", "second"),
        ("depot-1", "open", GRANTED, "", host_name()),
        ("Depot_1", "signed", GRANTED, "", host_name()),
        *(
            ("depot-1", "signed", content, "", host_name())
            for content in (None, "", "junk", "{}\ned25519 00 00\n")
        ),
    ],
)
def test_the_name_of_a_recorder(
    tmp_path: Path, granted: str, mode: str, grant: str | None, name: str, expected: str
) -> None:
    """The configured name, else the one of its grant in signed mode, else the host's."""
    settings = provisioned(tmp_path, granted, mode)
    if grant is None:
        (tmp_path / "recorder.grant").unlink()
    elif grant != GRANTED:
        (tmp_path / "recorder.grant").write_text(grant)
    assert own_name(msgspec.structs.replace(settings, recorder=RecorderSettings(name=name))) == expected


def test_a_recorder_signs_with_the_key_that_it_was_provisioned_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = provisioned(tmp_path)
    assert signer_of(settings.authority) is None
    assert "'cruiser provision recorder NAME' makes it" in capsys.readouterr().err
    fleet, recorder = Fleet(), Party("depot-1")
    fleet.authority.grant(recorder, role=GrantRole.RECORDER)
    provision(tmp_path, "recorder", recorder, fleet)
    signer = signer_of(settings.authority)
    assert signer is not None
    found = LogSignature.read(signer.sign("0" * 64, "x.mcap"))
    assert found is not None
    assert found.key == recorder.key
    assert signer_of(provisioned(tmp_path, mode="open").authority) is None

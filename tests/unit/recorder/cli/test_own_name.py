"""The name by which a recorder goes, and the key with which it signs."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from recorder.cli.record import own_name, signer_of
from recorder.record.retention import LogSignature
from recorder.zenoh.remote_control import host_name
from schemas.authority.proof import GrantRole, chain_text
from schemas.settings import AuthoritySettings, RecorderSettings, Settings
from tests.support.authority import Fleet, Party
from tests.support.provisioned import provision


def provisioned(directory: Path, name: str = "depot-1", mode: str = "signed") -> Settings:
    """The settings of a recorder whose grant is in this directory."""
    recorder = Party(name)
    Fleet().authority.grant(recorder, role=GrantRole.RECORDER)
    (directory / "recorder.grant").write_text(chain_text(recorder.chain))
    authority = msgspec.convert({"mode": mode, "directory": str(directory)}, AuthoritySettings)
    return Settings(authority=authority)


def test_a_recorder_goes_by_the_name_of_its_grant(tmp_path: Path) -> None:
    """As it was provisioned, and as people order it."""
    assert own_name(provisioned(tmp_path)) == "depot-1"


def test_a_name_that_is_set_comes_first(tmp_path: Path) -> None:
    """Several recorders may share a machine and its grant."""
    settings = provisioned(tmp_path)
    assert own_name(msgspec.structs.replace(settings, recorder=RecorderSettings(name="second"))) == "second"


def test_in_open_mode_it_goes_by_the_hosts_name(tmp_path: Path) -> None:
    """Whatever files are there."""
    assert own_name(provisioned(tmp_path, mode="open")) == host_name()


@pytest.mark.parametrize("content", [None, "", "junk", "{}\ned25519 00 00\n"])
def test_without_a_grant_it_goes_by_the_hosts_name(tmp_path: Path, content: str | None) -> None:
    """A missing or damaged one names nothing, and is no reason not to record."""
    settings = provisioned(tmp_path)
    grant = tmp_path / "recorder.grant"
    grant.unlink() if content is None else grant.write_text(content)
    assert own_name(settings) == host_name()


def test_a_name_that_is_none_of_a_key_is_not_used(tmp_path: Path) -> None:
    """A grant may name its holder as a person is called."""
    assert own_name(provisioned(tmp_path, "Depot_1")) == host_name()


def test_a_recorder_signs_with_the_key_that_it_was_provisioned_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In signed mode. A machine without a recorder's key records unsigned, and says so with the cure."""
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

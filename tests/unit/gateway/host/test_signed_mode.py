"""The start of a robot in signed mode, by installed files and saved statements."""

from __future__ import annotations

import secrets
import time
from pathlib import Path

import msgspec
import pytest

from gateway.authority.robot_authority import Kept
from gateway.choice.chassis import CHASSIS
from gateway.command.rulings import RawRequest
from gateway.core import Core
from gateway.host.signed_mode import WAITS, AuthorityNote, Renewal, SignedMode
from gateway.provisioning.key_files import expires_s, read_certificates
from schemas.authority.proof import Grant, chain_text
from schemas.command_line import CommandError
from schemas.decisions import StatementReply
from schemas.reasons import Reason
from schemas.settings import AuthoritySettings, GatewaySettings, RobotSettings, Settings, ZenohSettings
from tests.support.provisioning import ProvisionedFleet, bundle_of, chain, run
from tests.support.waiting import wait_until


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProvisionedFleet:
    monkeypatch.chdir(tmp_path)
    found = ProvisionedFleet(tmp_path)
    found.let_in("robot", "cruiser-1", "--days", "20")
    return found


def signed_mode(settings: Settings) -> SignedMode:
    return SignedMode(settings, Core(CHASSIS, settings, "0", 0, secrets.randbits(53)))


def started(fleet: ProvisionedFleet, name: str = "cruiser-1") -> str:
    """The robot's own grant after a start."""
    signed = signed_mode(settings_of(fleet, name))
    signed.close()
    return chain_text(signed.authority._own)


def settings_of(fleet: ProvisionedFleet, name: str = "cruiser-1") -> Settings:
    directory = str(fleet.place / "cruiser-1")
    return Settings(
        robot=RobotSettings(name=name), authority=AuthoritySettings(mode="signed", directory=directory)
    )


def noted(fleet: ProvisionedFleet, kept: Kept) -> None:
    note = AuthorityNote.of(settings_of(fleet))
    note.save(kept)
    note.close()


def renewed(fleet: ProvisionedFleet, days: str) -> Path:
    """A bundle with another grant for the same keys."""
    run("renew", "robot", "--directory", fleet.place / "cruiser-1", "-o", f"{days}.request")
    return fleet.sign(Path(f"{days}.request"), "--days", days)


@pytest.mark.parametrize("days", ["10", "40"])
def test_of_a_grant_that_was_shown_and_one_that_was_installed_the_longer_one_holds(
    fleet: ProvisionedFleet, days: str
) -> None:
    installed = (fleet.place / "cruiser-1" / "robot.grant").read_text()
    assert started(fleet) == installed
    shown = bundle_of(renewed(fleet, days)).chain
    noted(fleet, Kept(own=shown))
    assert started(fleet) == (shown if days == "40" else installed)


def test_a_grant_that_is_shown_before_the_first_tick_is_judged_by_the_present(fleet: ProvisionedFleet) -> None:
    """As after a restart: the time must not be 1970."""
    text = (fleet.place / "cruiser-1" / "robot.grant").read_bytes().strip()
    signed = signed_mode(settings_of(fleet))
    reply = signed.authority.receive(RawRequest(1, "", "", text, len(text)), 0)
    signed.close()
    said = msgspec.msgpack.decode(reply.payload, type=StatementReply)
    assert (said.ok, said.reason) == (True, Reason.NONE)


def test_a_shown_grant_that_does_not_hold_any_more_gives_way(fleet: ProvisionedFleet) -> None:
    shown = bundle_of(renewed(fleet, "400")).chain
    new = ProvisionedFleet(fleet.place / "new")
    run("sign", "400.request", "--directory", new.place / "authority", "-o", "new.bundle", "--days", "5")
    place = fleet.place / "cruiser-1"
    run("install", "new.bundle", "--directory", place, "--replace", "--fingerprint", new.fingerprint)
    noted(fleet, Kept(own=shown))
    installed = fleet.place / "cruiser-1" / "robot.grant"
    assert started(fleet) == chain_text(chain(installed))


def test_a_robot_that_cannot_save_what_is_revoked_does_not_arm(fleet: ProvisionedFleet, tmp_path: Path) -> None:
    place = tmp_path / "state"
    settings = settings_of(fleet)
    settings = msgspec.structs.replace(settings, gateway=GatewaySettings(state_dir=str(place / "below")))
    signed = signed_mode(settings)
    place.write_text("a file where the directory should be")
    authority = signed.authority
    bars: dict[Reason, str] = {}

    def tick() -> None:
        effects = authority.tick(time.monotonic_ns(), time.monotonic_ns(), time.time_ns())
        bars.update(effects.bars or {})
        if effects.kept is not None:
            signed.save(effects.kept)

    wait_until(lambda: str(place) in bars.get(Reason.SELF_TEST, ""), tick)
    assert "lose revocations" in bars[Reason.SELF_TEST]
    signed.close()


def test_another_robots_keys_start_nothing(fleet: ProvisionedFleet) -> None:
    with pytest.raises(CommandError, match=r"robot\.grant is not of a robot called cruiser-2: 'cruiser provision"):
        started(fleet, "cruiser-2")


def test_the_ends_of_the_robots_certificate_and_grant_are_known(fleet: ProvisionedFleet) -> None:
    place = fleet.place / "cruiser-1"
    settings = msgspec.structs.replace(settings_of(fleet), zenoh=ZenohSettings(config=str(place / "robot.json5")))
    signed = signed_mode(settings)
    signed.close()
    grants = [one.statement for one in chain(place / "robot.grant")]
    assert signed.authority.grant_ends_s == min(one.not_after for one in grants if isinstance(one, Grant))
    certificate = read_certificates((place / "robot-tls.pem").read_text())[0]
    assert signed.certificate_ends_s == expires_s(certificate)


# Restarts after a new installation.


def renew(fleet: ProvisionedFleet) -> None:
    run("install", renewed(fleet, "30"), "--directory", fleet.place / "cruiser-1", "--replace")


def looks(renewal: Renewal, number: int = 3) -> list[bool]:
    return [renewal.look() for _ in range(number)]


def test_an_installation_ends_the_gateway_once_two_looks_agree(fleet: ProvisionedFleet) -> None:
    """An installation writes several files."""
    renewal = Renewal(settings_of(fleet), is_managed=True)
    assert looks(renewal) == [False] * 3
    renew(fleet)
    assert looks(renewal, 2) == [False, True]
    assert (renewal.is_taken, renewal.note) == (True, "")


def test_a_robot_that_gets_its_first_grant_is_started_again(fleet: ProvisionedFleet) -> None:
    grant = fleet.place / "cruiser-1" / "robot.grant"
    text = grant.read_text()
    grant.unlink()
    renewal = Renewal(settings_of(fleet), is_managed=True)
    assert looks(renewal) == [False] * 3
    grant.write_text(text)
    assert looks(renewal, 2) == [False, True]


def test_a_gateway_that_nobody_starts_again_stays_and_says_so(fleet: ProvisionedFleet) -> None:
    renewal = Renewal(settings_of(fleet), is_managed=False)
    renew(fleet)
    assert looks(renewal) == [False] * 3
    assert (renewal.is_taken, renewal.note) == (False, WAITS)

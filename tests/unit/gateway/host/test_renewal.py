"""When files that were replaced are taken over: complete, sound, and accepted."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.serialization import load_pem_private_key

from gateway.authority.transport import TransportRole
from gateway.host import renewal
from gateway.host.renewal import WAITS, Renewal
from gateway.provisioning.certificates import LEAF_DAYS, issue, new_request
from schemas.exit_codes import CommandError
from schemas.settings import AuthoritySettings, Settings, ZenohSettings
from tests.support.provisioning import ProvisionedFleet
from tests.support.provisioning import run as provision
from tests.support.waiting import wait_until

DAY_S = 86_400


class Robot:
    """A robot's files, and who accepts them.

    Attributes:
        refusal: why nobody accepts them; empty if somebody does.
        opened: how often that was tried.
    """

    def __init__(self, place: Path) -> None:
        self.fleet = ProvisionedFleet(place)
        self.files = self.fleet.let_in("robot", "cruiser-1")
        self.settings = Settings(
            zenoh=ZenohSettings(config=str(self.files / "robot.json5")),
            authority=AuthoritySettings(mode="signed", directory=str(self.files)),
        )
        self.refusal = ""
        self.opened = 0

    def open_session(self, *_given: object, **_further: object) -> None:
        self.opened += 1
        if self.refusal:
            raise CommandError(self.refusal)

    def renew(self) -> None:
        """As docs/authority.md says."""
        request = self.fleet.place / "again.request"
        provision("renew", "robot", "--directory", self.files, "-o", request)
        provision("install", self.fleet.sign(request), "--directory", self.files, "--replace")

    def certify(self, born_s: float) -> None:
        """Its certificate, as it was made then."""
        authority = self.fleet.place / "authority"
        key, signer = (
            load_pem_private_key(path.read_bytes(), None)
            for path in (self.files / "robot-tls.key", authority / "ca.key")
        )
        request = new_request(key, "robot", ["cruiser-1"])  # type: ignore[arg-type] # both are on P-256
        ca = (authority / "ca.pem").read_text()
        text = issue(request, TransportRole.ROBOT, ca, signer, int(born_s))  # type: ignore[arg-type] # the same
        (self.files / "robot-tls.pem").write_text(text)


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Robot:
    """A robot that was provisioned, looked after a hundred times a second."""
    monkeypatch.chdir(tmp_path)
    found = Robot(tmp_path)
    monkeypatch.setattr(renewal, "open_session", found.open_session)
    monkeypatch.setattr(renewal, "close_session", lambda _: None)
    monkeypatch.setattr(renewal, "LOOK_S", 0.01)
    monkeypatch.setattr(renewal, "AGAIN_S", 0.05)
    monkeypatch.setattr(renewal, "LIVES_S", 0.05)
    return found


@pytest.fixture
def watched(robot: Robot) -> Iterator[Renewal]:
    """Its files are watched."""
    one = Renewal(robot.settings)
    one.begin(["tls/127.0.0.1:47447"])
    yield one
    one.close()


def looks(watched: Renewal) -> None:
    """So long that the files were looked at, and tried, more than once."""
    watched._ends.wait(0.3)


def test_files_that_are_as_they_were_are_in_use(robot: Robot, watched: Renewal) -> None:
    """Nothing is tried, and nothing is noted."""
    looks(watched)
    assert (watched.is_ready, watched.notes(), robot.opened) == (False, (), 0)


def test_renewed_files_are_ready_once_somebody_accepts_them(robot: Robot, watched: Renewal) -> None:
    """Until then it is noted why they are not used, and tried again."""
    robot.refusal = "cannot open Zenoh: nobody"
    robot.renew()
    wait_until(lambda: robot.opened > 1)
    assert not watched.is_ready
    wait_until(lambda: watched.notes() == ("the renewed files are not used: cannot open Zenoh: nobody",))
    robot.refusal = ""
    wait_until(lambda: watched.is_ready)
    wait_until(lambda: watched.notes() == (WAITS,))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("robot.key", "robot.key is no private key"),
        ("robot.grant", "robot.grant is no grant"),
        ("robot-tls.pem", "robot-tls.pem: "),
        ("nothing-tls.pem", "nothing-tls.pem: "),
    ],
)
def test_damaged_files_are_not_used(robot: Robot, watched: Renewal, name: str, said: str) -> None:
    """The note names the file; where it is mended, the gateway starts again with it."""
    file = robot.files / name
    text = file.read_text()
    file.write_text("x")
    wait_until(lambda: any(said in note for note in watched.notes()))
    assert not watched.is_ready
    assert robot.opened == 0
    file.write_text(text)
    wait_until(lambda: watched.is_ready)


def test_a_key_that_others_could_read_is_read_again_once_they_cannot(robot: Robot) -> None:
    """The gateway began without it, and its line said chmod."""
    file = robot.files / "robot.key"
    file.chmod(0o644)
    one = Renewal(robot.settings)
    one.begin([])
    looks(one)
    assert not one.is_ready
    file.chmod(0o600)
    wait_until(lambda: one.is_ready)
    one.close()


def test_a_grant_that_nobody_signed_is_not_used(robot: Robot, watched: Renewal) -> None:
    """The gateway continues with the one that it has: with this one nobody could engage the robot."""
    file = robot.files / "robot.grant"
    body, _, proof = file.read_text().partition("\n")
    changed = proof[:-9] + ("0" if proof[-9] != "0" else "1") + proof[-8:]
    file.write_text(f"{body}\n{changed}")
    wait_until(lambda: any("robot.grant: the signature" in note for note in watched.notes()))
    assert not watched.is_ready


def test_a_gateway_that_dials_out_to_nobody_needs_nobodys_word(robot: Robot) -> None:
    """It listens: whether others accept its certificate is theirs to say."""
    one = Renewal(robot.settings)
    one.begin([])
    robot.renew()
    wait_until(lambda: one.is_ready)
    one.close()
    assert robot.opened == 0


def test_what_is_replaced_while_the_gateway_starts_is_new(robot: Robot) -> None:
    """It may have read the old one."""
    one = Renewal(robot.settings)
    robot.renew()
    one.begin([])
    wait_until(lambda: one.is_ready)
    one.close()


def test_in_open_mode_nothing_is_watched(robot: Robot) -> None:
    """There is nothing to watch."""
    one = Renewal(Settings())
    one.begin([])
    one.close()
    assert (one.is_ready, one.notes(), robot.opened) == (False, (), 0)


@pytest.mark.parametrize(
    ("age_days", "said"),
    [
        (LEAF_DAYS * 2 / 3 - 0.1, ""),
        (
            LEAF_DAYS * 2 / 3 + 0.1,
            "robot-tls.pem ends in 9.9 days; 'cruiser provision renew robot' asks for another",
        ),
        (LEAF_DAYS + 0.1, "robot-tls.pem ended 0.1 days ago; 'cruiser provision renew robot' asks for another"),
    ],
)
def test_from_two_thirds_of_its_life_a_certificate_is_noted(
    robot: Robot, caplog: pytest.LogCaptureFixture, age_days: float, said: str
) -> None:
    """In the log once, and where ``cruiser why`` shows it for as long as it holds."""
    robot.certify(time.time() - age_days * DAY_S)
    one = Renewal(robot.settings)
    with caplog.at_level(logging.WARNING, renewal.__name__):
        one.begin([])
        looks(one)
        one.close()
    expected = [f"{robot.files}/{said}"] if said else []
    assert list(one.notes()) == expected
    assert caplog.messages == expected

"""``cruiser doctor``: which nodes it asks, and what it prints."""

import argparse
import json
from pathlib import Path

import pytest

from gateway.authority.enrolment import TransportRole
from gateway.cli import doctor
from gateway.doctor.checks import Diagnosis
from gateway.doctor.facts import Facts, reach
from schemas.command_line import CommandError, ExitCode
from schemas.settings import AuthoritySettings, Settings, ZenohSettings
from tests.support.secured import Network

MUST = Diagnosis("disk_full", "the disk is full", "copy logs away", is_note=False)
NOTE = Diagnosis("losses", "something was lost", "look", is_note=True)
FACTS = Facts(Settings(), "0.1.0", 0.0)


@pytest.mark.parametrize(
    ("found", "code", "printed"),
    [
        ([MUST], ExitCode.FAILURE, ["disk_full: the disk is full -> copy logs away"]),
        ([NOTE], ExitCode.OK, ["note: losses: something was lost -> look", "feedback complete, guarded, "]),
        ([], ExitCode.OK, ["feedback complete, guarded, recording, open to this machine alone"]),
    ],
)
def test_a_line_a_finding_and_last_that_all_is_well(
    found: list[Diagnosis], code: ExitCode, printed: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert doctor.report(FACTS, found, as_json=False) is code
    lines = capsys.readouterr().out.splitlines()
    assert lines[1 if found else 0 :][:5] == reach(FACTS).lines
    lines = [line for line in lines if line not in reach(FACTS).lines]
    assert len(lines) == len(printed)
    assert all(line.startswith(text) for line, text in zip(lines, printed, strict=True))
    assert doctor.report(FACTS, found, as_json=True) is code
    said = json.loads(capsys.readouterr().out)
    assert said["ok"] == (code is ExitCode.OK) == bool(said["summary"])
    assert [one["check"] for one in said["findings"]] == [one.check for one in found]
    assert said["reach"]["speed_mps"] == 1.0


def test_a_gateway_is_asked_where_it_listens() -> None:
    listening = ZenohSettings(listen=["tcp/0.0.0.0:7450", "tcp/[::]:7451", "tcp/10.0.0.7:7452"])
    asking = doctor.settings_to_ask(Settings(zenoh=listening))
    assert asking.connect == ["tcp/127.0.0.1:7450", "tcp/[::1]:7451", "tcp/10.0.0.7:7452"]
    assert asking.listen == []
    routed = ZenohSettings(connect=["tcp/10.0.0.5:7447"], listen=["tcp/127.0.0.1:7447"])
    assert doctor.settings_to_ask(Settings(zenoh=routed)) == routed


def test_a_robots_own_certificate_sees_nothing_so_another_is_asked_with(tmp_path: Path) -> None:
    own = tmp_path / "gateway/robot.json5"
    settings = Settings(zenoh=ZenohSettings(config=str(own)))
    assert doctor.settings_to_ask(settings).config == str(own)
    for seeing in (tmp_path / "recorder/recorder.json5", tmp_path / "gateway/viewer.json5"):
        seeing.parent.mkdir(exist_ok=True)
        seeing.touch()
        assert doctor.settings_to_ask(settings).config == str(seeing)


def _arguments(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--config")
    doctor.add_arguments(parser)
    return parser.parse_args(list(words))


def _network(tmp_path: Path) -> Network:
    return Network(tmp_path, "tls/127.0.0.1:47447")


@pytest.mark.parametrize("role", ["operator", "viewer", "desk", "recorder"])
def test_settings_of_somebody_who_is_no_robot_are_refused_with_what_to_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, role: str
) -> None:
    monkeypatch.setattr(doctor, "look", lambda *_, **__: FACTS)
    place = _network(tmp_path).node(TransportRole(role), "ann")
    zenoh = ZenohSettings(config=str(place / f"{role}.json5"))
    settings = Settings(zenoh=zenoh, authority=AuthoritySettings(mode="signed", directory=str(place)))
    own = _arguments("--config", f"{role}.toml")
    with pytest.raises(
        CommandError, match=rf"of the role {role} .*--config robot\.toml.*'cruiser why ROBOT'"
    ) as caught:
        doctor.run(own, settings, lambda: False)
    assert caught.value.code is ExitCode.USAGE
    named = _arguments("--config", "robot.toml", "--zenoh-config", zenoh.config)
    doctor.run(named, settings, lambda: False)
    (place / "robot.key").write_text("")
    doctor.run(own, settings, lambda: False)

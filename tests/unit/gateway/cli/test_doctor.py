"""``cruiser doctor``: whom it asks, and what it prints."""

import argparse
import json
from pathlib import Path

import pytest

from gateway.cli import doctor
from gateway.doctor.checks import Diagnosis
from gateway.doctor.facts import Facts
from schemas.exit_codes import ExitCode
from schemas.settings import Settings, ZenohSettings

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
    """A note changes neither exit code nor last line; as JSON it is the same."""
    assert doctor.report(FACTS, found, as_json=False) is code
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(printed)
    assert all(line.startswith(text) for line, text in zip(lines, printed, strict=True))
    assert doctor.report(FACTS, found, as_json=True) is code
    said = json.loads(capsys.readouterr().out)
    assert said["ok"] == (code is ExitCode.OK) == bool(said["summary"])
    assert [one["check"] for one in said["findings"]] == [one.check for one in found]


def test_a_gateway_is_asked_where_it_listens() -> None:
    """On all addresses is on this machine's own; who connects elsewhere is asked there."""
    listening = ZenohSettings(listen=["tcp/0.0.0.0:7450", "tcp/[::]:7451", "tcp/10.0.0.7:7452"])
    asking = doctor.settings_to_ask(Settings(zenoh=listening))
    assert asking.connect == ["tcp/127.0.0.1:7450", "tcp/[::1]:7451", "tcp/10.0.0.7:7452"]
    assert asking.listen == []
    routed = ZenohSettings(connect=["tcp/10.0.0.5:7447"], listen=["tcp/127.0.0.1:7447"])
    assert doctor.settings_to_ask(Settings(zenoh=routed)) == routed


def test_a_robots_own_certificate_sees_nothing_so_another_is_asked_with(tmp_path: Path) -> None:
    """That of the recorder beside it, or of a viewer in the same directory; else its own."""
    own = tmp_path / "gateway/robot.json5"
    settings = Settings(zenoh=ZenohSettings(config=str(own)))
    assert doctor.settings_to_ask(settings).config == str(own)
    for seeing in (tmp_path / "recorder/recorder.json5", tmp_path / "gateway/viewer.json5"):
        seeing.parent.mkdir(exist_ok=True)
        seeing.touch()
        assert doctor.settings_to_ask(settings).config == str(seeing)


def test_the_systems_settings_are_read_where_nobody_names_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flag holds against the file; CRUISER_CONFIG and --config name another."""
    file = tmp_path / "cruiser.toml"
    file.write_text('[robot]\nname = "depot-3"\n[can]\nchannel = "can5"\n')
    seen: list[Settings] = []

    def look(settings: Settings, *_: object) -> Facts:
        seen.append(settings)
        return FACTS

    monkeypatch.setattr(doctor, "SYSTEM_FILE", file)
    monkeypatch.setattr(doctor, "look", look)
    monkeypatch.setattr(doctor, "diagnose", lambda _: [])
    parser = argparse.ArgumentParser()
    parser.add_argument("--config")
    doctor.add_arguments(parser)
    monkeypatch.delenv("CRUISER_CONFIG", raising=False)
    doctor.run(parser.parse_args(["--channel", "can6"]), Settings(), lambda: False)
    assert (seen[0].robot.name, seen[0].can.channel) == ("depot-3", "can6")
    doctor.run(parser.parse_args(["--config", "other.toml"]), Settings(), lambda: False)
    monkeypatch.setenv("CRUISER_CONFIG", "another.toml")
    doctor.run(parser.parse_args([]), Settings(), lambda: False)
    assert [one.robot.name for one in seen[1:]] == ["cruiser-1", "cruiser-1"]

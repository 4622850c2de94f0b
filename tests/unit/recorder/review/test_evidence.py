"""Archives of evidence: what is in them, and what somebody did to them."""

from __future__ import annotations

import fcntl
import json
import zipfile
from collections.abc import Callable
from copy import copy
from pathlib import Path

import msgspec
import pytest

from recorder.review.evidence import (
    COMPLETENESS,
    INCIDENT,
    MANIFEST,
    PROOF,
    SIGNATURE,
    STATEMENTS,
    UNPACKED_MAX_BYTES,
    EvidenceCheck,
    EvidenceManifest,
    read_evidence,
)
from recorder.review.verifying.findings import ProofFault
from schemas.authority.proof import ProofKind, signed_bytes
from schemas.decisions import SignedStatement
from schemas.exit_codes import CommandError, ExitCode
from tests.support.authority import NOW_S, Fleet, Party, S
from tests.support.commands import review
from tests.support.logs import saved
from tests.support.provisioned import private_pem, write_authority
from tests.support.rigs.recorded import RecordedRig
from tests.support.signed_run import driven, log_of

FLEET = Fleet()
RUN, ANN = driven(FLEET, 120)
LOG = log_of(RUN.samples)
DESK = Party("desk")
AT = "70"


@pytest.mark.parametrize(("at", "code"), [("20", 0), ("70", 0), ("100", 3)])
def test_a_log_that_is_still_recorded_gives_an_archive_of_what_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], at: str, code: int
) -> None:
    """It says up to when that is; 3 only where the time asked for goes on after that."""
    path = saved(tmp_path / "log.mcap.part", LOG[: len(LOG) * 98 // 100])
    out = tmp_path / "out.zip"
    with path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert review("evidence", str(path), "--at", at, "-o", str(out)) == code
    said = capsys.readouterr()
    assert not said.err
    manifest = read(out).manifest
    assert manifest.complete_to_ns is not None
    assert manifest.is_early == (code == 3)
    assert any("still being recorded" in one for one in manifest.missing) == (code == 3)
    assert review("verify", str(out)) == 0


def test_a_log_whose_recorder_died_is_cut_off(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody goes on with it."""
    path = saved(tmp_path / "log.mcap.part", LOG[: len(LOG) * 9 // 10])
    assert review("evidence", str(path), "--at", "20", "-o", str(tmp_path / "out.zip")) == 3
    assert "cut off" in capsys.readouterr().err


@pytest.fixture
def authority(tmp_path: Path) -> str:
    """The fleet's authority.json."""
    return str(write_authority(tmp_path, FLEET) / "authority.json")


def gathered(directory: Path, *words: str, log: bytes = LOG, signed: bool = True) -> Path:
    """An archive of a log."""
    out = directory / "incident.zip"
    if signed:
        key = saved(directory / "desk.key", private_pem(DESK))
        key.chmod(0o600)
        words = ("--key", str(key), *words)
    path = saved(directory / "log.mcap", log)
    assert review("evidence", str(path), "--at", AT, "-o", str(out), *words) in {0, 3}
    return out


def read(path: Path) -> EvidenceCheck:
    """What an archive holds; its files are unpacked beside it."""
    directory = path.with_suffix(".d")
    directory.mkdir(exist_ok=True)
    return read_evidence(path, directory)


def changed(path: Path, change: Callable[[dict[str, bytes]], None]) -> Path:
    """The archive with other files in it."""
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def test_an_archive_holds_the_incident_with_its_proofs_and_verifies(
    tmp_path: Path, authority: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A minute before and half a minute after; the grants, though they were shown long before."""
    path = gathered(tmp_path)
    found = read(path)
    assert not found.findings
    assert found.signer == DESK.key.hex()
    manifest = found.manifest
    assert (manifest.incident_ns - manifest.from_ns, manifest.to_ns - manifest.incident_ns) == (60 * S, 30 * S + 1)
    assert {INCIDENT, STATEMENTS, PROOF, COMPLETENESS} <= manifest.files.keys()
    assert manifest.sources == {"log.mcap": len(LOG)}
    assert {one.text for one in found.statements} == {
        one.text for one in RUN.samples if isinstance(one, SignedStatement)
    }
    capsys.readouterr()
    assert review("verify", str(path), "--authority", authority) == 0
    out = capsys.readouterr().out
    assert f"signed by {DESK.key.hex()}" in out
    assert "all holds" in out
    (proof,) = json.loads((path.with_suffix(".d") / PROOF).read_bytes())
    assert proof["runs"][0]["subjects"]["journal"]["proven"] > 85 * 20


def test_an_archive_without_a_key_says_that_nobody_signed_it(
    tmp_path: Path, authority: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the robot signed holds all the same."""
    path = gathered(tmp_path, signed=False)
    assert "not signed" in capsys.readouterr().out
    assert review("verify", str(path), "--authority", authority) == 0
    assert "not signed" in capsys.readouterr().out


def test_the_times_around_it_are_chosen(tmp_path: Path) -> None:
    """In seconds."""
    manifest = read(gathered(tmp_path, "--before", "5", "--after", "2")).manifest
    assert (manifest.incident_ns - manifest.from_ns, manifest.to_ns - manifest.incident_ns) == (5 * S, 2 * S + 1)
    assert manifest.incident_ns == pytest.approx(NOW_S * S + 70 * S, abs=S)


def test_the_command_that_it_names_runs_the_incident_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From where the gateway was at rest, though that was before the part that is asked for."""
    rig, operator = RecordedRig.ready()
    rig.run(6)
    operator.engage()
    operator.drive(0.6, 0.0, 8.0)
    rig.rest_after(1.0)
    path = gathered(tmp_path, "--at", "12", "--before", "2", "--after", "1", log=rig.log(), signed=False)
    found = read(path)
    command = next(one for one in found.manifest.commands if "rerun" in one)
    *_, question, name = command.split()
    capsys.readouterr()
    assert review(question, "--json", "--processes", "1", str(path.with_suffix(".d") / name)) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["same"]["safety/decision"] > 20
    assert not again["difference_count"]
    assert list(path.with_suffix(".d").glob("settings-*.toml"))


def test_a_run_that_begins_in_the_part_is_run_again_from_its_beginning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Though more was asked for than the log holds."""
    rig, operator = RecordedRig.ready()
    operator.engage()
    operator.drive(0.6, 0.0, 3.0)
    path = gathered(tmp_path, "--at", "3", log=rig.log(), signed=False)
    assert not [one for one in read(path).manifest.missing if "run again" in one]
    capsys.readouterr()
    rerun = str(path.with_suffix(".d") / "rerun.mcap")
    assert review("rerun", "--json", "--processes", "1", rerun) == 0
    assert json.loads(capsys.readouterr().out)["first"] == 0


def test_the_same_logs_give_the_same_archive(tmp_path: Path) -> None:
    """Byte for byte, so that two who made one can compare."""
    archives = [gathered(tmp_path / name, signed=False).read_bytes() for name in ("one", "other")]
    assert archives[0] == archives[1]


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    """Samples that were removed before, and settings that no log holds."""
    samples = [one for place, one in enumerate(RUN.samples) if place != 1500]
    manifest = read(gathered(tmp_path, log=log_of(samples))).manifest
    words = "\n".join(manifest.missing)
    assert "missing" in words
    assert "settings are not in the logs" in words


def _touch_log(files: dict[str, bytes]) -> None:
    files[INCIDENT] = files[INCIDENT][:-1] + b"\0"


def _touch_manifest(files: dict[str, bytes]) -> None:
    manifest = msgspec.json.decode(files[MANIFEST], type=EvidenceManifest)
    files[MANIFEST] = msgspec.json.encode(msgspec.structs.replace(manifest, missing=[]))


def _sign_anew(files: dict[str, bytes]) -> None:
    _touch_manifest(files)
    forger = Party()
    signature = forger.private.sign(signed_bytes(ProofKind.STATEMENT, files[MANIFEST])).hex()
    files[SIGNATURE] = f"ed25519 {DESK.key.hex()} {signature}\n".encode()


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (_touch_log, ProofFault.CHANGED),
        (_touch_manifest, ProofFault.WRONGLY_SIGNED),
        (_sign_anew, ProofFault.WRONGLY_SIGNED),
        (lambda files: files.pop(INCIDENT), ProofFault.MISSING),
        (lambda files: files.update(extra=b"x"), ProofFault.CHANGED),
        (lambda files: files.update({SIGNATURE: b"ed25519"}), ProofFault.WRONGLY_SIGNED),
        (lambda files: files.update({STATEMENTS: b"[]"}), ProofFault.CHANGED),
    ],
    ids=["log", "manifest", "signature", "removed", "added", "no signature", "statements"],
)
def test_an_archive_that_was_changed_is_found(
    tmp_path: Path, authority: str, change: Callable[[dict[str, bytes]], None], fault: ProofFault
) -> None:
    """Whatever file it is, with exit code 1."""
    path = changed(gathered(tmp_path), change)
    assert fault in {one.fault for one in read(path).findings}
    assert review("verify", str(path), "--authority", authority) == 1


@pytest.mark.parametrize("name", ["../escape", "/escape", "a/b", ".hidden"])
def test_no_file_of_an_archive_lands_elsewhere(tmp_path: Path, name: str) -> None:
    """Its manifest may name whatever it likes."""

    def change(files: dict[str, bytes]) -> None:
        manifest = msgspec.json.decode(files[MANIFEST], type=EvidenceManifest)
        entry = manifest.files[STATEMENTS]
        files[name] = files.pop(STATEMENTS)
        files[MANIFEST] = msgspec.json.encode(msgspec.structs.replace(manifest, files={name: entry}))

    path = changed(gathered(tmp_path), change)
    before = set(tmp_path.rglob("*"))
    assert read(path).findings
    assert {one.parent for one in set(tmp_path.rglob("*")) - before} <= {path.with_suffix(".d"), tmp_path}
    assert not list(tmp_path.rglob("*escape*"))


@pytest.mark.parametrize("content", [b"", b"PK\3\4", b"no zip", LOG])
def test_what_is_no_archive_is_said_to_be_none(tmp_path: Path, content: bytes) -> None:
    """In a line that names it."""
    with pytest.raises(CommandError, match=r"some\.zip"):
        review("verify", str(saved(tmp_path / "some.zip", content)))


@pytest.mark.parametrize("packing", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
def test_no_archive_fills_the_disk(tmp_path: Path, packing: int) -> None:
    """Neither by many files of zeros, nor by files that lie one over the other."""
    path = tmp_path / "incident.zip"
    zeros = bytes(UNPACKED_MAX_BYTES if packing == zipfile.ZIP_DEFLATED else 1000)
    with zipfile.ZipFile(path, "w", packing) as archive:
        archive.writestr(MANIFEST, "{}")
        archive.writestr("0.mcap", zeros)
        for number in range(1, 5):
            entry = copy(archive.getinfo("0.mcap"))
            entry.filename = f"{number}.mcap"
            archive.filelist.append(entry)
            archive.NameToInfo[entry.filename] = entry
    with pytest.raises(CommandError, match="unpacks to much more"):
        read(path)
    assert not list(path.with_suffix(".d").iterdir())


def test_nothing_is_overwritten_and_no_time_of_elsewhere_is_taken(tmp_path: Path) -> None:
    """One clear line each."""
    path = gathered(tmp_path)
    log = str(tmp_path / "log.mcap")
    with pytest.raises(CommandError, match="not overwritten"):
        review("evidence", log, "--at", AT, "-o", str(path))
    with pytest.raises(CommandError, match="hold nothing of that time") as raised:
        review("evidence", log, "--at", "1000", "-o", str(tmp_path / "other.zip"))
    assert raised.value.code == ExitCode.USAGE


@pytest.mark.parametrize("content", [b"", b"junk"])
def test_a_key_that_is_none_is_named_with_the_cure(tmp_path: Path, content: bytes) -> None:
    """Before a log is read."""
    key = saved(tmp_path / "desk.key", content)
    key.chmod(0o600)
    with pytest.raises(CommandError, match=r"desk\.key.*openssl"):
        review("evidence", "nowhere", "--at", "1", "-o", str(tmp_path / "x.zip"), "--key", str(key))


def test_a_key_that_others_can_read_is_refused(tmp_path: Path) -> None:
    """With the command that mends it."""
    key = saved(tmp_path / "desk.key", private_pem(DESK))
    key.chmod(0o644)
    with pytest.raises(CommandError, match="chmod 600"):
        review("evidence", "nowhere", "--at", "1", "-o", str(tmp_path / "x.zip"), "--key", str(key))

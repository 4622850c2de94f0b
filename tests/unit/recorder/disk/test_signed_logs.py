"""Logs signed by their recorder."""

from __future__ import annotations

import errno
import hashlib
import os
from pathlib import Path

import pytest

from recorder.disk import files
from recorder.disk.files import LogDirectory
from recorder.disk.keeper import DiskKeeper, recover_leftovers
from recorder.disk.log_writer import LogWriter
from recorder.encoding.protobuf import descriptor_set
from recorder.mcap.writer import LogChannel
from recorder.record.actions import CloseLog, DeclareChannel, OpenLog, WriteChunk
from recorder.record.retention import DiskLimits
from recorder.record.signed_mode import LogSignature, LogSigner
from schemas.authority.key_files import Identity
from schemas.authority.proof import GrantRole
from schemas.messages import Gear
from tests.support.authority import Fleet, Party
from tests.support.fakes.recording import failing
from tests.support.logs import flipped, sealed, small_log
from tests.support.messages import WALL_NS
from tests.support.waiting import wait_until

FLEET = Fleet()
RECORDER = Party("depot-1")
FLEET.authority.grant(RECORDER, role=GrantRole.RECORDER)
SIGNER = LogSigner(Identity(RECORDER.private, RECORDER.chain, FLEET.trust))
NAME = "x-20270115T080000Z.mcap"


def written(directory: Path) -> Path:
    writer = LogWriter(LogDirectory(directory, SIGNER), "test")
    channel = DeclareChannel("x", LogChannel(1, "t", "cruiser.Gear", descriptor_set(Gear)))
    chunk = WriteChunk("x", sealed([(1, 1, WALL_NS, WALL_NS, os.urandom(1000))]))
    writer.submit([OpenLog("x", "x", WALL_NS), channel, chunk, CloseLog("x")])
    writer.close()
    return directory / NAME


def signature_of(log: Path) -> LogSignature:
    found = LogSignature.read(Path(f"{log}.sig").read_bytes())
    assert found is not None
    assert found.fits
    assert found.key == RECORDER.key
    assert found.sha256 == hashlib.sha256(log.read_bytes()).hexdigest()
    return found


def test_a_finished_log_is_signed(tmp_path: Path) -> None:
    assert signature_of(written(tmp_path)).file == NAME


@pytest.mark.parametrize("data", [small_log(), small_log()[:-3], flipped(small_log())])
def test_what_a_killed_recorder_left_is_signed_at_the_next_start(tmp_path: Path, data: bytes) -> None:
    (tmp_path / f"{NAME}.part").write_bytes(data)
    (tmp_path / f"{NAME}.sig").write_text("half a signa")
    assert len(list(recover_leftovers(tmp_path.glob("*.part"), "test", SIGNER))) == 1
    assert signature_of(tmp_path / NAME).file == NAME


def test_a_log_without_room_for_its_signature_has_no_name_until_there_is_some(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(files, "write_signature", failing(errno.ENOSPC))
        assert not written(tmp_path).exists()
    (part,) = tmp_path.glob("*.part")
    assert len(list(recover_leftovers([part], "test", SIGNER))) == 1
    signature_of(tmp_path / NAME)


def test_a_log_takes_its_signature_with_it(tmp_path: Path) -> None:
    written(tmp_path)
    keeper = DiskKeeper(tmp_path, DiskLimits(budget_bytes=1))
    try:
        wait_until(lambda: not list(tmp_path.iterdir()))
    finally:
        keeper.close()

"""The signature beside a log, checked by other tools."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

from recorder.record.signed_mode import LogSigner
from schemas.authority.key_files import Identity
from schemas.authority.proof import GrantRole
from tests.support.authority import Fleet, Party

NAME = "x-20270115T080000Z.mcap"
CHECK = f"""
sed -n 2p {NAME}.sig | sha256sum --check &&
head -n 2 {NAME}.sig >signed && sed -n 3p {NAME}.sig | base64 -d >signature &&
openssl pkeyutl -verify -pubin -inkey {NAME}.sig -rawin -in signed -sigfile signature
"""


def checked(directory: Path) -> str:
    done = subprocess.run(["/bin/sh", "-c", CHECK], cwd=directory, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def test_anybody_can_check_a_log_with_openssl(tmp_path: Path) -> None:
    fleet, recorder = Fleet(), Party("depot-1")
    fleet.authority.grant(recorder, role=GrantRole.RECORDER)
    log, beside = tmp_path / NAME, tmp_path / f"{NAME}.sig"
    log.write_bytes(b"a log")
    signer = LogSigner(Identity(recorder.private, recorder.chain, fleet.trust))
    beside.write_bytes(signer.sign(hashlib.sha256(b"a log").hexdigest(), NAME))
    assert "Signature Verified Successfully" in checked(tmp_path)
    log.write_bytes(b"a Log")
    assert "FAILED" in checked(tmp_path)
    text = beside.read_text()
    beside.write_text(text.replace(text.split()[1], hashlib.sha256(b"a Log").hexdigest()))
    assert "Signature Verification Failure" in checked(tmp_path)

"""Log files against the signatures that their recorders put beside them."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final

import msgspec

from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.rows import Progress
from recorder.record.signature import SIGNATURE_MAX_BYTES, SIGNATURE_SUFFIX, LogSignature
from recorder.review.verifying.findings import ProofFault, ProofFinding
from schemas.authority.proof import chain_text
from schemas.command_line import other_kind

UNSIGNED: Final = "no recorder has signed the log, as in open mode or by an earlier version: nothing proves it"
OPEN: Final = "a log that is still being written is signed when it is finished"

_BLOCK: Final = 1 << 20


class SignedFile(msgspec.Struct, frozen=True):
    """A log file, and what the signature beside it proves.

    Attributes:
        file: its name.
        sha256: of all of it, hexadecimal.
        key: the key that signed it, hexadecimal; empty if none did.
        grant: identifier of that key's grant, hexadecimal; ``statement`` its text, with those of its signers.
        finding: what is wrong with the signature, or that there is none; None if it fits.
    """

    file: str
    sha256: str = ""
    key: str = ""
    grant: str = ""
    statement: str = ""
    finding: ProofFinding | None = None


def prove_file(log: LogFile, faults: Faults, progress: Progress) -> SignedFile:
    """Hold a file against the signature beside it. Whose the signature is another question.

    Args:
        log: the file.
        faults: takes what cannot be read.
        progress: is called while it is read, with no bytes.
    """
    name = log.path.name
    if log.is_being_written:
        return SignedFile(name, finding=ProofFinding(ProofFault.UNPROVEN, OPEN))
    try:
        data = _beside(log.path)
        digest = hashlib.sha256()
        with log.open() as stream:
            while data and (block := stream.read(_BLOCK)):
                digest.update(block)
                progress(0)
    except OSError as error:
        faults.add(f"{log.name}: {error.strerror or error}")
        return SignedFile(name, finding=ProofFinding(ProofFault.UNPROVEN, "a file cannot be read"))
    if not data:
        return SignedFile(name, finding=ProofFinding(ProofFault.UNPROVEN, UNSIGNED))
    found = LogSignature.read(data)
    if found is None:
        what = f"{name}: its signature is in no form that a recorder writes"
        return SignedFile(name, digest.hexdigest(), finding=ProofFinding(ProofFault.CHANGED, what))
    finding = None
    if not found.fits:
        finding = ProofFinding(ProofFault.WRONGLY_SIGNED, f"{name}: its signature is not that of the key it names")
    elif found.sha256 != digest.hexdigest():
        finding = ProofFinding(ProofFault.CHANGED, f"{name} is not the file that its recorder signed")
    first = found.chain[0]
    return SignedFile(name, digest.hexdigest(), found.key.hex(), first.id.hex(), chain_text(found.chain), finding)


def _beside(path: Path) -> bytes:
    """The signature beside a log; empty if there is none."""
    beside = path.with_name(path.name + SIGNATURE_SUFFIX)
    try:
        if other_kind(beside.stat().st_mode):
            return b"\n"
        with beside.open("rb") as stream:
            return stream.read(SIGNATURE_MAX_BYTES + 1) or b"\n"
    except FileNotFoundError:
        return b""

"""An archive of the logs around an incident, whose manifest shows whether it was changed since."""

from __future__ import annotations

import hashlib
import re
import zipfile
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, TypeVar

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from gateway.rerun.rerun import places
from recorder.disk.new_file import new_file
from recorder.reading.configurations import configurations_of
from recorder.reading.faults import Faults
from recorder.reading.log_file import LogFile
from recorder.reading.logs import find_logs
from recorder.reading.rows import Progress, Selection, read_rows
from recorder.reading.survey import survey
from recorder.reading.times import in_words
from recorder.review.check import check_stream
from recorder.review.cut import cut
from recorder.review.info import read_info
from recorder.review.rerun.beginning import beginning
from recorder.review.rerun.tapes import JOURNAL
from recorder.review.verify import shown_statements, verify_logs
from recorder.review.verifying.authority import ShownStatement
from recorder.review.verifying.findings import ProofFault, ProofFinding
from schemas.authority.proof import ProofKind, signed_bytes
from schemas.authority.trust import fits
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain

FORMAT: Final = "cruiser-evidence-1"
MANIFEST, SIGNATURE = "manifest.json", "manifest.sig"
INCIDENT, RERUN = "incident.mcap", "rerun.mcap"
STATEMENTS, PROOF, COMPLETENESS = "statements.json", "proof.json", "completeness.json"

RERUN_TOPICS: Final = ("*/journal", "*/safety/*", "*/can/*/tx", "*/authority/*", "*/gateway/info")
"""The topics that are needed to run a drive again, and to compare the results."""

UNPACKED_MAX_BYTES: Final = 64_000_000
"""A file of an archive that is compressed is no larger: logs are compressed in themselves."""

ALL_UNPACKED_MAX_BYTES: Final = 4 * UNPACKED_MAX_BYTES
"""All that is compressed in an archive, together."""

_DATE: Final = (1980, 1, 1, 0, 0, 0)
"""The same logs give the same archive: its files have no time of their own."""

_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,200}")
_SIGNATURE: Final = re.compile(rb"ed25519 ([0-9a-f]{64}) ([0-9a-f]{128})\n")
_BLOCK: Final = 1 << 20


class EvidenceFile(msgspec.Struct, frozen=True):
    """A file of an archive."""

    bytes: int
    sha256: str


class EvidenceManifest(msgspec.Struct, frozen=True):
    """The manifest of an archive. Times are nanoseconds since 1970, by the recorder's clock.

    Attributes:
        incident_ns: the moment that it is about.
        from_ns, to_ns: the part of the logs in ``incident.mcap``.
        sources: names and lengths of the logs that it was made of.
        versions: of the software that ran, as the logs say.
        missing: the known gaps of the archive, for people; empty if there is none.
        commands: command lines that ask the archive's own questions again, after it was unpacked.
        files: all other files of the archive.
        complete_to_ns: the log time to which the logs went that were still being recorded; None if none was.
    """

    format: str
    incident_ns: int
    from_ns: int
    to_ns: int
    sources: dict[str, int]
    versions: dict[str, str]
    missing: list[str]
    commands: list[str]
    files: dict[str, EvidenceFile]
    complete_to_ns: int | None = None

    @property
    def is_early(self) -> bool:
        """The archive was made before all of its time was recorded."""
        return self.complete_to_ns is not None and self.complete_to_ns < self.to_ns


class EvidenceCheck(msgspec.Struct, frozen=True):
    """An archive, and whether it is what its manifest says.

    Attributes:
        manifest: as it stands there.
        signer: the key under which the manifest is signed, hexadecimal; empty if it is not.
        statements: grants and revocations of the logs that it was made of.
        findings: files that are missing, changed or not in the manifest; a signature that does not fit.
    """

    manifest: EvidenceManifest
    signer: str
    statements: list[ShownStatement]
    findings: list[ProofFinding]


def gather(
    logs: Sequence[LogFile],
    path: Path,
    at_ns: int,
    period: tuple[int, int],
    private: Ed25519PrivateKey | None,
    faults: Faults,
    progress: Progress = lambda _: None,
) -> EvidenceManifest:
    """Write an archive.

    Args:
        logs: in the order of their beginnings, as ``find_logs`` gives them.
        path: the new file.
        at_ns: the moment of the incident, nanoseconds since 1970.
        period: the first log time that goes in, and the first one that is too late.
        private: signs the manifest; None leaves it unsigned.
        faults: takes what cannot be read; all the rest is in the archive.
        progress: receives the number of bytes that were read.

    Raises:
        CommandError: the file is there already, or cannot be written, or there are several logs.
    """
    if path.exists():
        raise CommandError(f"{plain(str(path))} exists, and is not overwritten")
    if len(logs) > 1:
        raise CommandError(f"evidence is of one log, and these are {len(logs)}", ExitCode.USAGE)
    with TemporaryDirectory(prefix=".evidence-", dir=path.parent) as name:
        directory = Path(name)
        cut(logs[0], directory / INCIDENT, _within(*period), [], faults, progress)
        missing = _cut_rerun(logs, directory, at_ns, period, faults, progress)
        commands = [f"cruiser review verify {plain(path.name)} --authority authority.json"]
        if (directory / RERUN).exists():
            commands.append(f"cruiser review rerun {RERUN}")
        statements = shown_statements(logs, faults)
        _save(directory / STATEMENTS, statements)
        parts = find_logs(sorted(directory.glob("*.mcap")), faults)
        proofs = list(verify_logs(parts, faults, (), statements))
        _save(directory / PROOF, proofs)
        with (directory / INCIDENT).open("rb") as stream:
            checked = check_stream(stream, (directory / INCIDENT).stat().st_size, INCIDENT)
        _save(directory / COMPLETENESS, checked)
        found = survey(logs, faults)
        for robot in found.robots:
            text = configurations_of(robot, logs, found, faults).at(at_ns)
            if text is None:
                missing.append(f"{robot}: its settings are not in the logs")
            else:
                (directory / f"settings-{robot.replace('/', '.')}.toml").write_text(text, encoding="utf-8")
        missing += [f"{one.topic}: {one.what} ({one.count})".removeprefix(": ") for one in checked.findings]
        # A recorder may hold the last half second of each in its hand.
        growing = [log.end_ns for log in logs if log.is_being_written]
        complete_to_ns = min(growing, default=None)
        if complete_to_ns is not None and complete_to_ns < period[1]:
            missing.append(
                f"what came after {in_words(complete_to_ns)}: the logs were still being recorded; made again "
                f"after {in_words(period[1])}, or once the recorder was ended, it has all"
            )
        missing += [_in_words(report.robot, one) for report in proofs for one in report.findings]
        manifest = EvidenceManifest(
            format=FORMAT,
            incident_ns=at_ns,
            from_ns=period[0],
            to_ns=period[1],
            sources={log.path.name: log.bytes for log in logs},
            versions=read_info(directory / INCIDENT).versions,
            missing=[*missing, *faults.told],
            commands=commands,
            files={file.name: _described(file) for file in sorted(directory.iterdir())},
            complete_to_ns=complete_to_ns,
        )
        _write(path, directory, manifest, private)
    return manifest


def _cut_rerun(
    logs: Sequence[LogFile],
    directory: Path,
    at_ns: int,
    period: tuple[int, int],
    faults: Faults,
    progress: Progress,
) -> list[str]:
    """Cut what it takes to run the incident again, from where it can begin. Returns what is missing for that."""
    missing, begins = [], []
    for robot in survey(logs, faults).robots:
        wanted = Selection(lambda topic, of=robot: topic.robot == of and topic.subject == JOURNAL)  # type: ignore[misc]
        begin_ns = beginning(read_rows(logs, wanted, faults, progress), places, period[0], at_ns, faults)
        if begin_ns is None:
            missing.append(f"{robot}: no place before the incident from which it can be run again")
        else:
            begins.append(begin_ns)
    if begins:
        cut(logs[0], directory / RERUN, _within(min(begins), period[1]), RERUN_TOPICS, faults, progress)
    return missing


def _within(from_ns: int, to_ns: int) -> Selection:
    return Selection(from_ns=from_ns, to_ns=to_ns)


def read_evidence(path: Path, directory: Path) -> EvidenceCheck:
    """Unpack an archive, and hold it against its manifest.

    Args:
        path: the archive.
        directory: takes the files whose digests fit.

    Raises:
        CommandError: it cannot be read, or is none.
    """
    shown = plain(str(path))
    try:
        with zipfile.ZipFile(path) as archive:
            names = {one.filename: one for one in archive.infolist()}
            if len(names) != len(archive.infolist()):
                raise CommandError(f"{shown} holds two files of one name")
            if _unpacks_to_too_much(archive.infolist(), path.stat().st_size):
                raise CommandError(f"{shown} unpacks to much more than an archive of evidence holds")
            content = _small(archive, names, MANIFEST)
            manifest = _decoded(content, EvidenceManifest)
            if manifest is None or manifest.format != FORMAT:
                raise CommandError(f"{shown} has no manifest of '{FORMAT}'")
            signer, findings = _signer(content, _small(archive, names, SIGNATURE))
            for name in sorted(names.keys() - manifest.files.keys() - {MANIFEST, SIGNATURE}):
                findings.append(ProofFinding(ProofFault.CHANGED, f"{plain(name)} is not in the manifest"))
            for name, file in manifest.files.items():
                entry = names.get(name)
                if entry is None:
                    findings.append(ProofFinding(ProofFault.MISSING, plain(name)))
                elif not _unpack(archive, entry, file, directory):
                    findings.append(
                        ProofFinding(ProofFault.CHANGED, f"{plain(name)} is not the file of the manifest")
                    )
    except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, RuntimeError) as error:
        raise CommandError(f"cannot read {shown}: {plain(str(error))}") from error
    said = directory / STATEMENTS
    statements = _decoded(said.read_bytes() if said.exists() else b"", list[ShownStatement])
    return EvidenceCheck(manifest, signer, statements or [], findings)


def _unpacks_to_too_much(entries: Sequence[zipfile.ZipInfo], size: int) -> bool:
    """Return True if the files of an archive of this length are many bombs, or lie one over the other."""
    stored = sum(one.file_size for one in entries if one.compress_type == zipfile.ZIP_STORED)
    packed = sum(one.file_size for one in entries if one.compress_type != zipfile.ZIP_STORED)
    return stored > size or packed > ALL_UNPACKED_MAX_BYTES


def _signer(manifest: bytes, signature: bytes) -> tuple[str, list[ProofFinding]]:
    """The key that signed a manifest, empty if none did; and what is wrong with the signature."""
    if not signature:
        return "", []
    match = _SIGNATURE.fullmatch(signature)
    if match is None:
        return "", [ProofFinding(ProofFault.WRONGLY_SIGNED, f"{SIGNATURE} is no signature")]
    key, proof = (bytes.fromhex(part.decode()) for part in match.groups())
    if not fits(key, proof, signed_bytes(ProofKind.EVIDENCE, manifest)):
        return "", [ProofFinding(ProofFault.WRONGLY_SIGNED, "the manifest is not what was signed")]
    return key.hex(), []


def _small(archive: zipfile.ZipFile, names: dict[str, zipfile.ZipInfo], name: str) -> bytes:
    """The content of one of the small files; empty if it is not there, or too large."""
    entry = names.get(name)
    if entry is None or entry.file_size > UNPACKED_MAX_BYTES:
        return b""
    with archive.open(entry) as stream:
        return stream.read(UNPACKED_MAX_BYTES)


def _unpack(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, file: EvidenceFile, directory: Path) -> bool:
    """Write a file of the archive; False, and nothing is left, if it is not the one of the manifest."""
    is_bounded = entry.compress_type == zipfile.ZIP_STORED or entry.file_size <= UNPACKED_MAX_BYTES
    if not is_bounded or entry.file_size != file.bytes or not _NAME.fullmatch(entry.filename):
        return False
    digest, path = hashlib.sha256(), directory / entry.filename
    try:
        with archive.open(entry) as stream, path.open("wb") as out:
            while block := stream.read(_BLOCK):
                digest.update(block)
                out.write(block)
    except zipfile.BadZipFile:
        path.unlink(missing_ok=True)
        return False
    if digest.hexdigest() != file.sha256:
        path.unlink()
        return False
    return True


def _write(path: Path, directory: Path, manifest: EvidenceManifest, private: Ed25519PrivateKey | None) -> None:
    content = msgspec.json.format(msgspec.json.encode(manifest))
    with new_file(path) as out, zipfile.ZipFile(out, "w") as archive:
        _add(archive, MANIFEST, content)
        if private is not None:
            key = private.public_key().public_bytes_raw().hex()
            signature = private.sign(signed_bytes(ProofKind.EVIDENCE, content)).hex()
            _add(archive, SIGNATURE, f"ed25519 {key} {signature}\n".encode())
        for name in manifest.files:
            if name.endswith(".mcap"):
                with (
                    (directory / name).open("rb") as source,
                    archive.open(_entry(name), "w", force_zip64=True) as to,
                ):
                    while block := source.read(_BLOCK):
                        to.write(block)
            else:
                _add(archive, name, (directory / name).read_bytes())


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    archive.writestr(_entry(name), content, zipfile.ZIP_DEFLATED)


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name, _DATE)
    entry.external_attr = 0o644 << 16
    return entry


def _described(path: Path) -> EvidenceFile:
    with path.open("rb") as stream:
        return EvidenceFile(path.stat().st_size, hashlib.file_digest(stream, "sha256").hexdigest())


def _save(path: Path, what: object) -> None:
    path.write_bytes(msgspec.json.format(msgspec.json.encode(what)))


Decoded = TypeVar("Decoded")


def _decoded(content: bytes, kind: type[Decoded]) -> Decoded | None:
    try:
        return msgspec.json.decode(content, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return None


def _in_words(robot: str, one: ProofFinding) -> str:
    return f"{robot}: {one.fault.value.replace('_', ' ')}: {one.what} ({one.count})"

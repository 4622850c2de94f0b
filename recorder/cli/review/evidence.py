"""``cruiser review evidence``: what logs hold around an incident, in one archive."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import msgspec

from recorder.cli.review.asking import add_logs, end_with, find, progress_bar
from recorder.disk.key_files import read_private_key
from recorder.reading.times import FORMS, in_words, time_of
from recorder.review.evidence import EvidenceManifest, gather
from schemas.arguments import seconds
from schemas.exit_codes import CommandError, ExitCode
from schemas.printable import plain
from schemas.settings import Settings

BEFORE_S: Final = 60.0
AFTER_S: Final = 30.0

EXAMPLE: Final = (
    "  cruiser review evidence logs --at 03:04:05 -o incident.zip --key desk.key\n"
    "  cruiser review verify incident.zip --authority authority.json"
)
DESCRIPTION: Final = (
    "Writes one archive with the part of logs around an incident, the grants and revocations of all of them, "
    "chain heads, settings, software versions, what is missing, and the command that runs it again. A manifest "
    "has the SHA-256 of each file, and is signed with --key. 'cruiser review verify' reads it. Nothing is "
    "overwritten. Logs that are still being recorded are taken as far as they go. Exit code 3 if something could "
    "not be read, or was not recorded yet; the rest is in the archive."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    add_logs(parser)
    parser.add_argument("--at", required=True, metavar="TIME", help=f"the moment of the incident: {FORMS}")
    parser.add_argument(
        "--before", type=seconds, default=BEFORE_S, metavar="S", help=f"so long before it ({BEFORE_S:g})"
    )
    parser.add_argument(
        "--after", type=seconds, default=AFTER_S, metavar="S", help=f"so long after it ({AFTER_S:g})"
    )
    parser.add_argument("--key", type=Path, metavar="FILE", help="sign with this Ed25519 key, PEM (not signed)")
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="FILE", help="the new archive, a zip file"
    )


def run(arguments: argparse.Namespace, _settings: Settings, stopped: Callable[[], bool]) -> int:
    """Gather."""
    private = None if arguments.key is None else read_private_key(arguments.key)
    # Nobody has signed a catalog.
    asked = find(arguments, with_catalog=False)
    at_ns = time_of(arguments.at, asked.start_ns, asked.end_ns)
    if not asked.start_ns <= at_ns <= asked.end_ns:
        period = f"{in_words(asked.start_ns)} to {in_words(asked.end_ns)}"
        raise CommandError(f"the logs hold nothing of that time: they go from {period}", ExitCode.USAGE)
    part = max(0, at_ns - round(arguments.before * 1e9)), at_ns + round(arguments.after * 1e9) + 1
    with progress_bar("gathering", asked.bytes, stopped) as progress:
        manifest = gather(asked.logs, arguments.out, at_ns, part, private, asked.faults, progress)
    is_signed = private is not None
    text = msgspec.json.encode(manifest).decode() if arguments.json else describe(manifest, is_signed=is_signed)
    sys.stdout.write(f"{text}\n")
    code = end_with(asked.faults)
    return int(ExitCode.PARTIAL) if manifest.is_early else code


def describe(manifest: EvidenceManifest, *, is_signed: bool) -> str:
    """An archive for people."""
    # A log's names come from anywhere, and may try to rule the terminal.
    return "\n".join(map(plain, _lines(manifest, is_signed=is_signed)))


def _lines(manifest: EvidenceManifest, *, is_signed: bool) -> Iterator[str]:
    yield f"{in_words(manifest.from_ns)} to {in_words(manifest.to_ns)}, around {in_words(manifest.incident_ns)}"
    yield from (f"  {name}: {file.bytes} bytes, SHA-256 {file.sha256}" for name, file in manifest.files.items())
    yield "  signed" if is_signed else "  not signed: nobody vouches for what was put in (--key)"
    yield from (f"  missing: {one}" for one in manifest.missing)
    yield from (f"  {command}" for command in manifest.commands)

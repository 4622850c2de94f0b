"""``cruiser review verify``: who commanded when, with which grant, and is each file as its recorder signed it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import msgspec

from recorder.cli.asking import add_logs, end_with, find, progress_bar, table, worst
from recorder.reading.times import in_words
from recorder.review.verify import RobotProofReport, verify_logs
from recorder.review.verifying import GrantInfo, ProofFault, ProofFinding, RefusedProof, SignedFile
from schemas.authority.trust import AuthorityKeys, key_fingerprint, keys_fingerprint
from schemas.command_line import CommandError, ExitCode, check_regular, plain
from schemas.settings import Settings

EXAMPLE: Final = "  cruiser review verify logs --authority authority.json"
DESCRIPTION: Final = (
    "Lists who commanded robots in signed mode, when and with which grant. Verifies each signed verb and each "
    "grant up to the fleet's authority, and each file by its recorder's signature (NAME.mcap.sig beside it). "
    "Data omitted by a router or the recorder is not noticed. Exit code 0 if all holds, 1 if anything was "
    "changed, wrongly signed or not granted, 3 if something cannot be read or proven: in open mode, without a "
    "signature, or under another authority than the given one, such as the one before a rotation."
)
JSON_HELP: Final = "print a JSON object a line, one for each robot"

VERBS_SHOWN: Final = 200  # signed verbs that are listed; ``--json`` has all


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_logs(parser, json_help=JSON_HELP)
    parser.add_argument(
        "--authority",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="the fleet's authority.json; without it the authority named in the log is not verified. For logs "
        "across a rotation give the earlier one, or both",
    )


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    given = {path: read_authority(path) for path in arguments.authority}
    asked = find(arguments, settings, stopped, with_covered=True)
    codes = list[int]()
    with progress_bar("verifying", asked.bytes, stopped, prints=True) as progress:
        for report in verify_logs(asked.logs, asked.faults, [keys.trust for keys in given.values()], progress):
            codes.append(
                ExitCode.FAILURE if report.is_broken else ExitCode.OK if report.is_proven else ExitCode.PARTIAL
            )
            text = msgspec.json.encode(report).decode() if arguments.json else describe(report)
            sys.stdout.write(f"{text}\n")
    codes.append(end_with(asked.faults))
    if len(codes) == 1:
        sys.stderr.write("cruiser review: the logs hold no robot, so there is nothing to verify\n")
        codes.append(ExitCode.PARTIAL)
    if not arguments.json:
        sys.stdout.writelines(
            f"{plain(str(path))}: keys {keys_fingerprint(keys)}\n" for path, keys in given.items()
        )
    return worst(codes)


def read_authority(path: Path) -> AuthorityKeys:
    """Read the fleet's authority from a file; CommandError if that is not possible."""
    shown = plain(str(path))
    try:
        check_regular(path, path.stat().st_mode)
        return msgspec.json.decode(path.read_bytes(), type=AuthorityKeys)
    except OSError as error:
        raise CommandError(f"cannot read {shown}: {error.strerror or error}", ExitCode.USAGE) from error
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise CommandError(
            f"{shown} is no authority.json: {plain(str(error))}; 'cruiser provision install' writes one",
            ExitCode.USAGE,
        ) from error


def describe(report: RobotProofReport) -> str:
    # A log's names are untrusted: protect the terminal.
    return "\n".join(map(plain, _lines(report)))


def _lines(report: RobotProofReport) -> Iterator[str]:
    yield f"{report.robot}: {_whole(report)}"
    vouched = "as given" if report.is_vouched else "from the log, not verified (--authority)"
    if report.is_of_other_authority:
        vouched = "NOT AS GIVEN: the following is by the log alone, not verified"
    yield from (f"  authority's key {key_fingerprint(key)}, {vouched}" for key in report.authorities)
    if report.robot_key:
        yield f"  robot's key {report.robot_key}"
    names = {one.id: f"{one.name}, {one.role}, serial {one.serial}" for one in report.grants}
    yield from (f"  {_file(one, names)}" for one in report.files)
    yield from (f"  grant {_grant(one)}" for one in report.grants)
    for holder in report.holders:
        under = names.get(holder.grant, holder.grant) or "the log does not show its grant"
        yield (
            f"  {holder.operator} held lease {holder.lease} from {in_words(holder.from_ns)} to "
            f"{in_words(holder.to_ns)}, {holder.drives} drive commands; grant: {under}"
        )
    yield from table(
        ("signed verb", "operator", "time", "grant", ""),
        [
            (one.verb, one.operator, in_words(one.time_ns), one.grant, "holds" if one.holds else one.detail)
            for one in report.verbs[:VERBS_SHOWN]
        ],
        words=5,
    )
    more = len(report.verbs) - VERBS_SHOWN + report.verbs_untold
    if more > 0:
        yield f"  and {more} more signed verbs"
    yield from (f"  refused: {_refused(one)}" for one in report.refused)
    yield from (f"  unproven stop: {_refused(one)}" for one in report.unproven_stops)
    for finding in report.findings:
        word = "unproven" if finding.fault is ProofFault.UNPROVEN else finding.fault.value.replace("_", " ")
        often = "" if finding.time_ns is None and finding.count == 1 else f" ({finding.count}{_when(finding)})"
        yield f"  {word}: {finding.what}{often}"


def _whole(report: RobotProofReport) -> str:
    """The verdict on all of a robot's logs."""
    if report.is_broken:
        return "NOT AS IT WAS SIGNED"
    if report.is_of_other_authority:
        return "UNDER ANOTHER AUTHORITY than the given one: not verified"
    if report.holds:
        return "the readable part holds, but NOT ALL COULD BE READ" if report.unread else "all holds"
    return "not all can be proven"


def _when(finding: ProofFinding) -> str:
    if finding.time_ns is None:
        return ""
    if finding.until_ns is None:
        return f", at {in_words(finding.time_ns)}"
    return f", from {in_words(finding.time_ns)} to {in_words(finding.until_ns)}"


def _file(one: SignedFile, names: dict[str, str]) -> str:
    if not one.key:
        return f"{one.file}: NOT SIGNED"
    by = f"{names.get(one.grant, 'an unknown signer')}, key {key_fingerprint(one.key)}"
    return (
        f"{one.file}: signed by {by}, since it received it" if one.fits else f"{one.file}: NOT AS SIGNED by {by}"
    )


def _grant(one: GrantInfo) -> str:
    by = " < ".join([*one.signers, "authority"])
    until = f"{in_words(one.not_before * 1_000_000_000)} to {in_words(one.not_after * 1_000_000_000)}"
    fault = f"; DOES NOT HOLD: {one.objection}" if one.objection else ""
    return f"{one.id}: {one.name}, {one.role}, serial {one.serial}, by {by}, {until}{fault}"


def _refused(one: RefusedProof) -> str:
    until = "" if one.first_ns == one.last_ns else f" to {in_words(one.last_ns)}"
    return f"{one.count} x {one.verb} of {one.operator}: {one.reason}, {in_words(one.first_ns)}{until}"

"""The statements in each file of a log."""

from __future__ import annotations

from pathlib import Path

import pytest

from recorder.reading.logs import Faults, find_logs
from recorder.record.actions import LogAction, WriteMetadata
from recorder.record.robots import STATEMENTS_MAX_BYTES, STATEMENTS_NAME, Statements
from recorder.record.signed_mode import VERIFIED_PER_TICK, StatementProofs
from recorder.review.verify import RobotProofReport, verify_logs
from recorder.review.verifying import UNSIGNED, ShownStatement, file_statements
from schemas.authority.proof import chain_text
from schemas.decisions import SignedStatement
from schemas.messages import Message
from schemas.subjects import TEXT_MAX_BYTES
from tests.support.authority import NOW_S, Fleet, Party, S
from tests.support.fakes.recording import MemoryFile
from tests.support.logs import mcap_log, saved
from tests.support.messages import key_of, sample_of
from tests.support.rigs.recorder import RecorderRig, messages
from tests.support.signed_run import driven


def entries(actions: list[LogAction]) -> dict[str, str]:
    (action,) = actions
    assert isinstance(action, WriteMetadata)
    assert action.lasts
    return action.entries


def test_what_the_robots_have_shown_is_written_once() -> None:
    statements = Statements("log")
    assert statements.describe() == []
    statements.receive("fleet/a", "one", 10)
    statements.receive("fleet/b", "one", 20)
    assert entries(statements.describe()) == {"fleet/a 10 0": "one", "fleet/b 20 1": "one"}
    statements.receive("fleet/a", "one", 30)
    assert statements.describe() == []
    statements.receive("fleet/a", "two", 40)
    assert sorted(entries(statements.describe())) == ["fleet/a 10 1", "fleet/a 40 2", "fleet/b 20 0"]


def test_statements_that_somebody_makes_up_take_a_bounded_room() -> None:
    statements = Statements("log")
    for number in range(200):
        statements.receive("fleet/a", "in force", 1)
        statements.receive("fleet/a", f"{number:01000}", number)
    kept = entries(statements.describe()).values()
    assert sum(map(len, kept)) <= STATEMENTS_MAX_BYTES
    assert "in force" in kept
    assert f"{199:01000}" in kept
    assert f"{0:01000}" not in kept


@pytest.mark.parametrize("forge", ["junk", "of another authority", "in the authority's name"])
def test_what_nobody_signed_displaces_nothing_that_the_authority_did(forge: str) -> None:
    fleet, forger = Fleet(), Fleet()
    grant, revoked = chain_text(fleet.operator().chain), fleet.authority.revoke(1).text()
    statements = Statements("log", StatementProofs(fleet.trust))
    statements.receive("fleet/a", grant, 1)
    statements.receive("fleet/a", revoked, 2)
    for number in range(300):
        statements.tick()
        made_up = {
            "junk": "x" * (TEXT_MAX_BYTES - 4) + f"{number:04}",
            "of another authority": chain_text(forger.operator(f"{number:0500}"[:60]).chain),
            "in the authority's name": revoked.replace('serial":1', f'serial":{number + 2}'),
        }[forge]
        statements.receive("fleet/a", made_up, 3)
    kept = list(entries(statements.describe()).values())
    assert kept[:2] == [grant, revoked]
    assert sum(map(len, kept)) <= 2 * STATEMENTS_MAX_BYTES


def test_what_was_not_verified_at_once_is_proven_when_it_is_repeated() -> None:
    fleet = Fleet()
    lists = [fleet.authority.revoke(serial).text() for serial in range(1, 2 * VERIFIED_PER_TICK + 1)]
    statements = Statements("log", StatementProofs(fleet.trust))
    for _ in range(2):
        for text in lists:
            statements.receive("fleet/a", text, 1)
        statements.tick()
    for number in range(9):
        statements.receive("fleet/a", "x" * (TEXT_MAX_BYTES - 1) + f"{number}", 2)
    assert set(lists) < set(entries(statements.describe()).values())


def test_what_the_authority_after_a_rotation_signs_is_proven() -> None:
    fleet, active, standby = Fleet(), Party("new"), Party("newer")
    before = fleet.authority.revoke(1).text()
    rotation = fleet.standby.rotate(1, active, standby).text()
    after = active.revoke(2).text()
    statements = Statements("log", StatementProofs(fleet.trust))
    for text in (before, rotation, after):
        statements.receive("fleet/a", text, 1)
        statements.tick()
    for number in range(9):
        statements.receive("fleet/a", "x" * (TEXT_MAX_BYTES - 1) + f"{number}", 2)
    assert list(entries(statements.describe()).values())[:3] == [before, rotation, after]


@pytest.mark.parametrize(
    "text", ["x" * (STATEMENTS_MAX_BYTES + 1), "x" * (TEXT_MAX_BYTES + 1), "é" * TEXT_MAX_BYTES]
)
def test_a_text_that_is_too_long_for_a_statement_displaces_none(text: str) -> None:
    statements = Statements("log")
    statements.receive("fleet/a", "in force", 1)
    statements.receive("fleet/a", text, 2)
    statements.receive("fleet/a", "y" * TEXT_MAX_BYTES, 3)
    assert list(entries(statements.describe()).values()) == ["in force", "y" * TEXT_MAX_BYTES]


RUN_S = 8


def recorded(bench: RecorderRig, fleet: Fleet) -> list[Message]:
    run, _ = driven(fleet, RUN_S)
    for number, message in enumerate(run.samples):
        bench.now_ns = message.time_ns - NOW_S * S
        bench.receive(sample_of(message))
        bench.tick()
        if number == len(run.samples) // 2:
            bench.writer.apply(bench.recorder.roll("split", bench.now_ns))
        bench.notice()
    bench.mark()
    bench.notice()
    bench.close()
    return run.samples


@pytest.mark.parametrize("log", ["cruiser-1", "cruiser-1!"])
def test_a_file_that_begins_later_holds_what_proves_it(bench: RecorderRig, tmp_path: Path, log: str) -> None:
    fleet = Fleet()
    samples = recorded(bench, fleet)
    file = bench.writer.files[log][-1]
    topics = {topic for topic, _ in messages(file)}
    assert key_of(SignedStatement) not in topics
    faults = Faults()
    logs = find_logs([saved(tmp_path / "log.mcap", file.disk.getvalue())], faults)
    said = {(one.text, one.time_ns) for one in samples if isinstance(one, SignedStatement)}
    assert {(one.text, one.time_ns) for one in file_statements(logs, faults)} == said
    (report,) = verify_logs(logs, faults, [fleet.trust])
    assert not faults, faults.told
    assert [one.what for one in report.findings] == [UNSIGNED]
    assert report.robot_key
    assert not verified_without_them(tmp_path, file).robot_key


def verified_without_them(directory: Path, file: MemoryFile) -> RobotProofReport:
    """Verify a file without its metadata."""
    data = file.disk.getvalue().replace(STATEMENTS_NAME.encode(), b"cruiser.somethings")
    faults = Faults()
    (report,) = verify_logs(find_logs([saved(directory / "without.mcap", data)], faults), faults)
    return report


@pytest.mark.parametrize("name", ["", "fleet/a", "fleet/a x 0", "fleet/a -1 0", "fleet/a " + 30 * "9"])
def test_entries_of_another_form_are_passed_over(tmp_path: Path, name: str) -> None:
    entries = {name: "junk", "fleet/a 12 0": "text"}
    path = saved(tmp_path / "log.mcap", mcap_log([], [], [(STATEMENTS_NAME, entries)]))
    faults = Faults()
    found = list(file_statements(find_logs([path], faults), faults))
    assert found == [ShownStatement("a", 12, "text")]
    assert not faults

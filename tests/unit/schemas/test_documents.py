from enum import Enum

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import documents
from schemas.configuration import SETTINGS
from schemas.decisions import ArbiterState, Bound, EventKind, Severity, StopPhase, Verdict
from schemas.messages import Mode
from schemas.reasons import Reason
from schemas.requests import Role
from schemas.subjects import COMMANDS, SUBJECTS


@given(text=st.text())
def test_a_text_without_markers_is_left_alone(text: str) -> None:
    """What was written by hand is never touched."""
    assert documents.rewrite(text, documents.PARTS) == text


@given(
    before=st.text(st.characters(exclude_characters="<")),
    old=st.text(st.characters(exclude_characters="<")),
    after=st.text(st.characters(exclude_characters="<")),
    name=st.sampled_from(["keys", "some-part"]),
    made=st.text(st.characters(exclude_characters="<"), max_size=20),
)
def test_only_what_is_between_the_markers_is_rewritten(
    before: str, old: str, after: str, name: str, made: str
) -> None:
    """The text around a part stays as it is, and rewriting twice is rewriting once."""
    text = f"{before}<!-- generated: {name} -->\n{old}<!-- end -->{after}"
    parts = {name: lambda: made}
    once = documents.rewrite(text, parts)
    assert once == f"{before}<!-- generated: {name} -->\n\n{made}\n\n<!-- end -->{after}"
    assert documents.rewrite(once, parts) == once


def test_the_tables_have_a_row_for_everything() -> None:
    """Every subject, setting, verb and reason is in its table, each row with as many cells as the head."""
    for table, names in (
        (documents.key_table(), [subject.name for subject in SUBJECTS]),
        (documents.settings_table(), list(SETTINGS)),
        (documents.command_table(), [command.verb for command in COMMANDS]),
        (documents.reason_table(), [reason.value for reason in Reason]),
    ):
        rows = [line for line in table.splitlines() if line.startswith("|")]
        assert len({row.replace("\\|", "").count("|") for row in rows}) == 1
        for name in names:
            assert sum(f"| `{name}` |" in row for row in rows) == 1


def test_every_field_of_a_feedback_message_has_a_meaning() -> None:
    """Where neither the class nor the type says what a field means, the DBC's comment does."""
    feedback = documents.message_tables().partition("### Odometry")[0]
    rows = [line for line in feedback.splitlines() if line.startswith("| `")]
    assert rows
    assert all(row.split(" | ")[-1].strip(" |") for row in rows)


def test_each_message_class_is_described_once() -> None:
    """Frames received and sent are one class with two keys."""
    text = documents.message_tables()
    for kind in {subject.type for subject in SUBJECTS}:
        assert text.count(f"### {kind.__name__}\n") == 1
    for subject in SUBJECTS:
        assert text.count(f"`{{root}}/{{robot}}/{subject.name}`") == 1


@pytest.mark.parametrize(
    "kind", [ArbiterState, Bound, EventKind, Mode, Reason, Role, Severity, StopPhase, Verdict]
)
def test_an_enumeration_of_any_module_has_its_values_in_their_order(kind: type[Enum]) -> None:
    """The order of the class is the order of meaning."""
    values = ", ".join(f"`{member.value}`" for member in kind)
    heading = f"### {kind.__name__}\n"
    text = documents.message_tables()
    assert text.count(heading) == 1
    assert text.partition(heading)[2].split("\n\n")[1] == f"Values: {values}."


def test_a_row_says_what_a_late_joiner_gets() -> None:
    """And nothing about it where there is no history."""
    rows = {line.split(" | ")[0].strip("| `"): line for line in documents.key_table().splitlines()}
    assert "express, late joiners get the last |" in rows["safety/state"]
    assert "late joiners get the last 1000, the newest 2 MB are kept for queries |" in rows["safety/decision"]
    assert "late joiners" not in rows["gateway/health"]


def test_a_request_in_one_line_tells_what_may_be_left_out() -> None:
    """Units where there are any, brackets around what has a start value, schemas; a put has no reply."""
    rows = {line.split(" | ")[0].strip("| `"): line for line in documents.command_table().splitlines()}
    assert "`speed_mps` m/s, [`angle_deg` deg], [`curvature_1pm` 1/m]" in rows["drive"]
    assert "| `Drive/2` | none |" in rows["drive"]
    assert "| nothing | `Stop/1` | `Reply/1` |" in rows["stop"]
    assert "[`role` Role], [`public_key` bytes] | `Acquire/1` | `LeaseReply/1` |" in rows["acquire"]


def test_every_request_and_reply_has_its_fields() -> None:
    """The lease is told once, and every other field at its verb."""
    text = documents.request_tables()
    sections = {part.partition("\n")[0]: part for part in text.split("### ")}
    for command in COMMANDS:
        for kind in (command.request, command.reply):
            heading = command.verb if kind is command.request else kind.__name__
            for field in kind.__struct_fields__:
                where = "In every request that wants the lease" if field == "lease" else heading
                where = heading if kind is command.reply else where
                assert f"| `{field}` |" in sections[where]
    assert "Wants the lease." in sections["renew"]
    assert "Wants the lease." not in sections["stop"]
    assert "`operator` if left out" in sections["acquire"]

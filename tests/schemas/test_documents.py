from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas import documents
from schemas.setting_table import SETTINGS
from schemas.subjects import SUBJECTS


def test_the_documents_are_current(capsys: pytest.CaptureFixture[str]) -> None:
    """Every generated part of README.md and docs/*.md is what the tables say; 'make generate' makes it so."""
    assert documents.main(["--check"]) == 0, capsys.readouterr().err


@given(text=st.text())
def test_a_text_without_markers_is_left_alone(text: str) -> None:
    """What was written by hand is never touched."""
    assert documents.rewrite(text) == text


@given(
    before=st.text(st.characters(exclude_characters="<")),
    old=st.text(st.characters(exclude_characters="<")),
    after=st.text(st.characters(exclude_characters="<")),
    name=st.sampled_from(list(documents.PARTS)),
)
def test_only_what_is_between_the_markers_is_rewritten(before: str, old: str, after: str, name: str) -> None:
    """The text around a part stays as it is, and rewriting twice is rewriting once."""
    text = f"{before}<!-- generated: {name} -->\n{old}<!-- end -->{after}"
    once = documents.rewrite(text)
    assert once == f"{before}<!-- generated: {name} -->\n\n{documents.PARTS[name]()}\n\n<!-- end -->{after}"
    assert documents.rewrite(once) == once


def test_a_marker_of_no_part_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A misspelt marker is an error, not an empty part."""
    (tmp_path / "README.md").write_text("<!-- generated: kees -->\n<!-- end -->\n", encoding="utf-8")
    assert documents.main(["--root", str(tmp_path)]) == 1
    assert "kees" in capsys.readouterr().err


def test_a_stale_document_is_found_and_made_current(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--check names a document that is not current and leaves it; without it the document is rewritten."""
    (tmp_path / "docs").mkdir()
    document = tmp_path / "docs" / "keys.md"
    document.write_text("<!-- generated: keys -->\nold\n<!-- end -->\n", encoding="utf-8")
    assert documents.main(["--root", str(tmp_path), "--check"]) == 1
    assert "keys.md" in capsys.readouterr().err
    assert "old" in document.read_text(encoding="utf-8")
    assert documents.main(["--root", str(tmp_path)]) == 0
    assert documents.main(["--root", str(tmp_path), "--check"]) == 0


def test_the_tables_have_a_row_for_everything() -> None:
    """Every subject and every setting is in its table, each row with as many cells as the head."""
    for table, names in (
        (documents.key_table(), [subject.name for subject in SUBJECTS]),
        (documents.settings_table(), list(SETTINGS)),
    ):
        rows = [line for line in table.splitlines() if line.startswith("|")]
        assert len({row.replace("\\|", "").count("|") for row in rows}) == 1
        for name in names:
            assert sum(f"| `{name}` |" in row for row in rows) == 1


def test_every_field_of_a_feedback_message_has_a_meaning() -> None:
    """Where neither the class nor the type says what a field means, the DBC's comment does."""
    feedback = documents.message_tables().partition("### CanFrames")[0]
    rows = [line for line in feedback.splitlines() if line.startswith("| `")]
    assert rows
    assert all(row.split(" | ")[-1].strip(" |") for row in rows)

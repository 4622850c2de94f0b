from pathlib import Path

import pytest

from gateway import documents


def test_the_documents_are_current(capsys: pytest.CaptureFixture[str]) -> None:
    """Diagram and tables are those of the code; 'make generate' makes it so, and a change is seen in the page."""
    assert documents.main(["--check"]) == 0, capsys.readouterr().err


def test_a_marker_of_no_part_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A misspelt marker is an error, not an empty part."""
    (tmp_path / "README.md").write_text("<!-- generated: kees -->\n<!-- end -->\n", encoding="utf-8")
    assert documents.main(["--root", str(tmp_path)]) == 1
    assert "kees" in capsys.readouterr().err


def test_a_stale_part_is_found_and_made_current(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--check names the document and leaves it; else the parts of ``schemas`` and the arbiter's are rewritten."""
    readme = tmp_path / "README.md"
    parts = ("keys", *documents.PARTS)
    readme.write_text(
        "".join(f"<!-- generated: {part} -->\noutdated\n<!-- end -->\n" for part in parts), encoding="utf-8"
    )
    root = ["--root", str(tmp_path)]
    assert documents.main([*root, "--check"]) == 1
    assert "README.md" in capsys.readouterr().err
    assert readme.read_text(encoding="utf-8").count("outdated") == len(parts)
    assert documents.main(root) == 0
    assert documents.main([*root, "--check"]) == 0
    assert "outdated" not in readme.read_text(encoding="utf-8")

"""The generated parts of the documents."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def generate(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "docs/generate.py", *words], cwd=ROOT, check=False, capture_output=True, text=True
    )


def test_the_documents_are_current() -> None:
    """``make generate`` makes them so."""
    done = generate("--check")
    assert done.returncode == 0, done.stderr


def test_a_stale_part_is_found_and_made_current(tmp_path: Path) -> None:
    """``--check`` names the document and leaves it. A misspelt marker is an error, not an empty part."""
    readme = tmp_path / "README.md"
    readme.write_text("<!-- generated: reasons -->\noutdated\n<!-- end -->\n", encoding="utf-8")
    where = ("--root", str(tmp_path))
    stale = generate(*where, "--check")
    assert stale.returncode == 1
    assert "README.md" in stale.stderr
    assert "outdated" in readme.read_text(encoding="utf-8")
    assert generate(*where).returncode == 0
    assert generate(*where, "--check").returncode == 0
    readme.write_text("<!-- generated: kees -->\n<!-- end -->\n", encoding="utf-8")
    assert "kees" in generate(*where).stderr

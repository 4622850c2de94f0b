import re
from pathlib import Path

import pytest

from gateway import documents
from gateway.command.rulings import STOPS, TRANSITIONS
from schemas.documents import ROOT


def test_the_documents_are_current(capsys: pytest.CaptureFixture[str]) -> None:
    """The parts from the arbiter's tables are what these say too; 'make generate' makes it so."""
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


def test_the_diagram_has_an_arrow_for_every_transition() -> None:
    """And no other but the one to where it begins."""
    lines = [line.strip() for line in documents.state_diagram().splitlines()]
    assert (lines[0], lines[1], lines[-1]) == ("```mermaid", "stateDiagram-v2", "```")
    arrows = {
        f"{before.value} --> {after.value}: {trigger.value}" for (before, trigger), after in TRANSITIONS.items()
    }
    assert {line for line in lines if "-->" in line} == {"[*] --> standby", *arrows}


def test_every_metric_has_a_row() -> None:
    """With its label, and the field that it is made of."""
    lines = documents.metric_table().splitlines()
    assert "| `cruiser_safety_latched` | `reason` | `SafetyState.latched` |" in lines
    assert "| `cruiser_feedback_lost_total` |  | `FrameHealth.lost` |" in lines


def test_every_cause_to_stop_has_a_row() -> None:
    """With how hard it stops, and whether it is latched."""
    rows = documents.stop_table().splitlines()[2:]
    assert [row.split("`")[1] for row in rows] == [reason.value for reason in STOPS]
    for row, stop in zip(rows, STOPS.values(), strict=True):
        assert ("| emergency |" in row) == stop.at_once
        assert row.endswith("| yes |") == stop.latched


def test_every_rule_of_the_gate_is_on_the_safety_page() -> None:
    """Each with its test; that these exist is seen where all pages are looked at."""
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    assert len(re.findall(r"`tests/[\w/]+\.py::\w+`", page)) >= len(documents.BUS_RULES)


def test_every_frame_of_the_gate_has_its_bits() -> None:
    """In runs, without the counter and the checksum that all have."""
    rows = documents.bus_frame_table().splitlines()[2:]
    assert len(rows) == 8
    assert rows[1].startswith("| `0x18C4D2D0` | Auto_SteeringCmd | 0, 8..19 | 1502..2594: -23.99 to 23.99 deg |")
    assert "| `0x18C4D7D0` | Auto_LightCmd | 0, 8, 16 | 0, 1 each |" in rows

"""What the bench says around its figures. The figures themselves are no tests: machines differ."""

import subprocess
from pathlib import Path

from tests.bench.loads import beside
from tests.bench.origin import ROOT, commit, heading
from tests.bench.processes import empty_loop
from tests.support.waiting import wait_until


def test_the_first_line_names_command_and_commit() -> None:
    """So that a table can be made again."""
    line = heading(["--seconds", "5"], 5.0)
    assert line.startswith("python -m tests.bench --seconds 5 at ")
    assert commit() in line


def test_the_commit_is_that_of_the_checkout(tmp_path: Path) -> None:
    """With a mark where files differ from it; words where there is none."""
    assert commit(tmp_path) == "no commit"
    git = ["git", "-C", str(tmp_path), "-c", "user.name=n", "-c", "user.email=e@example.org"]
    file = tmp_path / "file"
    file.touch()
    for words in (["init", "-q"], ["add", "file"], ["commit", "-qm", "One"]):
        subprocess.run([*git, *words], check=True)
    clean = commit(tmp_path)
    assert subprocess.run(
        [*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    ).stdout.startswith(clean)
    file.write_text("other")
    assert commit(tmp_path) == f"{clean}-dirty"
    assert (ROOT / "Makefile").exists()


def test_a_figure_is_judged_by_its_difference_to_an_empty_loop() -> None:
    """At the share that has the goal."""
    ours, empty = [float(us) for us in range(1000, 2000)], [float(us) for us in range(1000)]
    assert beside(ours, empty, (0.5, 0.99), 0.99) == ("1.50 1.99 ms", "0.50 0.99 ms", "1.00 ms at p99")
    assert beside(ours, empty, (0.5,), 0.5)[2] == "1.00 ms at p50"
    assert beside([3000.0], [1000.0], (1,), 1)[2] == "2.00 ms at the longest"


def test_an_empty_loop_ticks_and_puts() -> None:
    """A real one: each tick has its lateness, and what is put comes."""
    with empty_loop() as empty:
        wait_until(lambda: len(empty.put_us) > 5)
    assert len(empty.lateness_us) >= len(empty.put_us) > 5
    assert empty.lateness_us == sorted(empty.lateness_us)
    assert min(empty.lateness_us) >= 0.0

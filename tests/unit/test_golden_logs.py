"""Golden logs give the same answers."""

import pytest

from tests.support.golden_logs import DIRECTORY, LOGS, MOST_BYTES, asked, difference

CASES = [(name, question) for name in LOGS for question in asked(name)]


@pytest.mark.parametrize(("name", "question"), CASES)
def test_a_golden_log_answers_as_it_did(name: str, question: str) -> None:
    """If the answer is better now: ``python -m tests.support.golden_logs``."""
    assert not (found := difference(name, question)), f"\n{found}"


@pytest.mark.parametrize("name", LOGS)
def test_a_golden_log_is_small_and_the_page_says_how_it_was_made(name: str) -> None:
    assert f"| `{name}` |" in (DIRECTORY / "README.md").read_text(encoding="utf-8")
    assert all(path.stat().st_size < MOST_BYTES for path in (DIRECTORY / name).iterdir())

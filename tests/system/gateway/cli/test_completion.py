"""Completion in a real bash."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[4] / "deploy" / "completion.bash"
COMPLETE = """
. "$1"; shift
COMP_WORDS=("$@") COMP_CWORD=$(($# - 1))
_cruiser
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.mark.parametrize(
    ("words", "some"),
    [
        (["d"], {"demo", "desk", "drive"}),
        (["review", "w"], {"why"}),
        (["record", ""], {"status", "mark"}),
        (["drive", "--s"], {"--seconds", "--speed"}),
        (["drive", "cruiser-1", "--speed", "1", "--an"], {"--angle"}),
        (["review", "why", "--a"], {"--at"}),
        (["provision", "sign", "--h"], {"--hours"}),
        (["nonsense", ""], set()),
    ],
)
def test_commands_questions_and_flags_are_completed(words: list[str], some: set[str]) -> None:
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["/bin/bash", "-c", COMPLETE, "bash", SCRIPT, "cruiser", *words],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
    )
    assert done.stderr == ""
    assert some <= set(done.stdout.split())
    assert all(word.startswith(words[-1]) for word in done.stdout.split())

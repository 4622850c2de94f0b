"""Golden logs are answered alike whatever the order of hashes, which is another one in each process."""

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize("seed", ["0", "1"])
def test_no_answer_hangs_on_the_order_of_hashes(seed: str) -> None:
    """An answer that iterates a set would."""
    command = [sys.executable, "-m", "tests.support.golden_logs", "--compare"]
    environment = {**os.environ, "PYTHONHASHSEED": seed}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr

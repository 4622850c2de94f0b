import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

GEAR = "(1436509052.249713) vcan0 18C4D1EF#0104000000000005"
# Python must not be told to leave its output unbuffered: the command has to see to that itself.
ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
COMMAND = [sys.executable, "-c", "import sys; from gateway.cli.main import main; sys.exit(main())", "decode"]


def test_a_file_is_read_in_the_variant_that_is_asked_for(tmp_path: Path) -> None:
    """The same frame is 40 times as fast in the coarse variant."""
    log = tmp_path / "drive.log"
    log.write_text("(1.0) can0 18C4D3EF#01190000000000 18\n(1.0) can0 18C4D3EF#0119000000000018\n")
    speeds = []
    for variant in ("coarse", "fine"):
        words = [*COMMAND, "--variant", variant, str(log)]
        done = subprocess.run(words, capture_output=True, check=False, timeout=60)
        assert (done.returncode, done.stderr) == (3, b"")
        speeds.append(json.loads(done.stdout.splitlines()[1])["signals"]["speed_mps"])
    assert speeds == [pytest.approx(1.0), pytest.approx(0.025)]


def test_each_line_comes_out_as_soon_as_it_went_in_and_a_signal_ends_the_wait() -> None:
    with subprocess.Popen(
        [*COMMAND, "--variant", "coarse"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=ENVIRONMENT,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        for _ in range(3):
            process.stdin.write(f"{GEAR}\n".encode())
            process.stdin.flush()
            assert json.loads(process.stdout.readline())["bus"] == "vcan0"
        os.kill(process.pid, signal.SIGTERM)
        assert process.wait(60) == 0
        assert process.stderr.read() == b""

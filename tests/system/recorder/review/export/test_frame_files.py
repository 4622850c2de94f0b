"""Files of raw frames, as can-utils read them."""

import shutil
import subprocess
from pathlib import Path

import pytest

from recorder.review.raw_frames import LoggedFrame, write_frames
from tests.support.messages import can_frame


@pytest.mark.skipif(shutil.which("log2asc") is None, reason="no log2asc is here (Debian: can-utils)")
def test_can_utils_read_the_candump_log(tmp_path: Path) -> None:
    frames = can_frame(), can_frame(0x123, data=b"", is_extended=False), can_frame(data=bytes(64), is_fd=True)
    [file] = write_frames(
        [LoggedFrame("cruiser-1", number == 1, one) for number, one in enumerate(frames)], tmp_path
    )
    command = ["log2asc", "-I", file.path, "can0"]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert sum("18C4D1EFx" in line or " 123 " in line for line in out.splitlines()) == len(frames)

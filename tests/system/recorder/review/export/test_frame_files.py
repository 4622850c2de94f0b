"""Files of raw frames, as can-utils read them."""

import shutil
import subprocess
from pathlib import Path

import pytest

from recorder.review.raw_frames import LoggedFrame, write_frames
from tests.support.messages import can_frame

FRAMES = (
    can_frame(0x18C4D1EF),
    can_frame(0x123, data=b"", is_extended=False),
    can_frame(0x18C4D1EF, data=bytes(64), is_fd=True),
)


@pytest.mark.skipif(shutil.which("log2asc") is None, reason="no log2asc is here (Debian: can-utils)")
def test_can_utils_read_the_candump_log(tmp_path: Path) -> None:
    frames = [LoggedFrame("cruiser-1", number % 2 == 1, frame) for number, frame in enumerate(FRAMES)]
    [file] = write_frames(frames, tmp_path)
    out = subprocess.run(
        ["log2asc", "-I", file.path, "can0"],  # noqa: S607 - wherever the system has it
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert sum("18C4D1EFx" in line or " 123 " in line for line in out.splitlines()) == len(FRAMES)

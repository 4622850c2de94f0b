"""A finished log on the disk."""

import asyncio
import hashlib
import os
from pathlib import Path

import pytest

from recorder.upload import finished
from recorder.upload.finished import PART_BYTES, READ_BYTES, digest


@pytest.mark.parametrize("size", [1, READ_BYTES + 1, PART_BYTES, PART_BYTES + 1, 2 * PART_BYTES])
def test_the_checksums_are_those_of_the_stores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    """S3 sums up the checksums of parts, and says how many there were."""
    monkeypatch.setattr(finished, "DISK_BYTES_PER_S", 0)
    data = os.urandom(size)
    (tmp_path / "log").write_bytes(data)
    parts = [hashlib.md5(data[at : at + PART_BYTES]).digest() for at in range(0, size, PART_BYTES)]  # noqa: S324
    with (tmp_path / "log").open("rb") as stream:
        found = asyncio.run(digest(stream))
    assert (found.bytes, found.sha256) == (size, hashlib.sha256(data).hexdigest())
    by_parts = f"{hashlib.md5(b''.join(parts)).hexdigest()}-{len(parts)}"  # noqa: S324
    assert found.e_tags == {hashlib.md5(data).hexdigest(), by_parts}  # noqa: S324

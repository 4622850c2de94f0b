import argparse
from pathlib import Path

import pytest

from recorder.cli.review import command as review
from recorder.cli.review import replay
from recorder.cli.review.asking import find
from recorder.replay.rows import By, runs
from tests.support.drives import drive_samples, write_samples
from tests.support.messages import MS, WALL_NS


@pytest.fixture
def log(tmp_path: Path) -> str:
    """A log of a robot."""
    return str(write_samples(tmp_path / "drive.mcap", drive_samples()))


def test_a_seek_stays_within_the_time_that_was_asked_for(log: str) -> None:
    """On it goes where it is told, and back no further than --from."""
    parser = argparse.ArgumentParser()
    review.add_arguments(parser)
    arguments = parser.parse_args(["replay", log, "--from", "0.1", "--to", "0.3"])
    player = replay._player(arguments, find(arguments), lambda _: True, lambda rows: runs(rows, By.LOG))
    player.start(0)
    found = []
    for offset_ms in (200, 0, 1000):
        player.seek(WALL_NS + offset_ms * MS, 0)
        due = player.take(0)
        found.append(None if due is None else (due.item.time_ns - WALL_NS) // MS)
    assert found == [200, 100, None]
    assert player.is_ended

"""``cruiser demo``: what it prints."""

from pathlib import Path

import pytest

from gateway.cli.child import fresh
from gateway.cli.demo import describe
from schemas.command_line import CommandError


def test_a_viewer_is_given_the_path_of_a_topic_in_the_log() -> None:
    """The topics begin with no slash, and one that holds slashes has to stand in quotes."""
    channels = [{"schema": "cruiser.CanFrame", "messages": 3}, {"schema": "cruiser.Body", "messages": 2}]
    info = {"incidents": [], "duration_s": 20.0, "messages": 5, "channels": channels, "bytes": 1}
    text = describe(Path("demo-log/a.mcap"), "fleet/cruiser-1", info)
    assert text.startswith("3 CAN frames in 20.0 s\n5 messages on 2 channels\n")
    assert 'plot e.g. "fleet/cruiser-1/state".speed_mps\n' in text


def test_an_out_that_is_no_directory_is_named(tmp_path: Path) -> None:
    """Not only what is wrong, but with what."""
    path = tmp_path / "file"
    path.touch()
    with pytest.raises(CommandError, match=rf"^cannot write in {path}: Not a directory$"):
        fresh(path)

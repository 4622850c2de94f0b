"""``cruiser demo``: what it prints."""

from gateway.cli.demo import describe


def test_a_viewer_is_given_the_path_of_a_topic_in_the_log() -> None:
    """The topics begin with no slash, and one that holds slashes has to stand in quotes."""
    summary = {
        "path": "demo-log/a.mcap",
        "incidents": [],
        "seconds": 20.0,
        "frames": 1,
        "messages": 1,
        "channels": 1,
        "bytes": 1,
        "frames_lost": 0,
        "samples_missed": 0,
    }
    assert 'plot e.g. "fleet/cruiser-1/state".speed_mps\n' in describe(summary, "fleet/cruiser-1")

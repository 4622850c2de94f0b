import pytest

from recorder.cli.asking import progress_bar


def test_whoever_is_told_to_stop_stops_reading() -> None:
    """At the next bytes that are read."""
    asked_to = [False, True]
    with progress_bar("reading", 100, lambda: asked_to.pop(0)) as progress:
        progress(1)
        with pytest.raises(KeyboardInterrupt):
            progress(1)
    assert not asked_to

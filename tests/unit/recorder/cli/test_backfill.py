from recorder.cli import backfill
from schemas.recorder_settings import RecorderSettings
from schemas.settings import Settings


def test_ones_own_recorder_is_not_asked() -> None:
    """Its logs have the same holes; unless it is the only one, by whatever name."""
    settings = Settings(recorder=RecorderSettings(name="depot"))
    assert backfill._others(["depot", "robot"], settings) == ["robot"]
    assert backfill._others(["depot"], settings) == ["depot"]

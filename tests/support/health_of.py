"""A recorder's health, for who needs one."""

from schemas.recording import RecorderHealth, RecorderState
from tests.support.recorder_fakes import WALL_NS


def health(state: RecorderState = RecorderState.RECORDING) -> RecorderHealth:
    """Of a recorder that has nothing to tell."""
    return RecorderHealth(
        time_ns=WALL_NS,
        sequence=0,
        recorder="bench",
        recorder_version="1",
        uptime_s=2.0,
        state=state,
        state_since_s=1.0,
        files=0,
        files_ended=0,
        ended_bytes=0,
        robots=0,
        keys=0,
        received=0,
        received_per_s=0.0,
        written=0,
        missed=0,
        dropped={},
        queue_bytes=0,
        disk_queue_bytes=0,
        ring_bytes=0,
        incidents=0,
        disk_free_bytes=0,
        disk_used_bytes=0,
        incident_bytes=0,
        cpu_percent=0.0,
    )

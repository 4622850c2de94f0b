"""What the logs of a recorder share. The logs themselves are tested through ``Recording``."""

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.mcap.chunk import ChunkBuilder
from recorder.record.effects import WriteChunk
from recorder.record.robot_log import Outlet, RobotLog, trim_rings
from tests.support.recorder_fakes import INCIDENT_PLAN, PLAN, SECOND

LOGS = 4


def chunk(number: int, size: int) -> WriteChunk:
    """A chunk of one message."""
    builder = ChunkBuilder()
    builder.add(1, number, number, number, bytes(size))
    sealed = builder.seal()
    assert sealed is not None
    return WriteChunk(sealed)


@given(
    steps=st.lists(st.tuples(st.integers(1, SECOND), st.integers(0, LOGS - 1), st.integers(1, 500))),
    wait_ns=st.integers(0, 40 * SECOND),
    limit_bytes=st.integers(0, 3000),
)
def test_all_rings_together_hold_the_newest(
    steps: list[tuple[int, int, int]], wait_ns: int, limit_bytes: int
) -> None:
    """Whosesoever it is: a robot that says much may use what the others leave."""
    outlet = Outlet()
    logs = [
        RobotLog(msgspec.structs.replace(PLAN, name=str(number)), INCIDENT_PLAN, outlet) for number in range(LOGS)
    ]
    now_ns = 0
    came: list[tuple[int, int]] = []
    for number, (step_ns, log, size) in enumerate(steps):
        now_ns += step_ns
        one = chunk(number, size)
        logs[log].incidents.take([one], now_ns)
        came.append((now_ns, len(one.chunk.records)))
    now_ns += wait_ns
    trim_rings(logs, now_ns, limit_bytes)
    young = [size for at_ns, size in came if now_ns - at_ns <= INCIDENT_PLAN.before_ns]
    while sum(young) > limit_bytes:
        young.pop(0)
    assert sum(log.incidents.ring_bytes for log in logs) == sum(young)

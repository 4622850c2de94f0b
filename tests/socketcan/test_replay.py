"""A log of the chassis's feedback, replayed by canplayer: what Zenoh's subscribers get of it."""

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import msgspec
import zenoh

from gateway import choice
from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import Frame
from gateway.sim.model import VirtualChassis
from schemas.messages import CanFrames, Variant
from schemas.settings import ZenohSettings
from schemas.subjects import SUBJECTS
from schemas.zenoh_session import close_session, open_session
from tests.socketcan.can_utils import Candump, play, write_log
from tests.socketcan.interface import Vcan
from tests.socketcan.road import gateway
from tests.support.fakes.peer import free_endpoint
from tests.support.waiting import wait_until

ROBOT: Final = "fleet/cruiser-1/"
STATE: Final = f"{ROBOT}safety/state"
LOG_S: Final = 5
WALL_NS: Final = 1_700_000_000_000_000_000
MESSAGES: Final = load(Variant.COARSE).messages
CHASSIS: Final = {
    f"{ROBOT}{subject.name}": MESSAGES[subject.dbc_message].can_id for subject in SUBJECTS if subject.dbc_message
}
"""The identifier behind each key."""


def feedback() -> list[Frame]:
    """What a chassis says in so many seconds."""
    chassis = VirtualChassis(choice.CHASSIS, Variant.COARSE, 0)
    times_ns = range(1_000_000, LOG_S * 1_000_000_000, 1_000_000)
    return [frame for now_ns in times_ns for frame in chassis.advance(now_ns, WALL_NS + now_ns)]


class Heard:
    """What a subscriber of a key expression got."""

    def __init__(self, session: zenoh.Session) -> None:
        self._subscriber = session.declare_subscriber(f"{ROBOT}**", zenoh.handlers.FifoChannel(100_000))
        self.counters: dict[int, list[int]] = {can_id: [] for can_id in CHASSIS.values()}
        self.raw: list[tuple[int, bytes]] = []
        self.keys: set[str] = set()

    def hear(self) -> None:
        while (sample := self._subscriber.try_recv()) is not None:
            key = str(sample.key_expr)
            self.keys.add(key)
            if key in CHASSIS:
                payload = msgspec.msgpack.decode(sample.payload.to_bytes())
                self.counters[CHASSIS[key]].append(payload["alive_counter"])
            elif key == f"{ROBOT}can/can0/rx":
                batch = msgspec.msgpack.decode(sample.payload.to_bytes(), type=CanFrames)
                self.raw += zip(batch.can_id, batch.data, strict=True)


@contextmanager
def hearing(endpoint: str) -> Iterator[Heard]:
    """A subscriber that the gateway knows: it hears of the arbiter, which speaks without a chassis."""
    session = open_session(ZenohSettings(mode="client"), [endpoint], [])
    try:
        heard = Heard(session)
        wait_until(lambda: STATE in heard.keys, heard.hear)
        yield heard
    finally:
        close_session(session)


def test_a_log_that_is_replayed_is_published_whole(vcan: Vcan, candump: Candump, tmp_path: Path) -> None:
    """Of each identifier as many samples as the log has frames, in its order; and each raw frame, byte by byte."""
    frames = feedback()
    write_log(tmp_path / "feedback.log", frames)
    endpoint = free_endpoint()
    with gateway(vcan.name, endpoint, "--variant", "coarse"), hearing(endpoint) as heard:
        play(vcan.name, tmp_path / "feedback.log")
        wait_until(lambda: len(heard.raw) >= len(frames), heard.hear)
        wait_until(lambda: sum(map(len, heard.counters.values())) >= len(frames), heard.hear)
    assert [frame.data for frame in candump.frames] == [frame.data for frame in frames]
    assert heard.raw == [(frame.can_id, frame.data) for frame in frames]
    count = Counter(frame.can_id for frame in frames)
    assert {can_id: len(counters) for can_id, counters in heard.counters.items()} == count
    for can_id, counters in heard.counters.items():
        assert counters == [frame.data[6] >> 4 for frame in frames if frame.can_id == can_id]

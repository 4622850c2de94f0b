"""Cost of a frame on its way to Zenoh: our path against cantools, json.dumps and session.put.

Both take the same frames in turns, with the same subscriber over TCP. Ours also checks and supervises.
"""

from __future__ import annotations

import gc
import json
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable
from statistics import median

import cantools
from cantools.database.can import Database

from gateway.chassis.frame import Frame
from gateway.choice.chassis import CHASSIS
from gateway.core import Core
from gateway.loop import LoopPorts, Reader
from gateway.telemetry.health import Links
from gateway.zenoh.node import ZenohNode
from schemas.cruiser import dbc_text
from schemas.messages import Variant
from schemas.settings import ChassisSettings, Settings, ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.bench.loads import Row
from tests.bench.recorder_load import SECONDS_OF_FRAMES
from tests.support.fakes.peer import free_endpoint
from tests.support.frames import Feedback

PASSES = 4

SUBSCRIBER = """
import sys, zenoh
from schemas.zenoh_session import open_session
from schemas.settings import ZenohSettings
session = open_session(ZenohSettings(), [sys.argv[1]], [])
subscriber = session.declare_subscriber("**", zenoh.handlers.RingChannel(1000))
print("ready", flush=True)
sys.stdin.read()
"""


def rows(rounds: int) -> list[Row]:
    """Processor time per frame of all threads, in us; medians of paired rounds."""
    endpoint = free_endpoint()
    session = open_session(ZenohSettings(), [], [endpoint])
    subscriber = subprocess.Popen(
        [sys.executable, "-c", SUBSCRIBER, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert subscriber.stdout is not None
        assert subscriber.stdout.readline() == "ready\n"
        feedback = Feedback(Variant.COARSE)
        frames = [
            (second * 1_000_000_000 + at_ns, frame)
            for second in range(SECONDS_OF_FRAMES)
            for at_ns, frame in feedback.second()
        ]
        settings = Settings(chassis=ChassisSettings(variant="coarse"))
        node = ZenohNode(session, settings)
        database = cantools.database.load_string(dbc_text(Variant.COARSE), database_format="dbc")
        assert isinstance(database, Database)

        core = Core(CHASSIS, settings, "bench", 0)
        core.update_links(Links(bus_up=True), 0)

        def path() -> None:
            run_ours(frames, core, node)

        def peer() -> None:
            bus = BurstyBus(frames)
            while (frame := bus.receive(1)) is not None:
                values = database.decode_message(frame.identifier, frame.data, decode_choices=False)
                session.put(f"peer/{frame.identifier:x}", json.dumps(values))

        # The frames themselves are the bench's, and no collection walks them. Ours runs without, as the loop does.
        gc.collect()
        gc.freeze()
        costs = [(_cost_us(path, len(frames)), _cost_us(peer, len(frames))) for _ in range(rounds)]
    finally:
        subscriber.communicate()
        close_session(session)
    ours_us, others_us = (median(us) for us in zip(*costs, strict=True))
    ratio = median(others / ours for ours, others in costs)
    return [
        ("CPU of a frame, from the frame to its sample", f"{ours_us:.1f} us", ""),
        ("  by cantools, json.dumps, session.put", f"{others_us:.1f} us", ""),
        ("  ratio", f"{ratio:.1f} x less", "2 x less"),
    ]


class BurstyBus:
    """Frames as a chassis sends them: some every 10 ms, then none for a while."""

    is_up = True
    detail = ""
    losses = 0
    drops = 0

    def __init__(self, frames: list[tuple[int, Frame]]) -> None:
        self._frames = deque(frames)
        self._burst_ns = -1

    @property
    def is_left(self) -> bool:
        return bool(self._frames)

    def receive(self, timeout_s: float) -> Frame | None:
        """The next frame; without a timeout, only if it belongs to the same burst."""
        if not self._frames or (timeout_s == 0 and self._frames[0][0] != self._burst_ns):
            return None
        self._burst_ns, frame = self._frames.popleft()
        return frame

    def send(self, frames: list[Frame]) -> int:
        return len(frames)


def run_ours(frames: list[tuple[int, Frame]], core: Core, node: ZenohNode) -> None:
    """Our path at full speed, burst by burst, as in the loop."""
    gc.disable()
    bus = BurstyBus(frames)
    reader = Reader(LoopPorts(bus, node), core)
    while bus.is_left:
        reader.read_burst(1)
    gc.enable()


def _cost_us(run: Callable[[], None], frames: int) -> float:
    begin_ns = time.process_time_ns()
    for _ in range(PASSES):
        run()
    # Zenoh's own threads may still be sending; their work belongs to this run.
    time.sleep(0.2)
    return (time.process_time_ns() - begin_ns) / 1000 / frames / PASSES

"""The operator's program is killed, stopped, or hangs, as a real process: the robot comes to rest."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise

import pytest
import zenoh

from gateway.can.open_bus import open_bus
from gateway.chassis.cruiser.frames import load
from gateway.client.robot import Robot
from schemas.decisions import ArbiterState, EventKind, SafetyEvent
from schemas.messages import Mode, Variant
from schemas.reasons import Reason
from schemas.settings import CanSettings, Settings, ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night
from tests.support.processes import operator_session as operator_program
from tests.support.processes.busy import burning
from tests.support.processes.gateway import chassis, gateway
from tests.support.processes.guard import COMMANDS, Listener
from tests.support.processes.holding import STARVED, is_done
from tests.support.waiting import DEADLINE_S, wait_until

SILENCE = 100  # frames of feedback, which a chassis sends in 0.2 s


class Scene:
    """A robot that first's program drives, watched by second and on the bus."""

    def __init__(self, stack: ExitStack) -> None:
        self.endpoint = free_endpoint()
        _, address = stack.enter_context(chassis())
        stack.enter_context(gateway(address, self.endpoint))
        self.listener = Listener(open_bus(CanSettings(interface="socketcand", channel=address)))
        stack.callback(self.listener.close)
        settings = Settings(zenoh=ZenohSettings(connect=[self.endpoint]))
        self.second = stack.enter_context(Robot.connect("cruiser-1", "second", settings, 30))
        self.program = subprocess.Popen(
            [sys.executable, "-m", "tests.support.processes.operator_session", self.endpoint, "first"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        stack.callback(self._end_program)
        assert self.program.stdout is not None
        assert self.program.stdout.readline() == "driving\n"
        self.events: list[SafetyEvent] = []

    def has_heard(self, kind: EventKind, *reasons: Reason) -> bool:
        self.events += self.second.events()
        return any(event.kind is kind and event.reason in reasons for event in self.events)

    def wait_at_rest(self) -> None:
        """Wait until the chassis stands, out of auto, and gets no more frames: some may arrive after standby."""
        assert self.second.wait_for(lambda state: state.state is ArbiterState.STANDBY, DEADLINE_S)
        wait_until(lambda: self.listener.stands() and self.listener.mode() is Mode.STOP)
        wait_until(lambda: self.listener.silence > SILENCE)

    def _end_program(self) -> None:
        self.program.kill()
        self.program.wait()
        if self.program.stdout is not None:
            self.program.stdout.close()


@contextmanager
def driven() -> Iterator[Scene]:
    with ExitStack() as stack:
        yield Scene(stack)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP, by_night(operator_program.HANG)])
def test_the_robot_of_an_operator_who_fails_comes_to_rest(number: signal.Signals) -> None:
    """Row 'deadman'. The lease is free after its time, and a stopped program that goes on moves nothing."""
    with driven() as scene:
        scene.program.send_signal(number)
        wait_until(lambda: scene.has_heard(EventKind.STOP, *STARVED))
        scene.wait_at_rest()
        wait_until(lambda: scene.has_heard(EventKind.LEASE, Reason.LEASE_EXPIRED))
        if number == signal.SIGSTOP:
            scene.program.send_signal(signal.SIGCONT)
            # What it goes on with is refused, and its library ends it for that.
            assert scene.program.wait(60) != 0
        bursts = len(scene.listener.bursts)
        with scene.second.lease():
            assert scene.second.state().state.output_speed_mps == 0
        wait_until(scene.listener.stands)
        assert len(scene.listener.bursts) == bursts, "nothing was sent any more"


def tokens(session: zenoh.Session) -> list[str]:
    replies = session.liveliness().get("operators/*", timeout=10)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


def test_a_liveliness_token_is_no_sign_that_anybody_drives() -> None:
    """Design: the token is never the deadman."""
    with driven() as scene:
        session = open_session(ZenohSettings(mode="client"), [scene.endpoint], [])
        try:
            scene.program.send_signal(operator_program.HANG)
            wait_until(lambda: scene.has_heard(EventKind.STOP, *STARVED))
            # A session that was just opened hears of them a little later.
            wait_until(lambda: tokens(session) == [operator_program.token_key("first")])
            scene.wait_at_rest()
        finally:
            close_session(session)


def test_a_machine_that_is_too_busy_drives_or_stops_and_never_jumps() -> None:
    with driven() as scene, burning():
        begun = len(scene.listener.bursts)
        wait_until(lambda: len(scene.listener.bursts) > begun + 200 or scene.has_heard(EventKind.STOP, *STARVED))
        wait_until(lambda: is_done(lambda: scene.second.stop(10)))
        scene.wait_at_rest()
    frames = [frame for burst in scene.listener.bursts for frame in burst.frames]
    for can_id in COMMANDS:
        counters = [frame.data[6] >> 4 for frame in frames if frame.can_id == can_id]
        assert all((after - before) % 16 == 1 for before, after in pairwise(counters)), COMMANDS[can_id]
    drive_id = load(Variant.COARSE).messages["Auto_DriveCmd"].can_id
    speeds_raw = [frame.data[1] for frame in frames if frame.can_id == drive_id]
    # In steps of 0.04 m/s a rise of 0.8 m/s2 is a step in every fifth burst at most.
    assert all(after - before <= 1 for before, after in pairwise(speeds_raw))
    assert max(speeds_raw) == round(operator_program.SPEED_MPS / 0.04)

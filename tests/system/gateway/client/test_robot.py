import os
import socket
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from gateway.client.link import PERIOD_S
from gateway.client.refusal import LeaseLost, Refused, Stopped, Unreachable
from gateway.client.robot import Robot
from schemas.command_line import ExitCode
from schemas.decisions import ArbiterState
from schemas.messages import Mode
from schemas.reasons import TEXTS, Reason, cure_of
from schemas.requests import Light, Role
from schemas.zenoh_session import split_endpoint
from tests.support.fakes.gateway import FakeGateway
from tests.support.fakes.peer import free_endpoint
from tests.support.fakes.robot import FakeRobot, settings_for
from tests.support.messages import STATE
from tests.support.processes.gateway import chassis, gateway
from tests.support.waiting import nothing, wait_until


def test_a_drive_that_is_renewed_moves_the_robot_and_ends_in_standby() -> None:
    with FakeRobot() as fake, fake.engaged() as (robot, lease):
        wait_until(lambda: fake.speed_mps == 0.5, lambda: lease.drive(0.5, angle_deg=5.0))
        assert {one.requested_speed_mps for one in fake.refused("drive")} <= {0.0}, "before engage was received"
        first = fake.accepted("drive")[0].tick
        assert all(one.tick < first for one in fake.refused("drive"))
        assert fake.accepted("drive")[-1].requested_angle_deg == 5.0
        assert repr(lease) == f"<Lease {lease.number} of cruiser-1: engaged>"
        lease.disengage()
        assert robot.state().state.state is ArbiterState.STANDBY
        assert repr(robot) == "<Robot cruiser-1: standby, operator=first>"
        with pytest.raises(Refused) as caught:
            lease.drive(0.5)
        assert caught.value.reason is Reason.NOT_ENGAGED


def test_a_lease_is_renewed_until_the_stream_renews_it() -> None:
    with FakeRobot() as fake, fake.seen_by() as robot, robot.lease() as lease:
        wait_until(lambda: len(fake.accepted("renew")) >= 6)
        lease.check()
        assert fake.accepted("drive") == []
        lease.engage()
        renewed, begun = len(fake.accepted("renew")), len(fake.accepted("drive"))
        wait_until(lambda: len(fake.accepted("drive")) > begun + 120)
        assert fake.state is ArbiterState.ENGAGED
        assert lease.is_engaged
        assert len(fake.accepted("renew")) == renewed


def test_the_end_of_the_block_gives_the_lease_back_and_stops_the_robot() -> None:
    with FakeRobot() as fake, fake.seen_by() as robot:
        with pytest.raises(ZeroDivisionError), robot.lease() as lease:  # noqa: PT012 - what happens is the point
            lease.engage()
            lease.unpark()
            wait_until(lambda: fake.speed_mps > 0.1, lambda: lease.drive(1.0))
            raise ZeroDivisionError
        assert len(fake.accepted("release")) == 1
        assert robot.wait_for(lambda state: state.state is ArbiterState.STANDBY and not state.lease_holder, 20)
        with robot.lease():
            pass


def test_a_stop_ends_the_stream_and_is_told_with_its_reason() -> None:
    with FakeRobot() as fake, fake.engaged() as (robot, lease):
        wait_until(lambda: fake.speed_mps > 0.2, lambda: lease.drive(1.0))
        fake.front_bumper = True
        wait_until(lambda: not lease.is_engaged)
        with pytest.raises(Stopped) as caught:
            lease.drive(1.0)
        assert caught.value.reason is Reason.FRONT_BUMPER
        assert str(caught.value).endswith(cure_of(TEXTS[Reason.FRONT_BUMPER].cure, "cruiser-1"))
        assert "'cruiser reset cruiser-1'" in str(caught.value)
        assert caught.value.code is ExitCode.FAILURE
        assert robot.wait_for(lambda state: state.state is ArbiterState.STANDBY, 20)
        fake.front_bumper = False
        assert lease.reset() == "front_bumper"
        lease.engage()
        lease.check()
        assert fake.speed_mps == 0.0


def test_a_lease_that_is_taken_is_told_to_who_loses_it() -> None:
    with FakeRobot() as fake, fake.engaged() as (_, lease), fake.seen_by("second") as theirs:
        with pytest.raises(Refused) as refusal, theirs.lease():
            pass
        assert refusal.value.reason is Reason.LEASE_HELD
        assert "first" in refusal.value.detail
        with theirs.take(Role.SUPERVISOR):
            wait_until(lambda: not lease.is_engaged)
            for call in (lambda: lease.drive(1.0), lease.check, lease.engage, lease.reset, lambda: lease.number):
                with pytest.raises(LeaseLost) as caught:
                    call()
                assert caught.value.reason is Reason.LEASE_TAKEN
        assert len(fake.accepted("release")) == 1


def test_a_lease_that_was_lost_unseen_is_told_by_its_renewal() -> None:
    """The same operator took it elsewhere: safety/state names no other holder, but renew is refused."""
    with (
        FakeRobot() as fake,
        fake.seen_by() as robot,
        robot.lease() as lease,
        fake.seen_by() as other,
        other.take(),
    ):

        def lost() -> bool:
            try:
                lease.check()
            except LeaseLost as error:
                return error.reason is Reason.LEASE_TAKEN
            return False

        wait_until(lost)


def test_park_may_follow_at_once_when_zero_is_asked_for() -> None:
    with FakeRobot() as fake, fake.engaged() as (_, lease):
        for _ in range(5):
            wait_until(lambda: fake.speed_mps == 0.3, lambda: lease.drive(0.3))
            lease.drive(0.0)
            lease.park()
            lease.unpark()
            wait_until(lambda: fake.speed_mps == 0.0)
        lease.drive(0.3)
        wait_until(lambda: fake.speed_mps > 0.0, lambda: lease.drive(0.3))
        with pytest.raises(Refused) as caught:
            lease.park()
        assert caught.value.reason is Reason.COMMAND_NOT_ZERO


def test_every_verb_of_the_lease_does_its_part() -> None:
    with FakeRobot() as fake, fake.engaged() as (robot, lease):
        lease.light(headlamp=True, left=True)
        lease.horn(on=True)
        lease.horn(on=False)
        lease.park()
        lease.unpark()
        lease.clear_odometer()
        with pytest.raises(Refused) as caught:
            lease.engage()
        assert (caught.value.reason, caught.value.code) == (Reason.ALREADY_ENGAGED, ExitCode.REFUSED)
        with pytest.raises(Refused, match="no_lease"):
            robot.ask(Light(lease=lease.number + 1, headlamp=True))
        assert lease.is_engaged
        counts = {"light": 1, "horn": 2, "park": 1, "unpark": 2, "clear_odometer": 1, "engage": 1}
        assert {verb: len(fake.accepted(verb)) for verb in counts} == counts


def test_what_returns_is_done_and_what_follows_is_taken() -> None:
    with FakeRobot() as fake, fake.engaged() as (robot, lease):
        lease.disengage(wait=False)
        with pytest.raises(Refused, match="stopping"):
            lease.engage(wait=False)
        lease.engage()
        robot.stop(30, wait=False)
        with pytest.raises(Refused, match="stopping"):
            lease.reset(wait=False)
        assert lease.reset() == "remote_stop"
        assert not robot.state().state.latched
        lease.engage()
        robot.stop(30)
        assert fake.state is ArbiterState.STANDBY
        # At standby a stop is over at once, and a moment too young to be reset.
        robot.stop(30)
        fake.flow.arbiter.latches.newest_ns = fake.now_ns
        tick = robot.state().state.tick
        assert robot.wait_for(lambda state: state.tick > tick + 1, 5)
        with pytest.raises(Refused, match=r"latched \d+ ms ago.*Cure: wait 0\.\d s") as caught:
            lease.reset(wait=False)
        assert caught.value.reason is Reason.REMOTE_STOP
        assert lease.reset() == "remote_stop"


def test_what_is_latched_after_a_reset_was_asked_for_is_not_reset() -> None:
    with FakeRobot() as fake, fake.engaged() as (robot, lease):
        robot.stop(30, wait=False)
        latch = threading.Timer(0.1, fake.flow.arbiter.engagement.latch, (Reason.OVERSPEED, "", fake.now_ns))
        latch.start()
        with pytest.raises(Refused, match="not reset: a new latch was set") as caught:
            lease.reset()
        latch.join()
        assert caught.value.reason is Reason.OVERSPEED
        assert fake.latched == {Reason.REMOTE_STOP, Reason.OVERSPEED}


def test_the_remote_stop_needs_no_lease_and_a_takeover_is_told_like_a_stop() -> None:
    with FakeRobot() as fake, fake.engaged() as (_, lease), fake.seen_by("second") as theirs:
        wait_until(lambda: fake.speed_mps > 0.2, lambda: lease.drive(1.0))
        theirs.stop(30)
        assert Reason.REMOTE_STOP in fake.latched
        wait_until(lambda: not lease.is_engaged)
        assert fake.puts.count("stop") > 1
        lease.reset("second")
        lease.engage()
        fake.mode = Mode.REMOTE
        wait_until(lambda: not lease.is_engaged)
        with pytest.raises(Stopped) as caught:
            lease.drive(1.0)
        assert caught.value.reason is Reason.HAND_TRANSMITTER
        with pytest.raises(Refused, match=r"not stopped.*hand_transmitter.*the robot stands"):
            theirs.stop(30)


def test_state_has_an_age_and_an_end() -> None:
    with FakeRobot() as fake, fake.engaged() as (robot, lease):
        assert 0 <= robot.state().age_s <= 1
        assert robot.state().state.lease_holder == "first"
        fake.mute = True

        def is_gone() -> bool:
            try:
                robot.state()
            except Unreachable:
                return True
            return False

        wait_until(is_gone)
        with pytest.raises(Unreachable, match="no state from cruiser-1"):
            lease.drive(1.0)
        # What goes on is not sent blindly: with no newer tick to echo the stream has ceased, and the deadman ran.
        wait_until(lambda: fake.state is ArbiterState.STANDBY)


def test_events_are_heard_those_of_before_too() -> None:
    with FakeRobot() as fake:
        with fake.seen_by() as robot, robot.lease():
            pass
        with fake.seen_by("second") as robot:
            texts: list[str] = []
            wait_until(lambda: len(texts) >= 2, lambda: texts.extend(event.text for event in robot.events()))
            assert texts == ["first has acquired the lease as operator", "first gave the lease back"]
            assert robot.events() == []


def test_a_robot_that_is_not_there_is_unreachable() -> None:
    with FakeRobot() as fake, fake.seen_by() as robot:
        fake.deaf = True
        with pytest.raises(Unreachable, match="did not answer acquire"), robot.lease():
            pass
    endpoint = free_endpoint()
    with pytest.raises(Unreachable, match="no Zenoh node answered"):
        Robot.connect("cruiser-1", "first", settings_for(endpoint), timeout_s=0.2)
    with (
        FakeGateway("cruiser-1") as gateway,
        pytest.raises(Unreachable, match="no state received from robot 'cruiser-1'"),
    ):
        Robot.connect("cruiser-1", "first", settings_for(gateway.listen), timeout_s=2)
    with FakeGateway("cruiser-1") as gateway:

        def tell_its_state() -> bool:
            gateway.say(STATE)
            return False

        settings = settings_for(gateway.listen)
        with pytest.raises(Unreachable, match="only listens"):
            Robot.connect("cruiser-1", "first", settings, timeout_s=3, stopped=tell_its_state)


def test_a_lease_outside_its_block_is_an_error_of_the_program() -> None:
    with FakeRobot() as fake, fake.seen_by() as robot:
        lease = robot.lease()
        with pytest.raises(ValueError, match="within its with statement"):
            lease.drive(1.0)
        with lease, pytest.raises(ValueError, match="has a lease already"), robot.lease():
            pass
        with pytest.raises(ValueError, match="within its with statement"):
            lease.engage()


def test_a_link_that_stalls_ends_in_a_stop_not_in_a_resumption() -> None:
    with FakeRobot() as fake, fake.engaged() as (_, lease):
        wait_until(lambda: fake.speed_mps > 0.2, lambda: lease.drive(1.0, hold_s=2.0))
        fake.mute = True
        wait_until(lambda: fake.state is not ArbiterState.ENGAGED)
        fake.mute = False
        wait_until(lambda: not lease.is_engaged, nothing)
        with pytest.raises(Stopped) as caught:
            lease.drive(1.0)
        assert caught.value.reason is Reason.DEADMAN


def test_commands_arrive_again_after_their_link_alone_broke() -> None:
    """Zenoh does not reconnect to a node of which it learned from another one."""
    endpoint = free_endpoint()
    settings = settings_for(endpoint)
    with (
        chassis() as (_, address),
        gateway(address, endpoint),
        Robot.connect("cruiser-1", "first", settings, timeout_s=20) as robot,
    ):
        ready = {Reason.NO_LEASE, Reason.NOT_ENGAGED}
        assert robot.wait_for(lambda state: set(state.blocked_by) <= ready, 60)
        assert break_connections(split_endpoint(endpoint)[2] + 1)
        wait_until(lambda: acquires(robot))
        robot.stop(20)
        assert Reason.REMOTE_STOP in robot.state().state.latched


def break_connections(port: int) -> int:
    """Shut this process's TCP connections to a port down. Returns how many there were."""
    lines = (line.split() for line in Path("/proc/self/net/tcp").read_text("ascii").splitlines()[1:])
    inodes = {words[9] for words in lines if words[2].endswith(f":{port:04X}")}
    broken = 0
    for descriptor in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):
            if descriptor.readlink().name.removeprefix("socket:").strip("[]") in inodes:
                with socket.socket(fileno=os.dup(int(descriptor.name))) as connection:
                    connection.shutdown(socket.SHUT_RDWR)
                broken += 1
    return broken


def acquires(robot: Robot) -> bool:
    try:
        with robot.lease():
            return True
    except Unreachable:
        return False


def test_the_stream_has_the_rate_of_the_contract() -> None:
    """20 to 50 commands a second."""
    begun_s = time.monotonic()
    with FakeRobot() as fake, fake.engaged() as (_, lease):
        wait_until(lambda: len(fake.accepted("drive")) > 60, lambda: lease.drive(0.1))
        drives = [one for one in list(fake.decisions) if one.request == "drive"]
        elapsed_s = time.monotonic() - begun_s
    assert len(drives) <= elapsed_s / PERIOD_S + 1
    ticks = [one.tick for one in drives]
    assert 100 * (len(ticks) - 1) / (ticks[-1] - ticks[0]) >= 20

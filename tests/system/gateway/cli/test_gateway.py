"""``cruiser gateway`` with a virtual chassis, both as processes."""

import os
import signal
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

import msgpack
import pytest
import zenoh

from gateway.chassis.port import Actuation
from gateway.cli.gateway import run as run_gateway
from gateway.client.refusal import Refused
from gateway.client.robot import Lease, Robot
from gateway.core import Core
from gateway.guard.stopper import GuardView
from gateway.host.guard_process import NoGuard
from gateway.host.notes import StopNote
from gateway.loop import LoopPorts
from schemas.cruiser import dbc_text
from schemas.decisions import EventKind, SafetyEvent
from schemas.messages import GearPosition, Mode, Variant
from schemas.reasons import TEXTS, Reason
from schemas.settings import CanSettings, GatewaySettings, Settings, ZenohSettings
from schemas.subjects import BY_VERB, COMMANDS, SUBJECTS, Pattern
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.nights import by_night
from tests.support.processes.gateway import Running, chassis, gateway, run
from tests.support.processes.guard import listening
from tests.support.processes.holding import is_done
from tests.support.waiting import wait_until


class Listener:
    """Receives everything under ``fleet``, with Zenoh and MessagePack alone."""

    def __init__(self, endpoint: str) -> None:
        self.session = open_session(ZenohSettings(), [endpoint], [])
        self._subscriber = self.session.declare_subscriber("fleet/**", zenoh.handlers.RingChannel(100_000))
        self.latest: dict[str, dict[str, Any]] = {}
        self.heard: list[tuple[str, dict[str, Any]]] = []
        self.encodings: dict[str, str] = {}

    def hear(self) -> None:
        while (sample := self._subscriber.try_recv()) is not None:
            key = str(sample.key_expr)
            self.latest[key] = msgpack.unpackb(sample.payload.to_bytes())
            self.heard.append((key, self.latest[key]))
            self.encodings[key] = str(sample.encoding)

    def wait_for(self, key: str, condition: Callable[[dict[str, Any]], bool] = bool) -> dict[str, Any]:
        """Wait until the newest message of this key meets the condition."""
        wait_until(lambda: key in self.latest and condition(self.latest[key]), self.hear)
        return self.latest[key]

    def info(self, robot: str) -> dict[str, Any]:
        for reply in self.session.get(f"fleet/{robot}/gateway/info", timeout=10):
            assert reply.ok is not None
            payload: dict[str, Any] = msgpack.unpackb(reply.ok.payload.to_bytes())
            return payload
        raise AssertionError("nobody replied")

    def ask(self, verb: str, **fields: object) -> dict[str, Any]:
        key = f"fleet/cruiser-1/@cmd/first/{verb}"
        for reply in self.session.get(key, payload=msgpack.packb(fields), timeout=10):
            assert reply.ok is not None
            answer: dict[str, Any] = msgpack.unpackb(reply.ok.payload.to_bytes())
            return answer
        raise AssertionError("nobody replied")

    def stop(self, robot: str) -> None:
        self.session.put(f"fleet/{robot}/@cmd/first/stop", b"")
        self.hear()

    def count(self, condition: Callable[[str, dict[str, Any]], bool]) -> int:
        return sum(condition(key, message) for key, message in self.heard)

    def close(self) -> None:
        close_session(self.session)


@pytest.mark.parametrize("variant", ["coarse", "fine"])
def test_every_subject_is_published_as_the_table_says(variant: str) -> None:
    """With its encoding; info is answered; the token is there; SIGTERM ends it with 0."""
    endpoint = free_endpoint()
    with chassis("--variant", variant) as (_, address), gateway(address, endpoint, "--robot", "r-1") as running:
        with closing(Listener(endpoint)) as listener:
            of_a_stop = {"fleet/r-1/safety/event", "fleet/r-1/safety/decision"}
            listener.wait_for("fleet/r-1/state", lambda state: state["mode"] == "stop")
            # A put goes nowhere before the sessions have found each other; a late gateway has events of its own.
            wait_until(lambda: of_a_stop <= listener.latest.keys(), lambda: listener.stop("r-1"))
            for subject in SUBJECTS:
                # A robot that stands by is sent nothing, and in open mode nobody proves anything.
                is_due = subject.name != "can/{bus}/tx" and not subject.name.startswith("authority/")
                if subject.pattern is Pattern.PUBLISHED and is_due:
                    key = f"fleet/r-1/{subject.name.format(bus='can0')}"
                    listener.wait_for(key)
                    assert listener.encodings[key] == subject.encoding
            state = listener.wait_for("fleet/r-1/state", lambda state: state["variant"] == variant)
            assert (state["mode"], state["gear_position"], state["bus_up"]) == ("stop", "park", True)
            health = listener.wait_for("fleet/r-1/gateway/health")
            assert sum(row["lost"] for row in health["feedback"]) == 0
            info = listener.info("r-1")
            assert (info["robot"], info["variant"], info["listen_only"]) == ("r-1", variant, False)
            assert info["dbc"] == dbc_text(Variant(variant))
            said = {subject.schema_name for subject in SUBJECTS}
            asked = {name for command in COMMANDS for name in (command.schema_name, command.reply_schema_name)}
            assert info["schemas"].keys() == said | asked
            tokens = [
                str(reply.ok.key_expr)
                for reply in listener.session.liveliness().get("fleet/*/gateway")
                if reply.ok
            ]
            assert tokens == ["fleet/r-1/gateway"]
        assert running.stop() == 0


def test_a_lost_chassis_comes_back() -> None:
    endpoint, address = free_endpoint(), free_endpoint().removeprefix("tcp/")
    with gateway(address, endpoint, "--wait-for-bus") as running, closing(Listener(endpoint)) as listener:
        listener.wait_for("fleet/cruiser-1/state", lambda state: not state["bus_up"])
        with chassis(listen=address) as (sim, _):
            listener.wait_for("fleet/cruiser-1/state", lambda state: state["bus_up"] and not state["silent"])
            sim.stop(signal.SIGKILL)
        state = listener.wait_for("fleet/cruiser-1/state", lambda state: not state["bus_up"])
        running.wait_says("the bus is lost")
        state = listener.wait_for("fleet/cruiser-1/state", lambda state: len(state["silent"]) == 10)
        assert (state["mode"], state["speed_mps"]) == ("undefined", None)
        listener.wait_for(
            "fleet/cruiser-1/gateway/health", lambda health: "Connection refused" in health["bus_detail"]
        )
        with chassis(listen=address):
            listener.wait_for("fleet/cruiser-1/state", lambda state: state["bus_up"] and not state["silent"])
            health = listener.wait_for("fleet/cruiser-1/gateway/health", lambda health: health["bus_up"])
            assert health["bus_losses"] == 1
            assert running.stop(signal.SIGINT) == 0


def test_a_lost_zenoh_node_comes_back() -> None:
    router_endpoint, endpoint = free_endpoint(), free_endpoint()
    router = open_session(ZenohSettings(), [], [router_endpoint])
    with chassis() as (_, address), gateway(address, endpoint, "--connect", router_endpoint) as running:
        wait_until(lambda: bool(router.info.peers_zid()))
        close_session(router)
        listener = Listener(endpoint)
        try:
            listener.wait_for("fleet/cruiser-1/gateway/health", lambda health: health["zenoh_peers"] == 1)
            router = open_session(ZenohSettings(), [], [router_endpoint])
            wait_until(lambda: bool(router.info.peers_zid()))
            subscriber = router.declare_subscriber("fleet/*/state", zenoh.handlers.RingChannel(1))
            wait_until(lambda: subscriber.try_recv() is not None)
        finally:
            listener.close()
            close_session(router)
        assert running.stop() == 0


def test_a_second_gateway_of_one_chassis_is_warned() -> None:
    first, second, third = free_endpoint(), free_endpoint(), free_endpoint()
    shared = "another gateway on this machine commands socketcand"
    with chassis("--variant", "fine") as (_, address), gateway(address, first, "--robot", "r-1") as one:
        with gateway(address, third, "--robot", "r-3", "--listen-only") as listening_only:
            listening_only.stop()
            assert not [line for line in listening_only.said if shared in line]
        with gateway(address, second, "--robot", "r-2") as other:
            other.wait_says(shared)
            # It waits for a chassis that can be engaged.
            drive = ["drive", "r-1", "--speed", "0.2", "--seconds", "2", "--connect", first]
            wait_until(lambda: run(drive).returncode == 0)
            other.wait_says("another computer commands the chassis on the bus")
            other.stop()
        assert not [line for line in one.said if "another" in line]


DECISION = "fleet/cruiser-1/safety/decision"
STATE = "fleet/cruiser-1/safety/state"
SENT = "fleet/cruiser-1/can/can0/tx"


def bad_payloads(lease: int) -> list[bytes]:
    """Payloads of a broken or hostile client: noise, wrong types, no numbers, depth, size."""
    random = Random(1)  # noqa: S311 - the same bytes each time
    drive = {"lease": lease, "seq": 1, "challenge": bytes(8), "speed_mps": 1.0, "angle_deg": 0.0}
    odd: list[object] = [
        None,
        True,
        -1,
        2**64 - 1,
        1e308,
        float("nan"),
        float("inf"),
        -float("inf"),
        "x",
        b"x",
        [],
        {},
    ]
    payloads = [random.randbytes(random.randrange(1, 200)) for _ in range(50)]
    payloads += [msgpack.packb(value) for value in odd]
    payloads += [msgpack.packb(drive | {name: value}) for name in drive for value in odd]
    payloads += [msgpack.packb(drive | {"unknown": 1}), msgpack.packb({1: 2}), msgpack.packb([drive] * 20)]
    payloads += [b"\x91" * 900, b"\x81\xa1a" * 300, b"\xdd\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xc1"]
    return [*payloads, b"\x91" * 10_000_000]


def test_no_bytes_on_any_command_key_change_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each query has a typed refusal, each put is judged or counted; no frame is sent."""
    monkeypatch.setenv("CRUISER_GATEWAY_ACCEPT_UNGUARDED", "true")
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint, "--variant", "coarse") as running:
        with closing(Listener(endpoint)) as listener:
            listener.wait_for(STATE, lambda said: said["blocked_by"] == ["no_lease", "not_engaged"])
            lease = listener.ask("acquire", role="operator")["lease"]
            payloads = bad_payloads(lease)
            # A stop takes any bytes, and the lease must be asked for with none: they have tests of their own.
            for verb in sorted(BY_VERB.keys() - {"stop"}):
                key = f"fleet/cruiser-1/@cmd/stranger/{verb}"
                asked = [listener.session.get(key, payload=payload, timeout=20) for payload in payloads[::7]]
                for receiver in asked:
                    for reply in receiver:
                        assert reply.ok is not None
                        answer = msgpack.unpackb(reply.ok.payload.to_bytes())
                        assert not answer["ok"], (verb, answer)
                        assert answer["reason"] in {reason.value for reason in Reason}
                        assert answer["cure"], answer
                for payload in payloads:
                    listener.session.put(key, payload)
            done = listener.ask("renew", lease=lease)
            assert done["reason"] in {"none", "lease_expired"}, done
            state = listener.wait_for(STATE)
            assert (state["state"], state["latched"]) == ("standby", [])
            listener.wait_for(DECISION)
            assert SENT not in listener.latest
            assert not listener.count(
                lambda key, said: (
                    key == DECISION and said["operator"] == "stranger" and said["verdict"] == "accepted"
                )
            )
        assert running.stop() == 0
        assert not [line for line in running.said if "Traceback" in line or "ERROR" in line]


@contextmanager
def operated(address: str, operator: str = "first") -> Iterator[tuple[Running, Robot]]:
    endpoint = free_endpoint()
    settings = Settings(zenoh=ZenohSettings(connect=[endpoint]))
    with gateway(address, endpoint) as running, Robot.connect("cruiser-1", operator, settings, 30) as robot:
        yield running, robot


def test_a_stop_by_the_guard_is_latched_until_a_reset_whatever_is_restarted() -> None:
    """Row 'the guard has stopped the robot: latched, also across a restart, with its words as an event'."""
    with chassis() as (_, address):
        with operated(address) as (running, robot), robot.lease() as lease:
            wait_until(lambda: lease.is_engaged or is_done(lease.engage))
            running.stop(signal.SIGKILL)
        # The gateway's stderr has ended, and so has its guard, which has it too.
        words = [line for line in running.said if line.startswith("guard: ")]
        # On a busy machine it may have seen no sign of life even before that.
        assert words[0].startswith("guard: the gateway")
        for is_reset in (False, True):
            with operated(address) as (running, robot):
                assert robot.wait_for(lambda state: state.latched == [Reason.GUARD], 30)
                text = guard_latch(robot).text
                assert [one for one in words if one not in text] == []
                if is_reset:
                    with robot.lease() as lease:
                        # One that comes within half a second of the latch was not meant for it.
                        wait_until(partial(is_done, lease.reset))
                assert running.stop() == 0
        with operated(address) as (running, robot):
            assert is_free(robot)
            assert running.stop() == 0


@pytest.mark.parametrize("how", [by_night(signal.SIGTERM), signal.SIGKILL])
def test_a_remote_stop_is_latched_until_a_reset_whatever_is_restarted(how: signal.Signals) -> None:
    with chassis() as (_, address):
        with operated(address) as (running, robot):
            # It is latched, also where the chassis is not seen yet.
            with suppress(Refused):
                robot.stop()
            assert robot.wait_for(lambda state: Reason.REMOTE_STOP in state.latched, 30)
            wait_until(lambda: any(Path(os.environ["XDG_STATE_HOME"]).glob("**/*.latched.json")))
            running.stop(how)
        with operated(address) as (running, robot):
            assert robot.wait_for(lambda state: Reason.REMOTE_STOP in state.latched, 30)
            with robot.lease() as lease:
                wait_until(partial(is_done, lease.reset))
            assert robot.wait_for(lambda state: not state.latched, 30)
            assert running.stop() == 0
        with operated(address) as (running, robot):
            assert is_free(robot)
            assert running.stop() == 0


def guard_latch(robot: Robot) -> SafetyEvent:
    events: list[SafetyEvent] = []

    def latches() -> list[SafetyEvent]:
        return [one for one in events if (one.kind, one.reason) == (EventKind.LATCH, Reason.GUARD)]

    wait_until(lambda: bool(latches()), lambda: events.extend(robot.events()))
    return latches()[0]


def is_free(robot: Robot) -> bool:
    ready = robot.wait_for(lambda state: state.blocked_by == [Reason.NO_LEASE, Reason.NOT_ENGAGED], 30)
    return ready and robot.state().state.latched == []


def drive_on(lease: Lease) -> None:
    """Drive at 1 m/s; engage a robot that a busy machine has stopped, or that never drove."""
    if lease.is_engaged and is_done(partial(lease.drive, 1.0)):
        return
    wait_until(lambda: lease.is_engaged or is_done(lease.engage))
    is_done(lease.unpark)


def test_an_end_while_driving_brings_the_robot_to_rest_first() -> None:
    with (
        chassis() as (_, address),
        listening(address) as listener,
        operated(address) as (running, robot),
        robot.lease() as lease,
    ):
        wait_until(lambda: abs(robot.state().state.output_speed_mps) > 0.6, partial(drive_on, lease))
        assert running.stop() == 0
        wait_until(lambda: listener.stands() and listener.mode() is Mode.STOP)


def test_a_stop_is_on_the_disk_when_it_is_said_to_be_done() -> None:
    """Otherwise a restart right after it would clear the stop while a person walks up to the robot."""
    with chassis() as (_, address), operated(address) as (_, robot), robot.lease() as lease:
        wait_until(lambda: abs(robot.state().state.output_speed_mps) > 0.8, partial(drive_on, lease))
        robot.stop()
        assert any(Path(os.environ["XDG_STATE_HOME"]).glob("**/*.latched.json"))


def test_the_guard_of_a_dead_gateway_is_no_other_computer_to_the_next() -> None:
    with chassis() as (_, address), operated(address) as (running, robot), robot.lease() as lease:
        wait_until(lambda: abs(robot.state().state.output_speed_mps) > 0.8, partial(drive_on, lease))
        running.process.kill()
        with operated(address, "second") as (after, other):
            # On a busy machine the guard may be done before; then its words are with the latch.
            after.wait_says(r"gateway\.loop: .*guard.*: the robot stands")
            assert [one for one in other.events() if one.reason is Reason.OTHER_COMMANDER] == []
            assert not any(TEXTS[Reason.OTHER_COMMANDER].means in line for line in after.said), after.said
            assert after.stop() == 0


def test_a_gateway_says_at_its_start_what_it_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Row 'a gateway without real-time priority says so at start', with limit and cure."""
    monkeypatch.setenv("CRUISER_GATEWAY_REALTIME_PRIORITY", "0")
    monkeypatch.setenv("CRUISER_GATEWAY_STATE_DIR", "")
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint) as running:
        running.wait_says("will not survive a restart: gateway.state_dir is empty")
        running.wait_says(r"no real-time priority.*: 1 m/s \(command.speed_limit_without_realtime_mps\); .*rtprio")
        with closing(Listener(endpoint)) as listener:
            assert not listener.wait_for("fleet/cruiser-1/gateway/health")["realtime"]
        assert running.stop() == 0


@pytest.mark.parametrize("guarded", ["no guard", "a guard"])
def test_a_loop_that_fails_unguarded_stops_the_robot_before_it_ends(
    guarded: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    driving = Actuation(enabled=True, gear=GearPosition.DRIVE, speed_mps=0.6, parking=False)
    link = FakeGuard(is_watching=guarded == "a guard")

    def start_fake_guard(_settings: Settings) -> FakeGuard:
        return link

    def fail(around: LoopPorts, core: Core, _info: object, _stopped: object) -> None:
        assert core.command is not None
        arbiter = core.command.arbiter
        arbiter.output.variant, arbiter.output.actuation = Variant.COARSE, driving

        def drive() -> None:
            assert core.command is not None
            frames = core.command.maker.make(driving, [], Variant.COARSE)
            core.command.maker.sent(frames[: around.bus.send(frames)])

        wait_until(lambda: listener.speed_mps() > 0.5, drive)
        raise RuntimeError("a fault of our own")

    monkeypatch.setattr("gateway.cli.gateway.start_guard", start_fake_guard)
    monkeypatch.setattr("gateway.cli.gateway.run_loop", fail)
    with chassis() as (_, address), listening(address) as listener:
        settings = Settings(
            can=CanSettings(interface="socketcand", channel=address),
            zenoh=ZenohSettings(listen=[free_endpoint()]),
            gateway=GatewaySettings(realtime_priority=0),
        )
        with pytest.raises(RuntimeError, match="of our own"):
            run_gateway(Namespace(seconds=None), settings, lambda: False)
        assert link.is_closed
        if link.is_watching:
            # A chassis that was told to stop never says so again. On a busy machine its feedback may be late.
            wait_until(lambda: listener.speed_mps() > 0.5)
        else:
            wait_until(lambda: listener.stands() and listener.mode() is Mode.STOP)
            assert " gateway: the loop has failed" in StopNote.of(settings).read(), "latched at the next start"


class FakeGuard(NoGuard):
    """A guard that watches or does not."""

    def __init__(self, *, is_watching: bool) -> None:
        super().__init__("" if is_watching else "this test says so")
        self.is_watching = is_watching
        self.is_closed = False

    def look(self) -> GuardView:
        return GuardView(is_watching=self.is_watching)

    def close(self) -> None:
        self.is_closed = True

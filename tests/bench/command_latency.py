"""From a put on Zenoh to the frame on the bus, timed by one process that is operator and witness."""

from __future__ import annotations

import gc
import os
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from random import Random
from typing import Any, Final, NamedTuple

import msgspec
import zenoh

from gateway.can.can_bus import BusLost
from gateway.can.open_bus import open_bus
from gateway.chassis.cruiser.frames import load
from schemas.messages import Variant
from schemas.settings import CanSettings, ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.bench.loads import Row, beside
from tests.bench.processes import empty_loop, quantile, served_chassis, start
from tests.support.fakes.peer import free_endpoint

ROBOT: Final = "fleet/cruiser-1/"
COMMAND: Final = f"{ROBOT}@cmd/bench/"
DEADLINE_S: Final = 20.0
SPEED_MPS: Final = 0.5
SPEED_RAW: Final = 500
ANGLES_DEG: Final = (0.0, 0.4)  # so close that the arbiter changes from one to the other in a tick
MIDDLE_RAW: Final = 2052
_FINE: Final = load(Variant.FINE).messages
STEERING_ID: Final = _FINE["Auto_SteeringCmd"].can_id
DRIVE_ID: Final = _FINE["Auto_DriveCmd"].can_id


class Witness:
    """Another client of the bus, which notes the time of each steering and drive command."""

    def __init__(self, address: str) -> None:
        self._bus = open_bus(CanSettings(interface="socketcand", channel=address))
        self.seen: list[tuple[float, int, int]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._bus.close()

    def first_us(self, put_s: float, can_id: int, holds: Callable[[int], bool]) -> float:
        """Microseconds from a put to the first such command whose raw value ``holds``."""
        place = 0
        end_s = put_s + DEADLINE_S
        while time.monotonic() < end_s:
            for at_s, seen_id, raw in self.seen[place:]:
                place += 1
                if at_s >= put_s and seen_id == can_id and holds(raw):
                    return (at_s - put_s) * 1e6
            time.sleep(0.001)
        raise TimeoutError(f"no such frame within {DEADLINE_S} s")

    def _listen(self) -> None:
        masks = {STEERING_ID: 0xFFF, DRIVE_ID: 0xFFFF}
        while not self._ended.is_set():
            try:
                frame = self._bus.receive(0.1)
            except BusLost:
                return
            if frame is not None and frame.can_id in masks:
                raw = int.from_bytes(frame.data, "little") >> 8 & masks[frame.can_id]
                self.seen.append((time.monotonic(), frame.can_id, raw))


class Driver:
    def __init__(self, endpoint: str) -> None:
        self.session = open_session(ZenohSettings(mode="client"), [endpoint], [])
        self._states = self.session.declare_subscriber(f"{ROBOT}safety/state", zenoh.handlers.RingChannel(1))
        self.state: dict[str, Any] = {}
        self._lease = self._sequence = 0

    def look(self) -> dict[str, Any]:
        sample = self._states.try_recv()
        if sample is not None:
            self.state = msgspec.msgpack.decode(sample.payload.to_bytes())
        return self.state

    def ask(self, verb: str, **fields: object) -> dict[str, Any]:
        payload = msgspec.msgpack.encode(fields)
        attachment = self.prove(verb, payload)
        for reply in self.session.get(COMMAND + verb, payload=payload, attachment=attachment, timeout=5):
            if reply.ok is not None:
                answer: dict[str, Any] = msgspec.msgpack.decode(reply.ok.payload.to_bytes())
                return answer
        raise RuntimeError(f"no reply to {verb}")

    def prove(self, _verb: str, _payload: bytes) -> bytes | None:
        return None

    def take(self) -> int:
        return int(self._must("take", role="supervisor")["lease"])

    def _must(self, verb: str, **fields: object) -> dict[str, Any]:
        reply = self.ask(verb, **fields)
        if not reply["ok"]:
            raise RuntimeError(f"{verb}: {reply}")
        return reply

    def drive(self, speed_mps: float, angle_deg: float = 0.0) -> float:
        """Send a drive command. Returns the time of its put."""
        self._sequence += 1
        fields = {"lease": self._lease, "seq": self._sequence, "challenge": self.look()["challenge"]}
        payload = msgspec.msgpack.encode(fields | {"speed_mps": speed_mps, "angle_deg": angle_deg})
        put_s = time.monotonic()
        attachment = self.prove("drive", payload)
        self.session.put(
            f"{COMMAND}drive",
            payload,
            attachment=attachment,
            express=True,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
        )
        return put_s

    def stop(self) -> float:
        put_s = time.monotonic()
        self.session.put(f"{COMMAND}stop", b"", express=True, priority=zenoh.Priority.INTERACTIVE_HIGH)
        return put_s

    def get_going(self, speed_mps: float = SPEED_MPS) -> None:
        overcome = {"no_lease", "not_engaged", "remote_stop"}
        until(lambda: self.look()["state"] == "standby" and set(self.state["blocked_by"]) <= overcome)
        self._lease, self._sequence = self.take(), 0
        self._must("reset", lease=self._lease)
        self._must("engage", lease=self._lease, challenge=self.look()["challenge"])
        self._must("unpark", lease=self._lease)
        until(lambda: self.look()["output_speed_mps"] == speed_mps, lambda: self.drive(speed_mps), 0.02)

    def close(self) -> None:
        close_session(self.session)


def until(condition: Callable[[], bool], act: Callable[[], object] = bool, pause_s: float = 0.002) -> None:
    end_s = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError
        act()
        time.sleep(pause_s)


class Road(NamedTuple):
    driver: Driver
    witness: Witness
    endpoint: str
    gateway: subprocess.Popen[str]


@contextmanager
def on_the_road(*command: str, driver_at: Callable[[str], Driver] = Driver) -> Iterator[Road]:
    """Chassis, gateway (or this command instead), witness and operator."""
    endpoint = free_endpoint()
    os.environ["CRUISER_GATEWAY_ACCEPT_UNGUARDED"] = "true"
    with ExitStack() as stack:
        address = served_chassis(stack, "--variant", "fine")
        bus = ["--interface", "socketcand", "--channel", address, "--listen", endpoint]
        gateway, _ = start(stack, [*(command or ("-m", "gateway", "gateway")), *bus], "gateway: ")
        witness = Witness(address)
        stack.callback(witness.close)
        driver = driver_at(endpoint)
        stack.callback(driver.close)
        until(lambda: bool(driver.look()))
        yield Road(driver, witness, endpoint, gateway)


def rows(drives: int, stops: int, ticks: int) -> list[Row]:
    """Latency of drive commands and stops beside an empty put; processor time of the flow."""
    random = Random(0)  # noqa: S311 - to hit every place between two ticks
    with on_the_road() as (driver, witness, *_), empty_loop() as empty:
        drive_us = sorted(drives_us(driver, witness, drives, random))
        stop_us = [stop_under_way_us(driver, witness, random)]
        for _ in range(stops - 1):
            driver.get_going()
            stop_us.append(stop_under_way_us(driver, witness, random))
    drive, empty_put, difference = beside(drive_us, empty.put_us, (0.5, 0.99), 0.99)
    stop, _, stop_difference = beside(sorted(stop_us), empty.put_us, (0.5, 0.99), 0.99)
    tick_us = measure_ticks_us(ticks)
    return [
        ("drive put to first CAN frame, p50 p99", f"{drive}, of {len(drive_us)}", ""),
        ("  an empty put meanwhile", empty_put, ""),
        ("  the difference", difference, "under 15 ms"),
        ("remote stop put to first stop frame, p50 p99", f"{stop}, of {len(stop_us)}", ""),
        ("  the difference", stop_difference, ""),
        (
            "arbiter's tick, engaged, CPU, p50 p99",
            f"{quantile(tick_us, 0.5):.0f} {quantile(tick_us, 0.99):.0f} us",
            "",
        ),
    ]


def drives_us(driver: Driver, witness: Witness, count: int, random: Random) -> list[float]:
    """Drive so many times; microseconds from each put but the first to its frame."""
    found: list[float] = []
    driver.get_going()
    for number in range(count):
        left = bool(number % 2)
        put_s = driver.drive(SPEED_MPS, ANGLES_DEG[left])
        if number:
            found.append(witness.first_us(put_s, STEERING_ID, lambda raw, left=left: (raw > MIDDLE_RAW) is left))  # type: ignore[misc]  # bound at once
        time.sleep(random.uniform(0.015, 0.035))
    return found


def stop_under_way_us(driver: Driver, witness: Witness, random: Random) -> float:
    """Stop a moving robot; microseconds until a lower speed is on the bus."""
    driver.drive(SPEED_MPS)
    time.sleep(random.uniform(0.02, 0.04))
    return witness.first_us(driver.stop(), DRIVE_ID, lambda raw: raw < SPEED_RAW)


def measure_ticks_us(count: int) -> list[float]:
    """Processor time of the flow's ``tick`` and ``sent``, in simulated time."""
    from tests.support.rigs.gateway import ready  # noqa: PLC0415 - the rig of the tests

    rig, operator = ready()
    operator.engage()
    command = rig.core.command
    assert command is not None
    spent_us: list[float] = []
    tick, sent = command.tick, command.sent

    def timed_tick(*arguments: Any) -> Any:  # noqa: ANN401 - as the flow's own
        begun_ns = time.thread_time_ns()
        due = tick(*arguments)
        spent_us.append((time.thread_time_ns() - begun_ns) / 1e3)
        return due

    def timed_sent(*arguments: Any) -> Any:  # noqa: ANN401 - as the flow's own
        begun_ns = time.thread_time_ns()
        messages = sent(*arguments)
        spent_us[-1] += (time.thread_time_ns() - begun_ns) / 1e3
        return messages

    # Not by assignment, which would be an error of types.
    vars(command).update(tick=timed_tick, sent=timed_sent)
    # As in the loop, no collection falls into a tick.
    gc.disable()
    for _ in range(count):
        rig.put(operator.name, "drive", operator.drive_payload(1.0, 5.0))
        rig.tick()
    gc.enable()
    return sorted(spent_us)

"""A stand-in for the gateway, to be killed, stopped and hung: it drives the chassis, beats, and starts the guard.

Usage: python -m tests.support.processes.guard_stand_in HOST:PORT SPEED_MPS

Prints what happens, a line each. SIGUSR2: it disables the chassis, then falls silent. SIGTERM: it ends as a
gateway does. Each of its bursts ends with a light frame that switches the lamp on, which the guard never does.
"""

from __future__ import annotations

import signal
import sys
import time
from types import FrameType

from gateway.can.open_bus import ReconnectingBus, open_bus
from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.port import AT_REST, Actuation, AuxiliaryFrame
from gateway.host.guard_process import GuardProcess, start_guard
from schemas.messages import GearPosition, Variant
from schemas.settings import TICK_NS, CanSettings, GatewaySettings, Settings

LAMP = AuxiliaryFrame("Auto_LightCmd", {"Headlamp": True})
ENGAGING_TICKS = 30
RESTING_TICKS = 10


class StandIn:
    def __init__(self, address: str, speed_mps: float) -> None:
        self.settings = Settings(
            can=CanSettings(interface="socketcand", channel=address),
            gateway=GatewaySettings(realtime_priority=0),
        )
        self.driving = Actuation(enabled=True, gear=GearPosition.DRIVE, speed_mps=speed_mps, parking=False)
        self.is_quiet = self.is_resting = self.is_ended = False
        self.late_ns = 0
        for number in (signal.SIGUSR2, signal.SIGTERM):
            signal.signal(number, self._receive)

    def _receive(self, number: int, _frame: FrameType | None) -> None:
        self.is_resting |= number == signal.SIGUSR2
        self.is_ended |= number == signal.SIGTERM

    def run(self) -> None:
        bus = ReconnectingBus(lambda: open_bus(self.settings.can), open_bus(self.settings.can))
        guard = start_guard(self.settings)
        assert isinstance(guard, GuardProcess)
        maker = FrameMaker()
        said: dict[str, object] = {}
        ticks = resting_ticks = 0
        due_ns = time.monotonic_ns()
        told_ns = 0
        while not self.is_ended:
            while (now_ns := time.monotonic_ns()) < due_ns:
                bus.receive((due_ns - now_ns) / 1e9)
            self.late_ns = max(self.late_ns, now_ns - due_ns)
            due_ns += TICK_NS * (1 + (now_ns - due_ns) // TICK_NS)
            ticks = ticks + 1 if ticks or guard.look().is_watching else 0
            self.is_quiet |= guard.look().is_sending
            actuation = None
            if ticks and not self.is_quiet:
                actuation = self.driving if ticks > ENGAGING_TICKS else Actuation(enabled=True)
                if self.is_resting:
                    resting_ticks += 1
                    actuation = AT_REST if resting_ticks < RESTING_TICKS else None
            if actuation is not None:
                frames = maker.make(actuation, [LAMP], Variant.COARSE)
                maker.sent(frames[: bus.send(frames)])
                told_ns = time.monotonic_ns()
            guard.tell(time.monotonic_ns(), Variant.COARSE, actuation, maker.counters, told_ns=told_ns)
            for name, value in (
                ("guard", guard.pid),
                ("watching", guard.look().is_watching),
                ("sending", guard.look().is_sending),
                ("stops", guard.look().stops),
                ("cause", guard.look().says.partition("; ")[0]),
                ("says", guard.look().says),
            ):
                if said.get(name) != value:
                    said[name] = value
                    print(f"{name} {value}", flush=True)  # noqa: T201 - whoever started it reads this
        guard.close()
        bus.close()
        print(f"late_ms {self.late_ns // 1_000_000}", flush=True)  # noqa: T201 - as above


if __name__ == "__main__":
    StandIn(sys.argv[1], float(sys.argv[2])).run()

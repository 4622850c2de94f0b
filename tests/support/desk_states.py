"""A desk of this very process whose robots do and suffer everything at once: for who looks at its page."""

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Final

import msgspec

from gateway.cli.desk_logs import DeskLogs
from gateway.cli.desk_server import Hub, make_app, serve
from gateway.client.fleet import WORDS
from gateway.client.remote_stop import StopReport
from gateway.desk.words import FROM_BROWSER_BYTES
from gateway.telemetry.samples import Arrival
from schemas import keys
from schemas.decisions import ArbiterState, Severity, StopPhase
from schemas.messages import Message, Mode
from schemas.reasons import Reason
from schemas.settings import Settings
from tests.support.fakes.desk import FakeCommandPort, FakeDeskListener
from tests.support.messages import HEALTH, STANDBY, STATE, event, recorder_health
from tests.support.metrics import received

HOST: Final = "127.0.0.1"

TURNS: Final = 10
"""The listener is asked a hundred times a second; robots publish ten times."""

EVENTS: Final = 20
"""So many fill the list of a robot's events, and it scrolls."""

EVENTS_TURN: Final = 50
"""What happened before its robot is known is not kept."""

_READY: Final = msgspec.structs.replace(STANDBY, lease_holder="", blocked_by=[Reason.NO_LEASE, Reason.NOT_ENGAGED])
_ENGAGED: Final = msgspec.structs.replace(
    STANDBY, state=ArbiterState.ENGAGED, engaged=True, link_age_s=0.02, travel_speed_limit_mps=1.5
)
_STANDS: Final = msgspec.structs.replace(STATE, speed_mps=0.0)
_LATCHED: Final = [Reason.FRONT_BUMPER, Reason.REMOTE_STOP]

STATES: Final[dict[str, tuple[Message, ...]]] = {
    "offline": (),
    "needs_reset": (_STANDS, msgspec.structs.replace(_READY, latched=_LATCHED, blocked_by=_LATCHED)),
    "bus_down": (msgspec.structs.replace(STATE, bus_up=False), _READY),
    "stopping": (STATE, msgspec.structs.replace(STANDBY, state=ArbiterState.STOPPING, stop_phase=StopPhase.RAMP)),
    "remote_control": (msgspec.structs.replace(_STANDS, mode=Mode.REMOTE), _READY),
    "blocked": (_STANDS, msgspec.structs.replace(_READY, blocked_by=[Reason.FEEDBACK_MISSING])),
    "driving": (STATE, _ENGAGED),
    "in_control": (_STANDS, _ENGAGED),
    "ready": (_STANDS, _READY),
    "telemetry": (_STANDS,),
}
"""Of each word what such a robot publishes, beside its health. It has the word for its name, with a hyphen."""

assert STATES.keys() == WORDS.keys()


class _EverythingAtOnce(FakeDeskListener):
    """All of these robots, and a recorder; the one that is latched has a past."""

    def __init__(self) -> None:
        super().__init__()
        self._said = [(word.replace("_", "-"), one) for word, said in STATES.items() for one in (*said, HEALTH)]
        self._said.append(("depot", recorder_health()))
        severities = list(Severity)
        happened = [event(one, severity=severities[one % len(severities)]) for one in range(EVENTS)]
        self._happened = [received(one, "needs-reset") for one in happened]
        self._turn = 0

    def drain(self) -> Iterator[Arrival]:
        self._turn += 1
        if self._turn % TURNS == 0:
            # What is said again with an old time is old.
            now_ns = time.time_ns()
            said = ((msgspec.structs.replace(one, time_ns=now_ns), who) for who, one in self._said)
            self.waiting += [received(one, who) for one, who in said]
        if self._turn == EVENTS_TURN:
            self.waiting += self._happened
        yield from super().drain()


def _stop(_settings: Settings, robot: str, _operator: str, _timeout_s: float) -> StopReport:
    """Of one robot the best that can come of a stop, of all of them everything."""
    if robot != keys.ALL:
        return StopReport([robot], {}, {}, [], linked=True)
    blocked, held = {"blocked": "its bus is down"}, {"in-control": "its speed is not seen"}
    return StopReport(["ready"], blocked, held, ["offline"], linked=True)


@contextmanager
def desk_of_all_states(logs: Path) -> Iterator[str]:
    """Serve the desk meanwhile, with these logs. Yields its address."""
    ended = threading.Event()
    with ExitStack() as stack:
        listening = stack.enter_context(socket.create_server((HOST, 0)))
        hub = Hub(
            Settings(),
            _EverythingAtOnce(),  # type: ignore[arg-type]
            FakeCommandPort(),  # type: ignore[arg-type]
            _stop,
            has_logs=True,
        )
        app = make_app(hub, [HOST], stack.enter_context(closing(DeskLogs(logs))))

        async def work() -> None:
            async with asyncio.TaskGroup() as group:
                group.create_task(hub.run(ended.is_set))
                group.create_task(serve(app, listening, ended.is_set, socket_bytes=FROM_BROWSER_BYTES))

        serving = threading.Thread(target=asyncio.run, args=(work(),))
        stack.callback(serving.join)
        stack.callback(ended.set)
        serving.start()
        yield f"http://{HOST}:{listening.getsockname()[1]}/"

"""A subscriber to what a gateway publishes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import zenoh

from gateway.chassis.frame import Frame
from schemas import codec, keys
from schemas.messages import CanFrames, GatewayHealth, RobotState
from schemas.settings import ZenohSettings
from schemas.zenoh_session import close_session, open_session
from tests.support.waiting import wait_until

_ROBOT: Final = "fleet/cruiser-1/"


class Hearing:
    """Received ``state``, ``gateway/health`` and raw frames of ``can/can0/rx``."""

    def __init__(self, session: zenoh.Session, names: tuple[str, ...]) -> None:
        handler = zenoh.handlers.FifoChannel
        self._subscribers = [session.declare_subscriber(_ROBOT + name, handler(100_000)) for name in names]
        self.bus_up: list[bool] = []
        self.healths: list[GatewayHealth] = []
        self.raw: list[Frame] = []

    @property
    def health(self) -> GatewayHealth:
        return self.healths[-1]

    def hear(self) -> None:
        for subscriber in self._subscribers:
            while (sample := subscriber.try_recv()) is not None:
                self._take(str(sample.key_expr), sample.payload.to_bytes())

    def wait(self, condition: Callable[[], bool], act: Callable[[], None] = lambda: None) -> None:
        def hear_and_act() -> None:
            self.hear()
            act()

        wait_until(condition, hear_and_act)

    def wait_healthy(self, condition: Callable[[GatewayHealth], bool]) -> GatewayHealth:
        self.hear()
        begun = len(self.healths)
        self.wait(lambda: any(condition(health) for health in self.healths[begun:]))
        return next(health for health in self.healths[begun:] if condition(health))

    def _take(self, key: str, payload: bytes) -> None:
        parts = keys.parse(key)
        assert parts is not None, key
        match codec.decode(parts.subject, payload):
            case RobotState() as state:
                self.bus_up.append(state.bus_up)
            case GatewayHealth() as health:
                self.healths.append(health)
            case CanFrames() as batch:
                columns = (batch.can_id, batch.data, batch.frame_time_ns, batch.fd_flags)
                self.raw += [Frame(*row) for row in zip(*columns, strict=True)]


@contextmanager
def hearing(endpoint: str, *names: str) -> Iterator[Hearing]:
    session = open_session(ZenohSettings(mode="client"), [endpoint], [])
    try:
        heard = Hearing(session, names)
        heard.wait(lambda: bool(heard.bus_up or heard.healths))
        yield heard
    finally:
        close_session(session)

"""A gateway's voice on Zenoh without a gateway: state, health and token, as the subject table says."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from zenoh import ext

from schemas import codec, keys
from schemas.messages import GatewayHealth, Message
from schemas.settings import ZenohSettings
from schemas.subjects import BY_TYPE
from schemas.zenoh_session import close_session, open_session
from tests.support.fakes.peer import free_endpoint
from tests.support.messages import ROOT


@dataclass
class FakeGateway:
    robot: str
    listen: str = field(default_factory=free_endpoint)
    connect: str = ""
    token: bool = True
    # Zenoh stores its last health for later subscribers, even after the gateway's death.
    caches_health: bool = False

    def __enter__(self) -> Self:
        connect = [self.connect] if self.connect else []
        self._session = open_session(ZenohSettings(), connect, [self.listen])
        if self.token:
            # Zenoh takes a token back when nothing refers to it any more.
            self._token = self._session.liveliness().declare_token(keys.liveliness(ROOT, self.robot))
        if self.caches_health:
            subject = BY_TYPE[GatewayHealth]
            self._health = ext.declare_advanced_publisher(
                self._session,
                keys.build(ROOT, self.robot, subject),
                encoding=subject.encoding,
                cache=ext.CacheConfig(1),
                publisher_detection=True,
            )
        return self

    def __exit__(self, *_: object) -> None:
        close_session(self._session)

    def say(self, message: Message, encoding: str = "") -> None:
        if self.caches_health and isinstance(message, GatewayHealth):
            self._health.put(codec.encode(message))
            return
        subject = BY_TYPE[type(message)]
        key = keys.build(ROOT, self.robot, subject)
        self._session.put(key, codec.encode(message), encoding=encoding or subject.encoding)

    def peers(self) -> list[Any]:
        return list(self._session.info.peers_zid())


def speech(*gateways: FakeGateway, says: Sequence[Message]) -> Callable[[], None]:
    def speak() -> None:
        for one in gateways:
            for message in says:
                one.say(message)

    return speak

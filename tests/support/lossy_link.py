"""Messages on a bad link, in simulated time."""

from collections import deque
from random import Random
from typing import Any

from tests.support.links import LinkProfile


class _Direction:
    """One direction of a link, in order."""

    def __init__(self) -> None:
        self.waiting: deque[tuple[int, Any]] = deque()
        self.last_ns = 0


class LossyLink:
    """Both directions of a link; messages under way keep their delay when ``profile`` changes."""

    def __init__(self, profile: LinkProfile, seed: int) -> None:
        self.is_cut = False
        self.profile = profile
        self._random = Random(seed)  # noqa: S311 - the same link each time
        self._stall_ends_ns = 0
        self._stalls_ns = self._next_stall_ns(0)
        self._up, self._down = _Direction(), _Direction()

    def send_up(self, message: object, now_ns: int) -> None:
        self._send(self._up, message, now_ns)

    def send_down(self, message: object, now_ns: int) -> None:
        self._send(self._down, message, now_ns)

    def receive_up(self, now_ns: int) -> list[Any]:
        return self._receive(self._up, now_ns)

    def receive_down(self, now_ns: int) -> list[Any]:
        return self._receive(self._down, now_ns)

    def _send(self, direction: _Direction, message: object, now_ns: int) -> None:
        delay_s = self.profile.delay_s(self._random)
        direction.last_ns = max(direction.last_ns, now_ns + round(delay_s * 1e9))
        direction.waiting.append((direction.last_ns, message))

    def _receive(self, direction: _Direction, now_ns: int) -> list[Any]:
        if now_ns >= self._stalls_ns:
            self._stall_ends_ns = self._stalls_ns + round(self.profile.stall_s * 1e9)
            self._stalls_ns = self._next_stall_ns(self._stall_ends_ns)
        if self.is_cut or now_ns < self._stall_ends_ns:
            return []
        arrived = []
        while direction.waiting and direction.waiting[0][0] <= now_ns:
            arrived.append(direction.waiting.popleft()[1])
        return arrived

    def _next_stall_ns(self, from_ns: int) -> int:
        every_s = self.profile.stall_every_s
        return from_ns + round(self._random.expovariate(1 / every_s) * 1e9) if every_s else 2**63

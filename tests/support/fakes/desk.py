"""What the desk stands between: Zenoh's samples, and a session for commands."""

from collections.abc import Iterator

from gateway.telemetry.samples import Arrival, Received
from gateway.zenoh.client import PendingQuery


class FakeDeskListener:
    def __init__(self) -> None:
        self.waiting: list[Arrival] = []
        self.linked = True

    def drain(self) -> Iterator[Arrival]:
        waiting, self.waiting = self.waiting, []
        yield from waiting

    def connected(self) -> bool:
        return self.linked


class FakeCommandPort:
    """Stores what goes out, and gives the replies that a test sets."""

    def __init__(self) -> None:
        self.puts: list[tuple[str, str, bytes, bytes]] = []
        self.questions: list[tuple[str, str, bytes, bytes]] = []
        self.replies: list[Received] = []
        self.is_over = True

    def put_signed(self, key: str, verb: str, payload: bytes, attachment: bytes) -> None:
        self.puts.append((key, verb, payload, attachment))

    def query(
        self, key: str, question: PendingQuery, payload: bytes, encoding: str, attachment: bytes, timeout_s: float
    ) -> None:
        assert timeout_s > 0
        self.questions.append((key, encoding, payload, attachment))
        question.poll = lambda: [self.replies.pop(0)] if self.replies else []  # type: ignore[method-assign]
        question.is_over = self.is_over

"""A replay's surroundings: a clock and an outlet that do what a test says."""

from recorder.replay import Halt, ReplayClock, ReplaySample
from schemas.command_line import ExitCode
from tests.support.messages import SECOND, WALL_NS

HALT = Halt("it is over", ExitCode.UNREACHABLE)


class FakeClock(ReplayClock):
    """Time passes while somebody waits, and while the outlet works."""

    def __init__(self) -> None:
        self.now_ns = 77 * SECOND
        self.slept: list[int] = []

    def monotonic_ns(self) -> int:
        return self.now_ns

    def wall_ns(self) -> int:
        return self.now_ns + 2 * WALL_NS

    def sleep(self, duration_ns: int) -> None:
        assert duration_ns > 0, "waits for nothing"
        self.slept.append(duration_ns)
        self.now_ns += duration_ns


class FakeOutlet:
    """Takes what is sent, with the time and the shift; refuses, and takes its time, on demand."""

    def __init__(self, clock: FakeClock) -> None:
        self._clock = clock
        self.sent = self.failed = 0
        self.got: list[tuple[int, ReplaySample, int]] = []
        self.takes_ns = 0
        """How long a send takes."""
        self.halts_at_ns: int | None = None
        """When it cannot go on any more."""
        self.attended: list[int] = []

    def send(self, item: ReplaySample, shift_ns: int) -> None:
        self.got.append((self._clock.now_ns, item, shift_ns))
        self._clock.now_ns += self.takes_ns
        self.sent += 1

    def attend(self) -> Halt | None:
        self.attended.append(self._clock.now_ns)
        if self.halts_at_ns is not None and self._clock.now_ns >= self.halts_at_ns:
            return HALT
        return None

    def close(self) -> None:
        """Nothing to give back."""

"""One feedback frame's stream."""

from collections import Counter
from collections.abc import Iterable

from gateway.chassis.cruiser.frames import load
from gateway.chassis.frame import FaultKind
from gateway.chassis.supervision import silence_ns
from gateway.choice import CHASSIS
from gateway.telemetry.feedback import FeedbackStream
from schemas.messages import Variant
from schemas.settings import PERIOD_WINDOW_FRAMES
from tests.support.frames import MS, Feedback

GEAR = "Auto_GearFeedBack"
PERIOD_NS = 10 * MS


class Gears:
    """A stream of gear frames, and what it counts."""

    def __init__(self) -> None:
        self.faults: Counter[FaultKind] = Counter()
        self.stream = FeedbackStream(CHASSIS.decoder(load(Variant.COARSE).messages[GEAR]), self.faults)
        self._feedback = Feedback(Variant.COARSE)

    def receive(self, times_ns: Iterable[int]) -> None:
        for now_ns in times_ns:
            assert self.stream.receive(self._feedback.frame(GEAR), now_ns) is not None

    def failures(self, now_ns: int) -> list[str]:
        """What health says has failed."""
        return self.stream.health(1.0, now_ns).failures


def test_a_silence_is_no_fault_of_the_period() -> None:
    """The time without frames is told as silence; the frames after it have their own period."""
    gears = Gears()
    gears.receive(range(0, 10 * PERIOD_NS, PERIOD_NS))
    gears.stream.tick(10**9)
    gears.receive(range(10**9, 10**9 + 3 * PERIOD_WINDOW_FRAMES * PERIOD_NS, PERIOD_NS))
    assert gears.faults == {FaultKind.SILENCE: 1}


def test_a_period_that_had_failed_is_forgotten_in_a_silence() -> None:
    """Who is silent has no period at all; only the silence is a failure then."""
    gears = Gears()
    gears.receive(range(0, (PERIOD_WINDOW_FRAMES + 1) * PERIOD_NS // 2, PERIOD_NS // 2))
    end_ns = PERIOD_WINDOW_FRAMES * PERIOD_NS // 2
    assert gears.failures(end_ns) == ["period"]
    silent_ns = end_ns + silence_ns(PERIOD_NS) + 1
    gears.stream.tick(silent_ns)
    assert gears.failures(silent_ns) == ["silence"]


def test_a_stream_that_falls_silent_has_no_latest_message() -> None:
    """What was said last is no value any more."""
    gears = Gears()
    gears.receive([0])
    assert gears.stream.latest is not None
    gears.stream.tick(silence_ns(PERIOD_NS))
    assert gears.stream.latest is not None
    gears.stream.tick(silence_ns(PERIOD_NS) + 1)
    assert gears.stream.latest is None

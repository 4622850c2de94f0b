"""Playing a log against a clock that only moves when somebody waits."""

from collections.abc import Iterator

from recorder.replay import ATTEND_NS, FOR_EVER, Halt, Pace, ReplaySample, ReplayScheduler, play
from tests.support.fakes.replay import HALT, FakeClock, FakeOutlet
from tests.support.messages import MS, SECOND, WALL_NS


class Rig:
    """A log of so many seconds with a mark every 0.1 s, a clock and an outlet."""

    def __init__(self, length_s: float = 1, speed: float = 1, loops: int = 1) -> None:
        self.clock = FakeClock()
        self.begun_ns = self.clock.now_ns
        self.outlet = FakeOutlet(self.clock)
        self.count = round(length_s * 10)
        self.reading_ns = 0
        """How long it takes to find the beginning."""
        self.player = ReplayScheduler(self._read, Pace(speed, 10**18), loops)
        self.stops_at_ns = 10**18

    def _read(self) -> Iterator[ReplaySample]:
        self.clock.now_ns += self.reading_ns
        return (ReplaySample(WALL_NS + number * 100 * MS, "", "") for number in range(self.count))

    def play(self, *, is_now: bool = False) -> Halt | None:
        def stopped() -> bool:
            return self.clock.now_ns >= self.stops_at_ns

        return play(self.player, self.outlet, self.clock, stopped, is_now=is_now)

    @property
    def sent(self) -> list[tuple[int, int]]:
        """When, and what, in ms since the beginning."""
        return [
            ((at_ns - self.begun_ns) // MS, (item.time_ns - WALL_NS) // MS) for at_ns, item, _ in self.outlet.got
        ]


def test_each_is_sent_when_it_is_due() -> None:
    """To the moment, at any speed; in between the outlet is looked after."""
    rig = Rig(speed=2)
    assert rig.play() is None
    assert rig.sent == [(50 * number, 100 * number) for number in range(10)]
    assert max(b - a for a, b in zip(rig.outlet.attended, rig.outlet.attended[1:], strict=False)) <= ATTEND_NS


def test_a_slow_outlet_adds_no_drift() -> None:
    """What takes 30 ms of every 100 is made up for in the waiting; the next is on time."""
    rig = Rig(length_s=60)
    rig.outlet.takes_ns = 30 * MS
    rig.play()
    assert rig.sent[-1] == (59_900, 59_900)
    assert rig.player.lateness.max_ns == 0


def test_the_outlet_is_looked_after_when_there_is_no_time_to_wait() -> None:
    """As fast as possible, and slower than that: a gateway that turns up is seen all the same."""
    rig = Rig(length_s=1000, speed=0)
    rig.outlet.takes_ns = MS
    rig.outlet.halts_at_ns = rig.begun_ns + SECOND
    assert rig.play() == HALT
    assert len(rig.outlet.got) <= 1000 + ATTEND_NS // MS
    assert rig.clock.slept == []


def test_what_ends_it_is_told_and_nothing_is_sent_any_more() -> None:
    """From the first look on."""
    rig = Rig()
    rig.outlet.halts_at_ns = 0
    assert rig.play() == HALT
    assert rig.outlet.got == []


def test_what_went_wrong_with_the_last_one_is_told() -> None:
    """Between the last look and the end."""
    rig = Rig(length_s=0.1)
    rig.outlet.takes_ns = 1
    rig.outlet.halts_at_ns = rig.begun_ns + 1
    assert rig.play() == HALT


def test_it_can_be_stopped() -> None:
    """Also one that would go on for ever."""
    rig = Rig(loops=FOR_EVER)
    rig.stops_at_ns = rig.begun_ns + 5 * SECOND + 1
    assert rig.play() is None
    assert not rig.player.is_ended
    assert len(rig.sent) > 50


def test_the_present_is_that_of_sending() -> None:
    """Whatever the speed: what is due now gets the time of now, and nothing else is moved."""
    for speed in (1.0, 4.0, 0.0):
        rig = Rig(speed=speed)
        rig.outlet.takes_ns = MS
        rig.play(is_now=True)
        for at_ns, item, shift_ns in rig.outlet.got:
            assert item.time_ns + shift_ns == at_ns + 2 * WALL_NS
    rig = Rig()
    rig.play()
    assert {shift_ns for _, _, shift_ns in rig.outlet.got} == {0}


def test_finding_the_beginning_makes_nothing_late() -> None:
    """However long it takes."""
    rig = Rig(length_s=30)
    rig.reading_ns = 500 * MS
    rig.play()
    assert rig.player.lateness.max_ns == 0
    assert rig.sent[0] == (500, 0)

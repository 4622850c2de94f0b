"""Row 'command age, by echo': the arbiter knows when it published the tick that a command carries."""

from gateway.command.freshness import REMEMBERED_NS, TickLog
from schemas.reasons import Reason


def test_the_age_is_the_time_since_the_tick_went_out() -> None:
    """Whenever the sender saw it, and whatever its clock says."""
    log = TickLog()
    log.publish(7, 1_000)
    log.publish(12, 5_000)
    assert log.age_ns(7, 6_000) == 5_000
    assert log.age_ns(12, 6_000) == 1_000


def test_a_tick_that_was_not_published_tells_no_age() -> None:
    """Those between, those to come, and those of another run."""
    log = TickLog()
    log.publish(7, 0)
    log.publish(12, 0)
    for tick in (6, 8, 13, 0, -1):
        assert log.age_ns(tick, 0) is Reason.TICK_UNKNOWN


def test_old_ticks_are_forgotten() -> None:
    """At the limit it is still known, beyond it is not, and the log does not grow."""
    log = TickLog()
    log.publish(1, 0)
    log.publish(2, REMEMBERED_NS)
    assert log.age_ns(1, REMEMBERED_NS) == REMEMBERED_NS
    log.publish(3, REMEMBERED_NS + 1)
    assert log.age_ns(1, REMEMBERED_NS) is Reason.TICK_UNKNOWN
    for tick in range(4, 2_000):
        log.publish(tick, REMEMBERED_NS + tick * 10_000_000)
    assert len(log._times_ns) == len(log._published) == 401

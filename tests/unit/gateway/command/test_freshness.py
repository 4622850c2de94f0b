"""Row 'command age, by echo': the arbiter knows when it published the challenge that a command carries."""

from gateway.command.lease import REMEMBERED_NS, ChallengeLog
from schemas.reasons import Reason


def test_the_age_is_the_time_since_the_challenge_was_published() -> None:
    """Whenever the sender saw it, and whatever its clock says."""
    log = ChallengeLog()
    log.publish(b"seven...", 1_000)
    log.publish(b"twelve..", 5_000)
    assert log.age_ns(b"seven...", 6_000) == 5_000
    assert log.age_ns(b"twelve..", 6_000) == 1_000


def test_a_challenge_that_was_not_published_tells_no_age() -> None:
    """Neither one like it, nor none, nor one of another run."""
    log = ChallengeLog()
    log.publish(b"seven...", 0)
    for challenge in (b"seven..,", b"seven..", b"", bytes(8)):
        assert log.age_ns(challenge, 0) is Reason.CHALLENGE_UNKNOWN


def test_old_challenges_are_forgotten() -> None:
    """At the limit one is still known, beyond it is not, and the log does not grow."""
    log = ChallengeLog()
    log.publish(b"first...", 0)
    log.publish(b"second..", REMEMBERED_NS)
    assert log.age_ns(b"first...", REMEMBERED_NS) == REMEMBERED_NS
    log.publish(b"third...", REMEMBERED_NS + 1)
    assert log.age_ns(b"first...", REMEMBERED_NS) is Reason.CHALLENGE_UNKNOWN
    for number in range(4, 2_000):
        log.publish(number.to_bytes(8), REMEMBERED_NS + number * 10_000_000)
    assert len(log._times_ns) == len(log._published) == 401


def test_a_challenge_that_is_published_twice_is_as_old_as_the_last_time() -> None:
    """Chance does not draw one twice, a log that somebody wrote may hold it."""
    log = ChallengeLog()
    for now_ns in range(0, 3 * REMEMBERED_NS, REMEMBERED_NS // 2):
        log.publish(b"again...", now_ns)
        assert log.age_ns(b"again...", now_ns + 5) in {5, Reason.CHALLENGE_UNKNOWN}

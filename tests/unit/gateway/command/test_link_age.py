"""Row 'travel delay': the age of the commands, and the speed that it allows."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.command.lease import KEPT, MEAN_NS, QUANTILES_NS, Ages, LinkAge
from gateway.command.motion import Target
from schemas.reasons import Reason
from schemas.settings import DEADMAN_MAX_S, CommandSettings

MS = 1_000_000
SETTINGS = CommandSettings()


def link_of(ages_ms: list[int], every_ms: int = 20) -> tuple[LinkAge, int]:
    """A link whose commands were so old, and the time of the last one."""
    link, now_ns = LinkAge(SETTINGS), 0
    for number, age_ms in enumerate(ages_ms):
        now_ns += every_ms * MS
        link.accept(number, age_ms * MS, now_ns)
    return link, now_ns


def test_before_the_first_command_nothing_is_known() -> None:
    """And nothing is bounded: without a command there is no speed to bound."""
    link = LinkAge(SETTINGS)
    assert (link.ages(0), link.speed_limit_mps(0), link.delay_s(0), link.accepted_seq) == (
        Ages(),
        None,
        None,
        None,
    )
    assert link.bounded(Target(9.0), 2.0, 0) == Target(9.0)


def test_the_age_is_the_mean_of_the_last_second() -> None:
    """What was accepted before that counts no more, and what is left of it when nothing follows."""
    link, now_ns = link_of([900] * 60 + [300] * 25 + [100] * 25)
    assert link.ages(now_ns).age_s == pytest.approx((100 * 25 + 300 * 25 + 900) / 51 / 1e3)
    later_ns = now_ns + MEAN_NS
    assert link.ages(later_ns).age_s == 0.1
    assert link.ages(later_ns + 1).age_s is None
    assert link.accepted_seq == 109


def test_a_link_that_has_just_become_slow_bounds_the_speed_at_once() -> None:
    """The largest of the last 300 ms, where the mean of the second is the lower one."""
    link, now_ns = link_of([100] * 50 + [900] + [100] * 15)
    assert link.ages(now_ns).age_s == 0.9
    link.accept(66, 100 * MS, now_ns + 20 * MS)
    assert link.ages(now_ns + 20 * MS).age_s == pytest.approx((100 * 50 + 900) / 51 / 1e3)


def test_the_delay_of_the_pictures_is_age_too() -> None:
    """The setting ``command.view_delay_s``, of which the gateway sees nothing by itself."""
    link = LinkAge(CommandSettings(view_delay_s=0.5))
    link.accept(1, 200 * MS, 0)
    assert link.ages(0).age_s == 0.7
    assert link.delay_s(0) == 1.0
    assert link.speed_limit_mps(0) == pytest.approx(1.0)


def test_the_quantiles_are_of_the_last_ten_seconds() -> None:
    """The median, the 99th percentile, and the last one."""
    link, now_ns = link_of([*range(100)])
    ages = link.ages(now_ns)
    assert (ages.last_s, ages.p50_s, ages.p99_s) == (0.099, 0.049, 0.098)
    assert link.ages(now_ns + QUANTILES_NS).p50_s == 0.099
    assert link.ages(now_ns + QUANTILES_NS + 1) == Ages()


def test_no_flood_of_commands_is_remembered() -> None:
    """So many at most."""
    link, now_ns = link_of([5] * 3 + [7] * KEPT, every_ms=1)
    assert link.ages(now_ns).p50_s == 0.007
    assert len(link._ages) == KEPT


@pytest.mark.parametrize(
    ("age_ms", "deadman_s", "speed_mps"), [(200, None, 2.0), (30, None, 1 / 0.33), (450, 1.0, 1 / 1.45)]
)
def test_the_speed_is_bounded_by_age_and_deadman(age_ms: int, deadman_s: float | None, speed_mps: float) -> None:
    """V <= travel_delay_m / (age + deadman), either way, and the steering is left as it is asked."""
    link = LinkAge(SETTINGS)
    link.begin(deadman_s)
    link.accept(1, age_ms * MS, 0)
    assert link.speed_limit_mps(0) == pytest.approx(speed_mps)
    for sign in (1, -1):
        assert link.bounded(Target(sign * 5.0, 7.0), 6.0, 0) == Target(sign * (link.speed_limit_mps(0) or 0), 7.0)
        below = Target(sign * 0.99 * speed_mps, 7.0)
        assert link.bounded(below, 6.0, 0) is below
        beyond = Target(sign * 5.0)
        assert link.bounded(beyond, 0.99 * speed_mps, 0) is beyond, "another limit is the lower one"


@given(
    ages_ms=st.lists(st.integers(0, 1000), min_size=1, max_size=200), deadman_s=st.none() | st.floats(0.05, 1.0)
)
def test_no_target_is_faster_than_the_travel_delay_allows(ages_ms: list[int], deadman_s: float | None) -> None:
    """Whatever the ages: the way over the age and the deadman is the setting at most."""
    link, now_ns = link_of(ages_ms)
    link.begin(deadman_s)
    delay_s = link.delay_s(now_ns)
    assert delay_s is not None
    mean_ms = sum(ages_ms[-51:]) / len(ages_ms[-51:])
    assert delay_s == pytest.approx(max(mean_ms, *ages_ms[-16:]) / 1e3 + link.deadman_ns / 1e9)
    assert link.bounded(Target(5.0), 5.0, now_ns).speed_mps * delay_s <= SETTINGS.travel_delay_m + 1e-9


@pytest.mark.parametrize(
    ("asked_s", "deadman_s"), [(None, 0.3), (0.05, 0.3), (0.3, 0.3), (0.8, 0.8), (1.0, DEADMAN_MAX_S)]
)
def test_an_engagement_may_ask_for_a_longer_deadman_and_for_no_shorter_one(
    asked_s: float | None, deadman_s: float
) -> None:
    """Row 'deadman': up to 1 s; the next engagement begins with the configured one again."""
    link = LinkAge(SETTINGS)
    link.begin(asked_s)
    assert link.deadman_ns == deadman_s * 1e9
    link.begin(None)
    assert link.deadman_ns == 300 * MS


def test_the_silence_tells_what_was_refused_in_it() -> None:
    """How many commands, why and how old the last one was; what an accepted one came after counts no more."""
    link = LinkAge(SETTINGS)
    assert link.silence(310 * MS) == "none for 310 ms"
    link.refuse(Reason.TOO_OLD, 900 * MS)
    assert link.silence(310 * MS) == "none for 310 ms; 1 command refused as too old, 900 ms"
    link.refuse(Reason.TOO_OLD, 470 * MS)
    link.refuse(Reason.NOT_ENGAGED, 10 * MS)
    link.refuse(Reason.CHALLENGE_UNKNOWN, None)
    assert link.silence(310 * MS) == (
        "none for 310 ms; 2 commands refused as too old, 470 ms; 1 command refused as echoing an unknown challenge"
    )
    link.accept(1, 10 * MS, 0)
    assert link.silence(20 * MS) == "none for 20 ms"

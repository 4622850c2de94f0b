"""The lease, the age of its holder's commands, and the speed that this age allows."""

from itertools import product
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.command.lease import (
    KEPT,
    MEAN_NS,
    QUANTILES_NS,
    REMEMBERED_NS,
    Ages,
    ChallengeLog,
    HeldLease,
    Leases,
    LinkAge,
)
from gateway.command.motion import Target
from schemas.reasons import Reason
from schemas.requests import LEASE_MAX, Role
from schemas.settings import DEADMAN_MAX_S, CommandSettings

MS = 1_000_000
S = 1_000_000_000
SETTINGS = CommandSettings()


def leases(seed: int = 1) -> Leases:
    return Leases(2 * S, Random(seed))  # noqa: S311 - as in the arbiter: it keeps no secret


def given_to(made: Leases, operator: str, role: Role = Role.OPERATOR, now_ns: int = 0) -> HeldLease:
    lease = made.acquire(operator, role, now_ns)
    assert isinstance(lease, HeldLease)
    return lease


def test_one_at_a_time_until_it_expires() -> None:
    """Row 'lease: exclusive, renewed by drive or renew, expires: 2 s'. Number and operator both have to fit."""
    made = leases()
    made.renew(0)
    made.end(Reason.LEASE_RELEASED)
    assert (made.held, made.refusal(0, "first")) == (None, Reason.NO_LEASE)
    lease = given_to(made, "first")
    assert made.acquire("second", Role.SUPERVISOR, 0) is Reason.LEASE_HELD
    assert made.acquire("first", Role.OPERATOR, 0) is Reason.LEASE_HELD
    assert made.held == lease
    assert made.refusal(lease.id, "first") is None
    assert made.refusal(lease.id, "second") is made.refusal(lease.id + 1, "first") is Reason.NO_LEASE
    made.renew(S)
    assert made.expire(3 * S - 1) is None
    lost = made.expire(3 * S)
    assert lost is not None
    assert lost.operator == "first"
    assert made.held is None
    assert made.expire(4 * S) is None
    assert made.refusal(lost.id, "first") is Reason.LEASE_EXPIRED


@pytest.mark.parametrize(("holder", "taker"), [*product(Role, Role)])
def test_a_higher_or_equal_role_takes_it(holder: Role, taker: Role) -> None:
    """Row 'take needs a higher or equal role', for every pair of roles."""
    made = leases()
    old = given_to(made, "first", holder)
    taken = made.take("second", taker, S)
    if taker.rank < holder.rank:
        assert (taken, made.held) == (Reason.ROLE_TOO_LOW, old)
    else:
        assert isinstance(taken, HeldLease)
        assert (taken.operator, taken.role, taken.expires_ns) == ("second", taker, 3 * S)
        assert made.refusal(old.id, "first") is Reason.LEASE_TAKEN


def test_sixteen_ended_leases_are_remembered() -> None:
    """Their former holders learn the cause; older ones are unknown."""
    made = leases()
    numbers = []
    for _ in range(17):
        numbers.append(given_to(made, "first").id)
        made.end(Reason.LEASE_RELEASED)
    assert made.refusal(numbers[0], "first") is Reason.NO_LEASE
    assert [made.refusal(number, "first") for number in numbers[1:]] == [Reason.LEASE_RELEASED] * 16


@given(run=st.integers(0, 2**64), other=st.integers(0, 2**64))
def test_numbers_of_one_run_do_not_fit_another(run: int, other: int) -> None:
    """And every language can represent them exactly."""
    number = given_to(leases(run), "first").id
    assert 0 < number <= LEASE_MAX
    assert (number == given_to(leases(other), "first").id) is (run == other)


# The age of a command, by the challenge that it echoes.


def test_the_age_is_the_time_since_the_challenge_was_published() -> None:
    """Whenever the sender saw it. One like it, none, or another run's tells no age; old ones are forgotten."""
    log = ChallengeLog()
    log.publish(b"first...", 0)
    log.publish(b"second..", REMEMBERED_NS)
    for echoed, age_ns in (
        (b"first...", REMEMBERED_NS),
        (b"second..", 0),
        *((one, Reason.CHALLENGE_UNKNOWN) for one in (b"first..,", b"first..", b"", bytes(8))),
    ):
        assert log.age_ns(echoed, REMEMBERED_NS) == age_ns
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


# The link.


def link_of(ages_ms: list[int], every_ms: int = 20, **settings: float) -> tuple[LinkAge, int]:
    """A link whose commands were so old, and the time of the last one."""
    link, now_ns = LinkAge(CommandSettings(**settings)), 0
    for number, age_ms in enumerate(ages_ms):
        now_ns += every_ms * MS
        link.accept(number, age_ms * MS, now_ns)
    return link, now_ns


FAR_AGO = (100 * 25 + 300 * 25 + 900) / 51 / 1e3


@pytest.mark.parametrize(
    ("ages_ms", "later_ns", "ages"),
    [
        # Without a command nothing is known. The mean of the last second, or what is left of it.
        ([], 0, Ages()),
        ([900] * 60 + [300] * 25 + [100] * 25, 0, Ages(FAR_AGO, 0.1, 0.9, 0.9)),
        ([900] * 60 + [300] * 25 + [100] * 25, MEAN_NS, Ages(0.1, 0.1, 0.9, 0.9)),
        ([900] * 60 + [300] * 25 + [100] * 25, MEAN_NS + 1, Ages(None, 0.1, 0.9, 0.9)),
        # The largest of the last 300 ms, where that is greater: a link that has just become slow is slow.
        ([100] * 50 + [900] + [100] * 15, 0, Ages(0.9, 0.1, 0.1, 0.1)),
        ([100] * 50 + [900] + [100] * 16, 0, Ages((100 * 50 + 900) / 51 / 1e3, 0.1, 0.1, 0.1)),
        # The median and the 99th percentile of the last ten seconds.
        ([*range(100)], 0, Ages(0.099, 0.099, 0.049, 0.098)),
        ([*range(100)], QUANTILES_NS, Ages(None, 0.099, 0.099, 0.099)),
        ([*range(100)], QUANTILES_NS + 1, Ages()),
    ],
)
def test_how_old_the_commands_are(ages_ms: list[int], later_ns: int, ages: Ages) -> None:
    link, now_ns = link_of(ages_ms)
    found = link.ages(now_ns + later_ns)
    for name in Ages.__struct_fields__:
        value = getattr(ages, name)
        assert getattr(found, name) == (None if value is None else pytest.approx(value)), name
    assert link.accepted_seq == (len(ages_ms) - 1 if ages_ms else None)


def test_no_flood_of_commands_is_remembered() -> None:
    link, now_ns = link_of([5] * 3 + [7] * KEPT, every_ms=1)
    assert link.ages(now_ns).p50_s == 0.007
    assert len(link._ages) == KEPT


@pytest.mark.parametrize(
    ("age_ms", "view_delay_s", "deadman_s", "speed_mps"),
    [
        (200, 0.0, None, 2.0),
        (30, 0.0, None, 1 / 0.33),
        (450, 0.0, 1.0, 1 / 1.45),
        # The camera's delay, which the gateway cannot measure, is age too.
        (200, 0.5, None, 1.0),
    ],
)
def test_the_speed_is_bounded_by_age_and_deadman(
    age_ms: int, view_delay_s: float, deadman_s: float | None, speed_mps: float
) -> None:
    """Row 'travel delay': V <= travel_delay_m / (age + deadman), either way; the steering is left as asked."""
    link, _ = link_of([], view_delay_s=view_delay_s)
    assert (link.speed_limit_mps(0), link.delay_s(0)) == (None, None)
    assert link.bounded(Target(9.0), 2.0, 0) == Target(9.0)
    link.begin(deadman_s)
    link.accept(1, age_ms * MS, 0)
    assert link.speed_limit_mps(0) == pytest.approx(speed_mps)
    for sign in (1, -1):
        assert link.bounded(Target(sign * 5.0, 7.0), 6.0, 0) == Target(sign * (link.speed_limit_mps(0) or 0), 7.0)
        below, beyond = Target(sign * 0.99 * speed_mps, 7.0), Target(sign * 5.0)
        assert link.bounded(below, 6.0, 0) is below
        assert link.bounded(beyond, 0.99 * speed_mps, 0) is beyond, "another limit is the lower one"


@given(
    ages_ms=st.lists(st.integers(0, 1000), min_size=1, max_size=200), deadman_s=st.none() | st.floats(0.05, 1.0)
)
def test_no_target_is_faster_than_the_travel_delay_allows(ages_ms: list[int], deadman_s: float | None) -> None:
    """The way over age and deadman is at most the setting."""
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
    """Number, reason and age of the refused commands since the last accepted one."""
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

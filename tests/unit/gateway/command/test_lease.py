"""The lease. Row 'lease: exclusive, renewed by drive or renew, expires: 2 s', and row 'take'."""

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from gateway.command.lease import HeldLease, Leases
from schemas.reasons import Reason
from schemas.requests import LEASE_MAX, Role

S = 1_000_000_000


def leases(seed: int = 1) -> Leases:
    """Leases that last 2 s."""
    return Leases(2 * S, Random(seed))  # noqa: S311 - as in the arbiter: it keeps no secret


def given_to(made: Leases, operator: str, role: Role = Role.OPERATOR, now_ns: int = 0) -> HeldLease:
    lease = made.acquire(operator, role, now_ns)
    assert isinstance(lease, HeldLease)
    return lease


def test_one_at_a_time() -> None:
    """Row 'lease: exclusive': who comes second is told that it is held, also the holder himself."""
    made = leases()
    lease = given_to(made, "first")
    assert made.acquire("second", Role.SUPERVISOR, 0) is Reason.LEASE_HELD
    assert made.acquire("first", Role.OPERATOR, 0) is Reason.LEASE_HELD
    assert made.held == lease


def test_it_expires_at_two_seconds_and_not_before() -> None:
    """Row 'lease: expires: 2 s'; each renewal counts anew."""
    made = leases()
    given_to(made, "first")
    made.renew(S)
    assert made.expire(3 * S - 1) is None
    lost = made.expire(3 * S)
    assert lost is not None
    assert lost.operator == "first"
    assert made.held is None
    assert made.expire(4 * S) is None
    assert made.refusal(lost.id, "first") is Reason.LEASE_EXPIRED


def test_nobodys_lease_is_neither_renewed_nor_ended() -> None:
    """There is nothing to renew."""
    made = leases()
    made.renew(0)
    made.end(Reason.LEASE_RELEASED)
    assert made.held is None
    assert made.refusal(0, "first") is Reason.NO_LEASE


def test_number_and_operator_both_have_to_fit() -> None:
    """Who has overheard the number is still somebody else."""
    made = leases()
    lease = given_to(made, "first")
    assert made.refusal(lease.id, "first") is None
    assert made.refusal(lease.id, "second") is Reason.NO_LEASE
    assert made.refusal(lease.id + 1, "first") is Reason.NO_LEASE


def test_a_higher_or_equal_role_takes_it() -> None:
    """Row 'take needs a higher or equal role', for every pair of roles."""
    for holder in Role:
        for taker in Role:
            made = leases()
            old = given_to(made, "first", holder)
            taken = made.take("second", taker, S)
            if taker.rank < holder.rank:
                assert taken is Reason.ROLE_TOO_LOW
                assert made.held == old
            else:
                assert isinstance(taken, HeldLease)
                assert (taken.operator, taken.role, taken.expires_ns) == ("second", taker, 3 * S)
                assert made.refusal(old.id, "first") is Reason.LEASE_TAKEN


def test_what_nobody_holds_anybody_takes() -> None:
    """Take is acquire then."""
    assert isinstance(leases().take("second", Role.PROGRAM, 0), HeldLease)


def test_sixteen_ended_leases_are_remembered() -> None:
    """Who lost one is told how; what is older is just not in force."""
    made = leases()
    numbers = []
    for _ in range(17):
        numbers.append(given_to(made, "first").id)
        made.end(Reason.LEASE_RELEASED)
    assert made.refusal(numbers[0], "first") is Reason.NO_LEASE
    assert [made.refusal(number, "first") for number in numbers[1:]] == [Reason.LEASE_RELEASED] * 16


@given(run=st.integers(0, 2**64), other=st.integers(0, 2**64))
def test_numbers_of_one_run_do_not_fit_another(run: int, other: int) -> None:
    """And each is one that every language holds exactly."""
    number = given_to(leases(run), "first").id
    assert 0 < number <= LEASE_MAX
    assert (number == given_to(leases(other), "first").id) is (run == other)

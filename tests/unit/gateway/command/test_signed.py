"""The arbiter in signed mode: what a grant says counts, and nothing that the sender says of himself."""

from itertools import pairwise

import msgspec
import pytest

from gateway.command.rulings import Credentials
from schemas.decisions import ArbiterState, EventKind
from schemas.reasons import Reason
from schemas.requests import Role
from schemas.subjects import BY_VERB, Asking
from tests.support.requests import REQUESTS
from tests.support.rigs.arbiter import ArbiterRig

OPERATOR = Credentials(Reason.NONE, role=Role.OPERATOR)
NOBODY = Credentials(Reason.PROOF_MISSING)
QUERIES = [verb for verb, command in BY_VERB.items() if command.asking is Asking.QUERY]


def granted(**changes: object) -> ArbiterRig:
    """A robot in signed mode, asked by somebody with these rights."""
    return ArbiterRig(credentials=Credentials(Reason.NONE, **({"role": Role.OPERATOR} | changes)))  # type: ignore[arg-type]


@pytest.mark.parametrize("verb", [*QUERIES, "drive"])
@pytest.mark.parametrize(
    "reason", [Reason.PROOF_MISSING, Reason.PROOF_WRONG, Reason.GRANT_REVOKED, Reason.REPLAYED]
)
def test_a_request_whose_proof_does_not_hold_is_refused_with_its_reason(verb: str, reason: Reason) -> None:
    """Every verb but the stop, whatever its fields say."""
    rig = granted()
    rig.engage()
    rig.credentials = Credentials(reason, "so many")
    own = {"lease": rig.lease, "challenge": rig.challenge(), "seq": 99}
    fields = {name: own.get(name, value) for name, value in REQUESTS[verb].items()}
    handle = 0 if verb == "drive" else 1
    before = rig.arbiter.leases.held
    ruling = rig.send(verb, msgspec.msgpack.encode(fields), handle=handle)
    assert (ruling.reason, ruling.detail) == (reason, "so many")
    assert rig.arbiter.state is ArbiterState.ENGAGED
    assert rig.arbiter.leases.held == before


def test_without_credentials_nothing_is_accepted() -> None:
    """A door that forgot to judge is a closed one."""
    rig = ArbiterRig(credentials=OPERATOR)
    rig.credentials = None
    assert rig.ask("acquire").reason is Reason.PROOF_MISSING


def role_of(rig: ArbiterRig) -> Role | None:
    lease = rig.arbiter.leases.held
    return None if lease is None else lease.role


def test_the_role_is_the_grants() -> None:
    """Whoever says supervisor and was granted operator is an operator."""
    rig = granted(role=Role.PROGRAM)
    rig.ask("acquire", role="supervisor")
    assert role_of(rig) is Role.PROGRAM
    rig.credentials = OPERATOR
    assert rig.ask("take", "second", role="program").reason is Reason.NONE
    assert role_of(rig) is Role.OPERATOR
    rig.credentials = Credentials(Reason.NONE, role=Role.PROGRAM)
    assert rig.ask("take", "first", role="supervisor").reason is Reason.ROLE_TOO_LOW


def test_an_override_has_to_be_granted() -> None:
    """Asking for it without it is refused, also where it would not be needed."""
    rig = granted()
    assert rig.ask("take", override=True).reason is Reason.NOT_GRANTED
    rig.credentials = Credentials(Reason.NONE, role=Role.OPERATOR, override=True)
    assert rig.ask("take", override=True).reason is Reason.NONE


@pytest.mark.parametrize(
    ("grant_mps", "asked_mps", "limit_mps"),
    [
        (None, None, 2.222),
        (0.7, None, 0.7),
        (0.7, 0.4, 0.4),
        (0.7, 2.0, 0.7),
        (9.0, None, 2.222),
        (None, 0.4, 0.4),
    ],
)
def test_the_lowest_speed_limit_counts(grant_mps: float | None, asked_mps: float | None, limit_mps: float) -> None:
    """That of the grant, that of the request and the configured one."""
    rig = granted(speed_limit_mps=grant_mps)
    rig.ask("acquire")
    rig.ask("engage", speed_limit_mps=asked_mps)
    assert rig.arbiter.setpoint.limits.speed_mps == pytest.approx(limit_mps)


@pytest.mark.parametrize(
    ("credentials", "who"), [(OPERATOR, "by first"), (NOBODY, "by first (unproven)"), (None, None)]
)
def test_a_stop_is_served_from_anyone_and_says_whether_it_is_proven(
    credentials: Credentials, who: str | None
) -> None:
    """It needs no grant, no clock and no signature."""
    rig = granted()
    rig.engage()
    rig.drive_for(20, 0.3)
    rig.credentials = credentials
    ruling = rig.send("stop", b"help")
    assert ruling.reason is Reason.NONE
    assert rig.arbiter.state is ArbiterState.STOPPING
    assert rig.arbiter.latches.details == {Reason.REMOTE_STOP: who or "by first (unproven)"}


def test_a_stop_whose_word_came_first_is_named_once_it_is_proven() -> None:
    """The first word of a stop waits for no proof, so the record says afterwards whose it was; once."""
    rig = granted()
    rig.engage()
    rig.drive_for(20, 0.3)
    for rig.credentials in (NOBODY, OPERATOR, NOBODY, OPERATOR):
        rig.send("stop", b"")
    assert rig.arbiter.latches.details == {Reason.REMOTE_STOP: "by first"}
    assert rig.arbiter.engagement.stop_detail == "by first"
    said = [event.text for event in rig.told(EventKind.LATCH)]
    assert said == [
        "latched until a reset: a remote stop was received; by first (unproven)",
        "proven: a remote stop was received; by first",
    ]


def test_a_proven_stop_takes_no_name_from_somebody_elses() -> None:
    """Whoever only claimed to have stopped the robot stays unproven."""
    rig = granted()
    rig.credentials = NOBODY
    rig.send("stop", b"", "vic")
    rig.credentials = OPERATOR
    rig.send("stop", b"")
    assert rig.arbiter.latches.details == {Reason.REMOTE_STOP: "by first, vic (unproven)"}
    assert len(rig.told(EventKind.LATCH)) == 1


def test_in_open_mode_what_is_not_proven_is_not_asked_for() -> None:
    """As before: names and roles are what people say."""
    rig = ArbiterRig()
    rig.ask("acquire", role="supervisor")
    assert role_of(rig) is Role.SUPERVISOR


@pytest.mark.parametrize("reason", [Reason.GRANT_REVOKED, Reason.GRANT_EXPIRED])
def test_a_grant_that_ends_in_mid_drive_stops_the_robot_in_a_controlled_way(reason: Reason) -> None:
    """Nothing is latched; the lease is gone, and says why to its holder."""
    rig = granted()
    rig.engage()
    rig.drive_for(100, 0.5)
    rig.arbiter.end_lease(reason, "by list 1", rig.now_ns)
    assert rig.arbiter.state is ArbiterState.STOPPING
    assert rig.arbiter.leases.held is None
    assert rig.drive(0.5).reason is reason
    speeds = [outcome.actuation.speed_mps for _ in range(100) if (outcome := rig.tick()).actuation is not None]
    steps = [before - after for before, after in pairwise(speeds)]
    assert max(steps) <= 1.2 * 0.01 + 1e-9
    assert speeds[-1] == 0.0
    assert not rig.arbiter.latches.details
    assert [event.reason for event in rig.told(EventKind.LEASE)][-1] is reason


def test_without_a_holder_there_is_no_lease_to_end() -> None:
    """And nothing is told to the chassis."""
    rig = granted()
    rig.arbiter.end_lease(Reason.GRANT_REVOKED, "", rig.now_ns)
    assert rig.arbiter.state is ArbiterState.STANDBY
    assert rig.told(EventKind.LEASE) == []


@pytest.mark.parametrize("reason", [Reason.UNAUTHENTICATED, Reason.SELF_TEST])
def test_what_bars_the_robot_keeps_everybody_from_engaging_it(reason: Reason) -> None:
    """The refusal carries the words that were found; it ends when they do."""
    rig = granted()
    rig.arbiter.engagement.bars = {reason: "the file x is missing"}
    rig.ask("acquire")
    refused = rig.ask("engage")
    assert refused.reason is reason
    assert "the file x is missing" in refused.text
    rig.arbiter.engagement.bars = {}
    assert rig.ask("engage").reason is Reason.NONE

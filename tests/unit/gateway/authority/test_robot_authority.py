"""Statements that a robot in signed mode accepts, and their effects in each tick."""

from typing import Any

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.authority.robot_authority import AuthorityEffects, Kept, NameProof, TimeFloor, resume, trust_of
from gateway.authority.session import RobotSigner
from gateway.command.rulings import RawRequest
from schemas.authority.proof import ROBOT_PROOF_BYTES, GrantRole, chain_text
from schemas.authority.trust import Objection
from schemas.codec import decode
from schemas.decisions import SignedStatement
from schemas.reasons import TEXTS, Reason
from schemas.settings import Settings
from schemas.subjects import BY_NAME
from tests.support.authority import DAY_S, NOW_S, AuthorityBench, Fleet, Pair, Party, S

HOUR = 3600 * S


def signed_statements(effects: AuthorityEffects) -> list[SignedStatement]:
    samples = (one for one in effects.samples if one.subject == "authority/statement")
    decoded = [decode(BY_NAME[one.subject], one.payload) for one in samples]
    return [one for one in decoded if isinstance(one, SignedStatement)]


def statements(effects: AuthorityEffects) -> list[str]:
    return [one.text for one in signed_statements(effects)]


def test_a_statement_is_answered_with_the_robots_own_grant() -> None:
    bench = AuthorityBench()
    reply = bench.show(bench.chain_of("ann"))
    assert (reply.ok, reply.own) == (True, bench.own)
    for text, reason, detail in (
        ("", Reason.MALFORMED, ""),
        ("x", Reason.MALFORMED, "it is not pairs of lines"),
        (bench.chain_of("ann", robots=["a"]), Reason.NOT_GRANTED, "it does not cover cruiser-1"),
    ):
        refused = bench.show(text)
        assert (refused.ok, refused.reason, refused.own) == (False, reason, bench.own)
        assert detail in refused.detail
    pending = bench.authority.receive(RawRequest(41, "", "", b"", 0), 0)
    assert (pending.handle, pending.verb) == (41, "")


def test_grants_that_are_taken_over_are_published_once() -> None:
    bench = AuthorityBench()
    ann = bench.chain_of("ann")
    bench.takes(ann, ann)
    assert statements(bench.tick()) == [ann]
    assert statements(bench.tick()) == []
    published = signed_statements(bench.tick(61 * S))
    assert bench.own in [one.text for one in published]
    first = published[0].sequence
    bench.takes(bench.chain_of("bob"))
    published += signed_statements(bench.tick())
    assert [one.sequence for one in published] == [first + step for step in range(len(published))]


def test_a_list_of_revocations_is_in_force_at_once_and_kept() -> None:
    bench = AuthorityBench()
    ann = bench.fleet.operator()
    revoked = bench.fleet.authority.revoke(5, keys=(ann.key,)).text()
    bench.takes(chain_text(ann.chain), revoked)
    assert bench.show(chain_text(ann.chain)).reason is Reason.GRANT_REVOKED
    assert bench.show(bench.fleet.authority.revoke(4).text()).reason is Reason.REPLAYED
    effects = bench.tick()
    assert statements(effects) == [chain_text(ann.chain), revoked]
    assert effects.kept is not None
    trust = trust_of(bench.fleet.trust, effects.kept)
    assert not isinstance(trust, Objection)
    assert isinstance(trust.judge(ann.chain, NOW_S), Objection)
    assert trust.list_serial == 5


def test_a_rotation_is_kept_and_ends_the_robots_own_grant_until_it_gets_a_new_one() -> None:
    bench, active, standby = AuthorityBench(), Party(), Party()
    bench.takes(bench.fleet.standby.rotate(1, active, standby))
    assert bench.bars().keys() == {Reason.GRANT_REVOKED}
    bench.takes(bench.regrant(active))
    effects = bench.tick()
    assert effects.bars == {}
    assert effects.kept is not None
    assert effects.kept.own == bench.own
    trust = trust_of(bench.fleet.trust, effects.kept)
    assert not isinstance(trust, Objection)
    assert trust.active == active.key


Shown = tuple[str, int, int, int]

shown = st.lists(
    st.tuples(
        st.sampled_from(["rotate", "rotate", "revoke by active", "revoke by standby"]),
        st.integers(0, 2),  # the next active key, or who is revoked
        st.integers(0, 2),  # the next standby key
        st.integers(0, 2),  # the epoch
    ),
    max_size=8,
)


@example([("rotate", 2, 1, 0), ("revoke by standby", 0, 0, 0)])  # the standby stays, and signs the list
@example([("rotate", 1, 2, 0), ("rotate", 0, 2, 0), ("revoke by active", 0, 0, 0)])  # there and back
@example([("revoke by active", 0, 0, 1), ("rotate", 1, 2, 0), ("rotate", 0, 2, 0)])  # its list ended in between
@example([("revoke by standby", 0, 0, 0), ("rotate", 0, 2, 0)])  # it keeps the authority's key: refused
@given(shown)
@settings(max_examples=5 * settings().max_examples)
def test_a_restart_trusts_as_the_robot_did(taken: list[Shown]) -> None:
    fleet = Fleet()
    keys = [fleet.authority, fleet.standby, Party("third")]
    person = Party("ann")
    bench = AuthorityBench(fleet, since(fleet))
    by_key = {key.key: key for key in keys}
    for serial, (what, one, two, epoch) in enumerate(taken, start=1):
        live = bench.authority.admission.trust
        if what == "rotate":
            signed = by_key[live.standby].rotate(serial, keys[one], keys[two], epoch)
            assert bench.show(signed.text()).ok == (keys[one].key != live.active)
        else:
            signer = by_key[live.active if what == "revoke by active" else live.standby]
            signed = signer.revoke(serial, keys=(keys[one].key, person.key), epoch=epoch)
            assert bench.show(signed.text()).ok
    live = bench.authority.admission.trust
    kept = msgspec.json.decode(msgspec.json.encode(bench.authority.to_keep(bench.now_ns)), type=Kept)
    resumed = resume(fleet.trust, kept)
    assert not isinstance(resumed, Objection)
    assert resumed[0] == live


def test_a_rotation_that_it_has_is_no_news_also_after_the_next_one() -> None:
    bench = AuthorityBench()
    new, newer = Fleet(), Fleet()
    first = bench.fleet.standby.rotate(1, new.authority, new.standby).text()
    second = new.standby.rotate(2, newer.authority, newer.standby).text()
    for text in (first, second):
        assert bench.show(text).ok
        said = bench.show(text)
        assert (said.ok, said.reason) == (False, Reason.REPLAYED)
        assert "was accepted before" in said.detail
    assert bench.show(first).reason is Reason.REPLAYED
    third = bench.fleet.standby.rotate(3, new.authority, new.standby).text()
    assert bench.show(third).reason is Reason.PROOF_WRONG


def learnt(fleet: Fleet, new: Fleet) -> Kept:
    """The stored state of a robot of the first fleet: a rotation to the other, and that one's revocations."""
    bench = AuthorityBench(fleet, since(fleet))
    bench.takes(fleet.standby.rotate(1, new.authority, new.standby), new.authority.revoke(1, keys=(b"x" * 32,)))
    kept = bench.tick().kept
    assert kept is not None
    return kept


def since(fleet: Fleet) -> Kept:
    resumed = resume(fleet.trust, Kept())
    assert not isinstance(resumed, Objection)
    assert resumed[0] == fleet.trust
    return resumed[1]


def test_keys_that_a_rotation_led_to_go_on_with_what_was_learnt() -> None:
    fleet, new = Fleet(), Fleet()
    kept = learnt(fleet, new)
    for provisioned in (fleet.trust, new.trust):
        resumed = resume(provisioned, kept)
        assert not isinstance(resumed, Objection)
        trust, still = resumed
        assert (trust.active, trust.revoked, still) == (new.authority.key, frozenset({b"x" * 32}), kept)


def test_keys_of_another_authority_begin_anew() -> None:
    kept, other = learnt(Fleet(), Fleet()), Fleet()
    damaged = msgspec.structs.replace(kept, revocations="x")
    for found in (kept, damaged):
        assert resume(other.trust, found) == (other.trust, since(other))


def test_a_damaged_note_does_not_begin_anew() -> None:
    fleet, new = Fleet(), Fleet()
    kept = learnt(fleet, new)
    change = msgspec.structs.replace
    for damaged in (change(kept, revocations="x"), change(kept, rotations=["x"]), change(kept, rotations=[])):
        assert isinstance(resume(fleet.trust, damaged), Objection)


def test_nobody_engages_before_the_self_test_has_passed_nor_while_nothing_can_be_saved() -> None:
    bench = AuthorityBench()
    bench.authority.self_test = "it is under way"
    assert bench.bars() == {Reason.SELF_TEST: "it is under way"}
    bench.authority.self_test = ""
    assert bench.bars() == {}
    bench.authority.unsaved = "the disk is full"
    effects = bench.tick(10_000_000)
    assert effects.bars == {Reason.SELF_TEST: "the disk is full: a restart would lose revocations"}
    assert bench.tick(10_000_000).bars is None
    bench.authority.unsaved = ""
    assert bench.tick(10_000_000).bars == {}


@pytest.mark.parametrize(
    ("is_its_key", "changes"),
    [
        (False, {"role": GrantRole.ROBOT, "robots": ["cruiser-2"]}),
        (False, {"role": GrantRole.ROBOT, "robots": ["*"]}),
        (True, {"role": GrantRole.OPERATOR, "robots": ["*"]}),
    ],
    ids=["another robot's", "another robot's for all", "its own key, as a person"],
)
def test_a_grant_of_another_robot_or_of_a_person_is_not_its_own(
    is_its_key: bool,  # noqa: FBT001 - a column
    changes: dict[str, Any],
) -> None:
    bench = AuthorityBench()
    own, other = bench.own, Party("cruiser-1" if is_its_key else "cruiser-2")
    if is_its_key:
        other.private = bench.robot.private
    bench.fleet.authority.grant(other, not_after=NOW_S + 9 * DAY_S, **changes)
    assert bench.show(chain_text(other.chain)).own == own


def test_the_floor_of_time_outlives_a_restart() -> None:
    bench = AuthorityBench()
    bench.tick()
    assert bench.tick().kept is None
    bench.takes(bench.fleet.authority.revoke(1, at=NOW_S + HOUR // S))
    effects = bench.tick()
    assert effects.kept is not None
    assert effects.kept.floor_s >= NOW_S + HOUR // S
    # Once; the floor alone each minute.
    assert [bench.tick(after).kept is None for after in (10_000_000, 61 * S, 10_000_000)] == [True, False, True]
    again = AuthorityBench(bench.fleet, effects.kept)
    again.wall_s = 0
    again.tick()
    assert again.show(again.chain_of("old", not_after=NOW_S - 1)).reason is Reason.GRANT_EXPIRED


def test_a_grant_that_is_over_is_said_once_and_not_each_second() -> None:
    bench = AuthorityBench()
    bench.wall_s = NOW_S + DAY_S + 1
    bars = [bench.tick().bars for _ in range(5)]
    text = f"the robot's own grant: {TEXTS[Reason.GRANT_EXPIRED].means}; it ended 2026-11-19 11:06 UTC"
    assert bars[0] == {Reason.GRANT_EXPIRED: text}
    assert bars[1:] == [None] * 4
    bench.wall_s += 3
    assert bench.tick().bars is None


def test_the_tick_says_that_the_holders_grant_has_ended() -> None:
    for why in ("by list 1", "its authority was replaced"):
        holding = Pair()
        holding.leased(7)
        assert holding.bench.tick().ended is None
        fleet, keys = holding.bench.fleet, (holding.ann.key,)
        is_list = why == "by list 1"
        holding.bench.takes(
            fleet.authority.revoke(1, keys=keys) if is_list else fleet.standby.rotate(1, Party(), Party())
        )
        assert holding.bench.tick().ended == Objection(Reason.GRANT_REVOKED, why)


def test_the_holders_grant_is_published_again_with_what_is_new() -> None:
    holding = Pair()
    holding.leased(7)
    bench = holding.bench
    bench.takes(bench.chain_of("bob"))
    bench.tick()
    bench.takes(cyd := bench.chain_of("cyd"))
    assert statements(bench.tick(61 * S)) == [cyd, bench.own, chain_text(holding.ann.chain)]


def test_rotations_are_published_again_and_a_list_as_long_as_it_is_in_force() -> None:
    """A log of any time leads from the former authority to the current one."""
    bench, active, standby = AuthorityBench(), Party(), Party()
    bench.takes(former := bench.fleet.authority.revoke(1).text())
    assert statements(bench.tick(61 * S)) == [former, bench.own, former]
    bench.takes(rotation := bench.fleet.standby.rotate(1, active, standby).text())
    bench.tick()
    assert statements(bench.tick(61 * S)) == [rotation, bench.own]
    bench.takes(newer := active.revoke(1).text())
    bench.tick()
    assert statements(bench.tick(61 * S)) == [rotation, bench.own, newer]


def test_a_clock_that_is_set_back_revives_no_grant_although_nobody_states_the_time() -> None:
    """A verified grant has begun: it is later than that."""
    bench = AuthorityBench()
    bench.takes(bench.regrant(robots=["*"], not_after=NOW_S + 9 * DAY_S))
    over = bench.chain_of("over", not_after=NOW_S + DAY_S)
    bench.wall_s = NOW_S + 2 * DAY_S
    bench.tick()
    bench.takes(bench.chain_of("newer", not_before=NOW_S + 2 * DAY_S - 60, not_after=NOW_S + 3 * DAY_S))
    bench.wall_s = NOW_S
    bench.tick()
    assert bench.show(over).reason is Reason.GRANT_EXPIRED


def test_nobody_takes_the_robots_own_grant_away() -> None:
    bench = AuthorityBench()
    former = bench.own
    own = bench.regrant(not_after=NOW_S + 2 * DAY_S)
    assert bench.show(own).own == own
    kept = bench.tick().kept
    assert kept is not None
    assert kept.own == own
    forged = chain_text([msgspec.structs.replace(bench.robot.chain[0], signature=bytes(64))])
    for text, ok, reason in ((forged, False, Reason.PROOF_WRONG), (former, True, Reason.NONE)):
        said = bench.show(text)
        assert (said.ok, said.reason, said.own) == (ok, reason, own)
        effects = bench.tick()
        assert effects.kept is None
        assert forged not in statements(effects)
    assert bench.bars() == {}


def test_a_new_authority_says_what_time_it_is() -> None:
    """A thief of the former authority's key may have dated a list far ahead, which expires every grant."""
    bench, active, standby = AuthorityBench(), Party(), Party()
    bench.takes(bench.fleet.authority.revoke(1, at=NOW_S + 10**10))
    assert bench.bars().keys() == {Reason.GRANT_EXPIRED}
    bench.takes(bench.fleet.standby.rotate(1, active, standby))
    text = bench.regrant(active)
    bench.tick()
    bench.takes(text)
    assert bench.bars() == {}


# The floor of time.


def test_a_clock_that_is_set_back_revives_nothing_and_one_set_forward_only_ends_things() -> None:
    floor = TimeFloor(1000, 0)
    assert floor.now_s(7 * S, wall_s=0) == 1007
    assert floor.now_s(7 * S, wall_s=5000) == 5000
    assert floor.now_s(8 * S, wall_s=0) == 1008


@given(st.lists(st.tuples(st.integers(0, 100), st.integers(0, 5000), st.integers(0, 5000)), max_size=20))
def test_the_floor_never_falls_while_the_machine_runs(steps: list[tuple[int, int, int]]) -> None:
    floor, boot_ns, before_s = TimeFloor(1000, 0), 0, 0
    for elapsed_s, stated_s, wall_s in steps:
        boot_ns += elapsed_s * S
        floor.lift(stated_s, boot_ns)
        assert floor.now_s(boot_ns, wall_s) >= floor.least_s(boot_ns) >= max(before_s, stated_s)
        before_s = floor.least_s(boot_ns)


# Who else answers under the robot's name.

PAYLOAD, QUESTION = b"\x80", bytes(range(16))
BENCH = AuthorityBench()


def granted(fleet: Fleet, name: str = "cruiser-1", **changes: Any) -> Party:  # noqa: ANN401 - fields of a grant
    robot = Party(name)
    fleet.authority.grant(robot, **({"role": GrantRole.ROBOT, "robots": [name]} | changes))
    return robot


def counts(party: Party, now_s: int = NOW_S, bench: AuthorityBench = BENCH) -> bool:
    """Return True if the robot accepts an answer of a gateway with this party's keys."""
    signer = RobotSigner(party.private, b"boot no2")
    proof = NameProof(Settings(), signer, bench.authority.admission, lambda: party.chain)
    attachment = proof.attachment(PAYLOAD, QUESTION)
    return bench.authority.name_proof.is_namesake(PAYLOAD, attachment, QUESTION, now_s)


def test_a_gateway_with_the_robots_key_or_a_grant_for_its_name_is_a_namesake() -> None:
    bench = AuthorityBench()
    former = granted(bench.fleet)
    assert all(counts(party, now_s, bench) for party in (bench.robot, former) for now_s in (0, NOW_S))
    assert counts(bench.robot, NOW_S + 99 * DAY_S, bench)
    bench.takes(bench.fleet.authority.revoke(1, keys=(former.key,)))
    assert not counts(former, NOW_S, bench)


@pytest.mark.parametrize(
    "other",
    [
        granted(BENCH.fleet, "cruiser-2"),
        granted(BENCH.fleet, "cruiser-2", robots=["*"]),
        granted(Fleet()),
        granted(BENCH.fleet, role=GrantRole.OPERATOR),
        granted(BENCH.fleet, not_after=NOW_S - 1),
    ],
)
def test_nobody_else_is(other: Party) -> None:
    assert not counts(other)
    other.chain = BENCH.robot.chain
    assert not counts(other)


def test_an_answer_answers_one_question() -> None:
    proof, chain = BENCH.authority.name_proof, chain_text(granted(BENCH.fleet).chain).encode()
    attachment = proof.attachment(PAYLOAD, QUESTION)
    for payload, shown, question, is_one in (
        (PAYLOAD, attachment, QUESTION, True),
        (PAYLOAD, attachment, bytes(16), False),
        (PAYLOAD + b"x", attachment, QUESTION, False),
        (PAYLOAD, b"", QUESTION, False),
        (PAYLOAD, chain, QUESTION, False),
        (PAYLOAD, bytes(ROBOT_PROOF_BYTES) + chain, QUESTION, False),
        (PAYLOAD, b"\1" + attachment[1:ROBOT_PROOF_BYTES][::-1] + chain[:-1] + b"!", QUESTION, False),
    ):
        assert proof.is_namesake(payload, shown, question, NOW_S) is is_one


@given(st.binary(max_size=400))
def test_whatever_is_answered_under_its_name_breaks_nothing(attachment: bytes) -> None:
    assert not BENCH.authority.name_proof.is_namesake(PAYLOAD, attachment, QUESTION, NOW_S)

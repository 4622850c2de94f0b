"""What a robot in signed mode takes over of its authority, and what follows in each tick."""

import pytest

from gateway.authority.robot_authority import AuthorityEffects, Kept, trust_of
from schemas.authority.statement import GrantRole, TimeStatement, chain_text
from schemas.authority.trust import Objection
from schemas.codec import decode
from schemas.decisions import SignedStatement
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.subjects import BY_NAME
from tests.support.authority import CHALLENGE, DAY_S, NOW_S, AuthorityBench, Fleet, Party, S

HOUR = 3600 * S


def statements(effects: AuthorityEffects) -> list[str]:
    """The statements that a tick publishes."""
    decoded: list[Message] = [
        message
        for sample in effects.samples
        if sample.subject == "authority/statement"
        and isinstance(message := decode(BY_NAME[sample.subject], sample.payload), Message)
    ]
    return [one.text for one in decoded if isinstance(one, SignedStatement)]


def test_a_statement_is_answered_with_the_robots_own_grant() -> None:
    """So that whoever asks learns the robot's key from the authority."""
    bench = AuthorityBench()
    ann = bench.fleet.operator()
    reply = bench.show(chain_text(ann.chain))
    assert (reply.ok, reply.own) == (True, chain_text(bench.robot.chain))
    refused = bench.show("")
    assert (refused.ok, refused.reason, refused.own) == (False, Reason.MALFORMED, chain_text(bench.robot.chain))


def test_grants_that_are_taken_over_are_published_once() -> None:
    """And once a minute again while they are in use, for logs that begin later."""
    bench = AuthorityBench()
    ann = chain_text(bench.fleet.operator().chain)
    assert bench.show(ann).ok
    assert bench.show(ann).ok
    assert statements(bench.tick()) == [ann]
    assert statements(bench.tick()) == []
    assert chain_text(bench.robot.chain) in statements(bench.tick(61 * S))


def test_a_list_of_revocations_is_in_force_at_once_and_kept() -> None:
    """Also after a restart; an older list never comes back."""
    bench = AuthorityBench()
    ann = bench.fleet.operator()
    assert bench.show(chain_text(ann.chain)).ok
    revoked = bench.fleet.authority.revoke(5, keys=(ann.key,)).text()
    assert bench.show(revoked).ok
    assert bench.show(chain_text(ann.chain)).reason is Reason.GRANT_REVOKED
    assert bench.show(bench.fleet.authority.revoke(4).text()).reason is Reason.REPLAYED
    effects = bench.tick()
    assert effects.kept is not None
    assert statements(effects) == [chain_text(ann.chain), revoked]
    trust = trust_of(bench.fleet.trust, effects.kept)
    assert not isinstance(trust, Objection)
    assert isinstance(trust.judge(ann.chain, NOW_S), Objection)
    assert trust.list_serial == 5


def test_a_rotation_is_kept_and_ends_the_robots_own_grant_until_it_gets_a_new_one() -> None:
    """The new authority grants it without anybody touching the robot."""
    bench, active, standby = AuthorityBench(), Party(), Party()
    assert bench.show(bench.fleet.standby.rotate(1, active, standby).text()).ok
    assert bench.bars().keys() == {Reason.GRANT_UNKNOWN}
    active.grant(bench.robot, role=GrantRole.ROBOT, robots=["cruiser-1"])
    assert bench.show(chain_text(bench.robot.chain)).ok
    effects = bench.tick()
    assert effects.bars == {}
    assert effects.kept is not None
    assert effects.kept.own == chain_text(bench.robot.chain)
    trust = trust_of(bench.fleet.trust, effects.kept)
    assert not isinstance(trust, Objection)
    assert trust.active == active.key


@pytest.mark.parametrize("first", ["authority", "standby", "new"])
def test_a_restart_finds_what_was_revoked_before_and_after_a_rotation(first: str) -> None:
    """Whoever signed the list: the authority of before, the standby, or the new authority."""
    bench, active, standby = AuthorityBench(), Party(), Party()
    signer = {"authority": bench.fleet.authority, "standby": bench.fleet.standby, "new": active}[first]
    shown = [bench.fleet.standby.rotate(1, active, standby), signer.revoke(5, keys=(standby.key,))]
    for signed in shown if first == "new" else reversed(shown):
        assert bench.show(signed.text()).ok
    effects = bench.tick()
    assert effects.kept is not None
    assert trust_of(bench.fleet.trust, effects.kept) == bench.authority.admission.trust


@pytest.mark.parametrize("kept", [Kept(revocations="x"), Kept(rotations=["x"])])
def test_a_damaged_note_is_no_trust(kept: Kept) -> None:
    """Nor is one that somebody else wrote."""
    fleet = Fleet()
    assert isinstance(trust_of(fleet.trust, kept), Objection)
    foreign = Kept(revocations=Fleet().authority.revoke(1).text())
    assert isinstance(trust_of(fleet.trust, foreign), Objection)


def test_nobody_engages_before_the_self_test_has_passed() -> None:
    """It is under way at first, and says why when it fails."""
    bench = AuthorityBench()
    bench.authority.self_test = "it is under way"
    assert bench.bars() == {Reason.SELF_TEST: "it is under way"}
    bench.authority.self_test = ""
    assert bench.bars() == {}


def test_a_robot_without_a_grant_of_its_own_does_not_arm() -> None:
    """What it signs would convince nobody."""
    bench = AuthorityBench()
    bench.wall_s = NOW_S + DAY_S + 1
    assert bench.bars().keys() == {Reason.GRANT_EXPIRED}


def test_without_a_word_of_the_authority_a_robot_arms_for_so_long() -> None:
    """A signed time in answer to its challenge, or a newer list, is a word; a list that it has is none."""
    bench = AuthorityBench(max_offline_h=2)
    bench.fleet.authority.grant(bench.robot, role=GrantRole.ROBOT, robots=["*"], not_after=NOW_S + 99 * DAY_S)
    bench.show(chain_text(bench.robot.chain))
    bench.tick(2 * HOUR)
    assert bench.bars().keys() == {Reason.AUTHORITY_STALE}
    revoked = bench.fleet.authority.revoke(1).text()
    assert bench.show(revoked).ok
    assert bench.bars() == {}
    bench.tick(2 * HOUR)
    assert bench.show(revoked).reason is Reason.REPLAYED
    assert bench.bars().keys() == {Reason.AUTHORITY_STALE}
    said = TimeStatement(challenge=CHALLENGE.hex(), at=NOW_S)
    assert bench.show(bench.fleet.authority.sign(said).text()).ok
    assert bench.bars() == {}


def test_a_fresh_word_can_be_asked_for_after_each_start() -> None:
    """Against thieves, who keep a robot until an old grant holds again."""
    bench = AuthorityBench(require_fresh=True)
    bench.authority.self_test = "x"
    assert bench.bars().keys() == {Reason.AUTHORITY_STALE, Reason.SELF_TEST}
    bench.authority.self_test = ""
    assert bench.show(bench.fleet.authority.revoke(1).text()).ok
    assert bench.bars() == {}


def test_the_time_is_stated_to_who_asked() -> None:
    """A statement that was kept, or made for another challenge, lifts nothing."""
    bench = AuthorityBench()
    late = bench.fleet.authority.sign(TimeStatement(challenge=b"tomorrow".hex(), at=NOW_S + DAY_S)).text()
    assert bench.show(late).reason is Reason.CHALLENGE_UNKNOWN
    fits_now = bench.fleet.authority.sign(TimeStatement(challenge=CHALLENGE.hex(), at=NOW_S + 2 * DAY_S)).text()
    assert bench.show(fits_now).ok
    assert bench.show(chain_text(bench.fleet.operator().chain)).ok  # by the time of the last tick
    bench.tick()
    assert bench.show(chain_text(bench.fleet.operator("bob").chain)).reason is Reason.GRANT_EXPIRED


def test_the_floor_of_time_outlives_a_restart() -> None:
    """A robot that is switched off and on, with its clock set back, revives no grant."""
    bench = AuthorityBench()
    bench.show(bench.fleet.authority.revoke(1).text())
    effects = bench.tick()
    assert effects.kept is not None
    assert effects.kept.floor_s >= NOW_S
    again = AuthorityBench(bench.fleet, effects.kept)
    again.wall_s = 0
    again.tick()
    old = bench.fleet.operator("old", not_after=NOW_S - 1)
    assert again.show(chain_text(old.chain)).reason is Reason.GRANT_EXPIRED


def test_heads_are_published_once_a_second() -> None:
    """Over what was published until then."""
    bench = AuthorityBench()
    subjects = [sample.subject for _ in range(300) for sample in bench.tick(10_000_000).samples]
    assert subjects.count("authority/heads") == 3

"""What a robot in signed mode takes over of its authority, and what follows in each tick."""

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.authority.admission import GRANTS_KEPT
from gateway.authority.operator_proof import new_lease_key
from gateway.authority.robot_authority import AuthorityEffects, Kept, resume, trust_of
from gateway.command.flow import PendingReply
from gateway.command.rulings import RawRequest
from schemas.authority.proof import GrantRole, chain_text
from schemas.authority.trust import Objection
from schemas.codec import decode, encode
from schemas.decisions import LeaseReply, SignedStatement
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.requests import Acquire
from schemas.subjects import BY_NAME, BY_VERB
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
    assert bench.bars().keys() == {Reason.GRANT_REVOKED}
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
    """Whatever was revoked and rotated, also back to a key of before, and whoever of the two keys signed it."""
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


def test_a_note_that_still_holds_a_list_which_a_rotation_ended_starts() -> None:
    """A version of before kept it; one that nobody of them signed is a damaged note."""
    fleet, new = Fleet(), Fleet()
    rotation = fleet.standby.rotate(1, new.authority, new.standby).text()
    note = Kept(revocations=fleet.authority.revoke(3, keys=(b"x" * 32,)).text(), rotations=[rotation])
    trust = trust_of(fleet.trust, note)
    assert not isinstance(trust, Objection)
    assert (trust.active, trust.list_serial, trust.revoked) == (new.authority.key, 0, frozenset())
    assert isinstance(
        trust_of(fleet.trust, msgspec.structs.replace(note, revocations=Fleet().authority.revoke(3).text())),
        Objection,
    )


def test_a_rotation_that_it_has_is_no_news_also_after_the_next_one() -> None:
    """Whoever shows it again learns that the robot has it, not that its signature is wrong."""
    bench = AuthorityBench()
    new, newer = Fleet(), Fleet()
    first = bench.fleet.standby.rotate(1, new.authority, new.standby).text()
    second = new.standby.rotate(2, newer.authority, newer.standby).text()
    for text in (first, second):
        assert bench.show(text).ok
        said = bench.show(text)
        assert (said.ok, said.reason) == (False, Reason.REPLAYED)
        assert "was taken over before" in said.detail
    assert bench.show(first).reason is Reason.REPLAYED
    third = bench.fleet.standby.rotate(3, new.authority, new.standby).text()
    assert bench.show(third).reason is Reason.PROOF_WRONG


@pytest.mark.parametrize("kept", [Kept(revocations="x"), Kept(rotations=["x"])])
def test_a_damaged_note_is_no_trust(kept: Kept) -> None:
    """Nor is one that somebody else wrote."""
    fleet = Fleet()
    assert isinstance(trust_of(fleet.trust, kept), Objection)
    foreign = Kept(revocations=Fleet().authority.revoke(1).text())
    assert isinstance(trust_of(fleet.trust, foreign), Objection)


def learnt(fleet: Fleet, new: Fleet) -> Kept:
    """What a robot of the first fleet has learnt: a rotation to the other, and what that one revoked."""
    bench = AuthorityBench(fleet, since(fleet))
    assert bench.show(fleet.standby.rotate(1, new.authority, new.standby).text()).ok
    assert bench.show(new.authority.revoke(1, keys=(b"x" * 32,)).text()).ok
    kept = bench.tick().kept
    assert kept is not None
    return kept


def since(fleet: Fleet) -> Kept:
    """Nothing was learnt yet."""
    resumed = resume(fleet.trust, Kept())
    assert not isinstance(resumed, Objection)
    assert resumed[0] == fleet.trust
    return resumed[1]


def test_keys_that_a_rotation_led_to_go_on_with_what_was_learnt() -> None:
    """A bundle of the new authority comes after its rotation; what it revoked meanwhile stays revoked."""
    fleet, new = Fleet(), Fleet()
    kept = learnt(fleet, new)
    for provisioned in (fleet.trust, new.trust):
        resumed = resume(provisioned, kept)
        assert not isinstance(resumed, Objection)
        trust, still = resumed
        assert (trust.active, trust.revoked, still) == (new.authority.key, frozenset({b"x" * 32}), kept)


def test_keys_of_another_authority_begin_anew() -> None:
    """Whoever installs them has the robot in his hands. What the former authority said ends with it."""
    kept, other = learnt(Fleet(), Fleet()), Fleet()
    damaged = msgspec.structs.replace(kept, revocations="x")
    for found in (kept, damaged):
        assert resume(other.trust, found) == (other.trust, since(other))


def test_a_damaged_note_does_not_begin_anew() -> None:
    """Under the keys that it is of, what was revoked must not be forgotten."""
    fleet, new = Fleet(), Fleet()
    kept = learnt(fleet, new)
    change = msgspec.structs.replace
    for damaged in (change(kept, revocations="x"), change(kept, rotations=["x"]), change(kept, rotations=[])):
        assert isinstance(resume(fleet.trust, damaged), Objection)


def test_nobody_engages_before_the_self_test_has_passed() -> None:
    """It is under way at first, and says why when it fails."""
    bench = AuthorityBench()
    bench.authority.self_test = "it is under way"
    assert bench.bars() == {Reason.SELF_TEST: "it is under way"}
    bench.authority.self_test = ""
    assert bench.bars() == {}


def test_what_cannot_be_saved_bars_at_once_and_until_it_is() -> None:
    """A robot that is switched off and on would forget what was revoked."""
    bench = AuthorityBench()
    assert bench.bars() == {}
    bench.authority.unsaved = "the disk is full"
    effects = bench.tick(10_000_000)
    assert effects.bars == {Reason.SELF_TEST: "the disk is full: a restart would forget what was revoked"}
    assert bench.tick(10_000_000).bars is None
    bench.authority.unsaved = ""
    assert bench.tick(10_000_000).bars == {}


def test_a_grant_of_another_robot_or_of_a_person_is_not_its_own() -> None:
    """However long it holds, and also for the robot's own key."""
    bench = AuthorityBench()
    own = chain_text(bench.robot.chain)
    other, long = Party("cruiser-2"), NOW_S + 9 * DAY_S
    bench.fleet.authority.grant(other, role=GrantRole.ROBOT, robots=["cruiser-2"], not_after=long)
    bench.robot.chain = []
    bench.fleet.authority.grant(bench.robot, role=GrantRole.OPERATOR, robots=["*"], not_after=long)
    for chain in (other.chain, bench.robot.chain):
        assert bench.show(chain_text(chain)).own == own


def test_a_list_counts_with_its_epoch_where_the_note_has_a_lower_one() -> None:
    """No grant of a former epoch comes back by it."""
    fleet = Fleet()
    trust = trust_of(fleet.trust, Kept(revocations=fleet.authority.revoke(1, epoch=3).text()))
    assert not isinstance(trust, Objection)
    assert trust.epoch == 3


def test_a_time_that_was_attested_is_saved_at_once() -> None:
    """A robot that is switched off right after it revives no grant."""
    bench = AuthorityBench()
    bench.tick()
    assert bench.tick().kept is None
    assert bench.show(bench.fleet.authority.revoke(1, at=NOW_S + HOUR // S).text()).ok
    kept = bench.tick().kept
    assert kept is not None
    assert kept.floor_s >= NOW_S + HOUR // S


def test_an_answer_for_the_name_holds_the_grant_of_now() -> None:
    """A gateway that asks for the name judges by it."""
    bench = AuthorityBench()
    answer = bench.authority.name_proof.attachment(b"info", b"question")
    assert answer.endswith(chain_text(bench.robot.chain).encode())
    bench.robot.chain = []
    bench.fleet.authority.grant(
        bench.robot, role=GrantRole.ROBOT, robots=["cruiser-1"], serial=2, not_after=NOW_S + 9 * DAY_S
    )
    assert bench.show(chain_text(bench.robot.chain)).ok
    answer = bench.authority.name_proof.attachment(b"info", b"question")
    assert answer.endswith(chain_text(bench.robot.chain).encode())


def test_a_robot_without_a_grant_of_its_own_does_not_arm() -> None:
    """What it signs would convince nobody."""
    bench = AuthorityBench()
    bench.wall_s = NOW_S + DAY_S + 1
    assert bench.bars().keys() == {Reason.GRANT_EXPIRED}


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


def test_a_refusal_says_what_is_wrong_and_the_reply_goes_to_who_asked() -> None:
    """With the figures; handle and verb are the request's."""
    bench = AuthorityBench()
    assert "it is not pairs of lines" in bench.show("x").detail
    assert "it is not for cruiser-1" in bench.show(chain_text(bench.fleet.operator(robots=["a"]).chain)).detail
    pending = bench.authority.receive(RawRequest(41, "", "", b"", 0), 0)
    assert (pending.handle, pending.verb) == (41, "")


def test_a_damaged_note_is_named() -> None:
    """By what is wrong with its text."""
    refusal = trust_of(Fleet().trust, Kept(revocations="x"))
    assert refusal == Objection(Reason.MALFORMED, "it is not pairs of lines, a statement and its signature")


def test_a_grant_that_is_over_is_said_once_and_not_each_second() -> None:
    """With the date of its end: a log is read by people, and the journal keeps each change."""
    bench = AuthorityBench()
    bench.wall_s = NOW_S + 2 * DAY_S
    bars = [bench.tick().bars for _ in range(5)]
    assert bars[0] == {Reason.GRANT_EXPIRED: "the robot's own ended on 2026-11-19 11:06 UTC"}
    assert bars[1:] == [None] * 4
    bench.wall_s += 3
    assert bench.tick().bars is None


class Holding:
    """A robot whose lease somebody holds."""

    def __init__(self) -> None:
        self.bench = AuthorityBench()
        self.ann = self.bench.fleet.operator()
        assert self.bench.show(chain_text(self.ann.chain)).ok
        payload = encode(Acquire(public_key=new_lease_key()[1]))
        attachment = self.ann.prove(KEY, BY_VERB["acquire"].encoding, payload, CHALLENGE)
        admission = self.bench.authority.admission
        admission.admit(RawRequest(1, "acquire", "ann", payload, len(payload), attachment=attachment), 0)
        said = LeaseReply(ok=True, reason=Reason.NONE, detail="", cure="", lease=7)
        admission.reply(PendingReply(1, "acquire", encode(said)))
        assert admission.lease is not None
        assert admission.lease.id == 7


KEY = "fleet/cruiser-1/@cmd/ann/acquire"


def test_the_tick_says_that_the_holders_grant_has_ended() -> None:
    """The loop stops the robot by it."""
    holding = Holding()
    assert holding.bench.tick().ended is None
    assert holding.bench.show(holding.bench.fleet.authority.revoke(1, keys=(holding.ann.key,)).text()).ok
    assert holding.bench.tick().ended == Objection(Reason.GRANT_REVOKED, "by list 1")


def test_the_holders_grant_is_published_again_with_what_is_new() -> None:
    """Also in the minute in which another statement came; the grants of others are not."""
    holding = Holding()
    bob, cyd = (chain_text(holding.bench.fleet.operator(name).chain) for name in ("bob", "cyd"))
    assert holding.bench.show(bob).ok
    holding.bench.tick()
    assert holding.bench.show(cyd).ok
    own, held = chain_text(holding.bench.robot.chain), chain_text(holding.ann.chain)
    assert statements(holding.bench.tick(61 * S)) == [cyd, own, held]


def test_rotations_are_published_again_and_a_list_as_long_as_it_is_in_force() -> None:
    """So that a log of any time leads from the authority that was known before to the one that counts."""
    bench, active, standby = AuthorityBench(), Party(), Party()
    own = chain_text(bench.robot.chain)
    former = bench.fleet.authority.revoke(1).text()
    assert bench.show(former).ok
    assert statements(bench.tick(61 * S)) == [former, own, former]
    rotation = bench.fleet.standby.rotate(1, active, standby).text()
    assert bench.show(rotation).ok
    bench.tick()
    assert statements(bench.tick(61 * S)) == [rotation, own]
    newer = active.revoke(1).text()
    assert bench.show(newer).ok
    bench.tick()
    assert statements(bench.tick(61 * S)) == [rotation, own, newer]


def test_statements_are_numbered() -> None:
    """So that a log shows which is missing."""
    bench = AuthorityBench()
    numbers = []
    for name in ("ann", "bob", "cyd"):
        assert bench.show(chain_text(bench.fleet.operator(name).chain)).ok
        samples = bench.tick().samples
        numbers += [
            message.sequence
            for sample in samples
            if isinstance(message := decode(BY_NAME[sample.subject], sample.payload), SignedStatement)
        ]
    assert numbers == [numbers[0] + step for step in range(3)]


def test_what_has_changed_is_saved_once_and_the_floor_once_a_minute() -> None:
    """A disk is not written in each tick."""
    bench = AuthorityBench()
    assert [bench.tick().kept for _ in range(3)] == [None] * 3
    assert bench.show(bench.fleet.authority.revoke(1).text()).ok
    saved = [bench.tick(10_000_000).kept is not None for _ in range(3)]
    assert saved == [True, False, False]
    assert bench.tick(61 * S).kept is not None
    assert bench.tick(10_000_000).kept is None


def test_another_robots_grant_is_not_this_ones() -> None:
    """Nor is one of this robot's key that is for something else."""
    bench = AuthorityBench()
    own = chain_text(bench.robot.chain)
    other = Party("cruiser-2")
    bench.fleet.authority.grant(other, role=GrantRole.ROBOT, robots=["*"])
    assert bench.show(chain_text(other.chain)).own == own
    as_operator = Party("cruiser-1")
    as_operator.private = bench.robot.private
    bench.fleet.authority.grant(as_operator)
    assert bench.show(chain_text(as_operator.chain)).own == own


def test_a_clock_that_is_set_back_revives_no_grant_although_nobody_states_the_time() -> None:
    """A verified grant has begun: it is later than that."""
    bench = AuthorityBench()
    bench.robot.chain = []
    bench.fleet.authority.grant(bench.robot, role=GrantRole.ROBOT, robots=["*"], not_after=NOW_S + 9 * DAY_S)
    assert bench.show(chain_text(bench.robot.chain)).ok
    over = bench.fleet.operator("over", not_after=NOW_S + DAY_S)
    bench.wall_s = NOW_S + 2 * DAY_S
    bench.tick()
    assert bench.show(
        chain_text(
            bench.fleet.operator("newer", not_before=NOW_S + 2 * DAY_S - 60, not_after=NOW_S + 3 * DAY_S).chain
        )
    ).ok
    bench.wall_s = NOW_S
    bench.tick()
    assert bench.show(chain_text(over.chain)).reason is Reason.GRANT_EXPIRED


def test_the_robots_own_grant_lifts_the_floor_of_time() -> None:
    """A robot that starts with a clock of before does not believe it."""
    bench = AuthorityBench()
    kept = bench.tick(61 * S).kept
    assert kept is not None
    assert kept.floor_s >= NOW_S - DAY_S


def test_nobody_takes_the_robots_own_grant_away() -> None:
    """It is public: whoever shows it again under other signatures, or the one before it, changes nothing."""
    bench = AuthorityBench()
    former = bench.robot.chain
    bench.robot.chain = []
    bench.fleet.authority.grant(
        bench.robot, role=GrantRole.ROBOT, robots=["cruiser-1"], not_after=NOW_S + 2 * DAY_S
    )
    own = chain_text(bench.robot.chain)
    assert bench.show(own).own == own
    kept = bench.tick().kept
    assert kept is not None
    assert kept.own == own
    forged = chain_text([msgspec.structs.replace(bench.robot.chain[0], signature=bytes(64))])
    said = bench.show(forged)
    assert (said.ok, said.reason, said.own) == (False, Reason.PROOF_WRONG, own)
    bench.tick()
    said = bench.show(chain_text(former))
    assert (said.ok, said.own) == (True, own)
    effects = bench.tick()
    assert effects.kept is None
    assert forged not in statements(effects)
    assert bench.bars() == {}


def test_the_grants_of_so_many_people_are_remembered_as_text() -> None:
    """The oldest go; one that was forgotten is published again when it is shown."""
    bench = AuthorityBench()
    first = chain_text(bench.fleet.operator("first").chain)
    assert bench.show(first).ok
    for number in range(GRANTS_KEPT - 1):
        bench.tick()
        assert bench.show(chain_text(bench.fleet.operator(f"p{number}").chain)).ok
    bench.tick()
    assert bench.show(first).ok
    assert first not in statements(bench.tick())
    assert bench.show(chain_text(bench.fleet.operator("one-more").chain)).ok
    bench.tick()
    assert bench.show(first).ok
    assert first in statements(bench.tick())


def test_an_epoch_outlives_a_restart_although_a_newer_list_says_a_lower_one() -> None:
    """Only the newest list is kept, and a robot that was switched off would believe old grants again."""
    bench = AuthorityBench()
    assert bench.show(bench.fleet.authority.revoke(1, epoch=5).text()).ok
    assert bench.show(bench.fleet.authority.revoke(2).text()).ok
    effects = bench.tick()
    assert effects.kept is not None
    trust = trust_of(bench.fleet.trust, effects.kept)
    assert not isinstance(trust, Objection)
    assert (trust.list_serial, trust.epoch) == (2, 5)


def test_a_new_authority_says_what_time_it_is() -> None:
    """Whoever stole the former one's key may have dated a list in the year 3000, by which every grant is over."""
    bench, active, standby = AuthorityBench(), Party(), Party()
    assert bench.show(bench.fleet.authority.revoke(1, at=NOW_S + 10**10).text()).ok
    assert bench.bars().keys() == {Reason.GRANT_EXPIRED}
    assert bench.show(bench.fleet.standby.rotate(1, active, standby).text()).ok
    active.grant(bench.robot, role=GrantRole.ROBOT, robots=["cruiser-1"])
    bench.tick()
    assert bench.show(chain_text(bench.robot.chain)).ok
    assert bench.bars() == {}

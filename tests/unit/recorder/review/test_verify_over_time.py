"""The proof of logs across a change of the authority: rotations, renewed grants, lists of revocations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.logs import Faults, find_logs
from recorder.review.verify import RobotProofReport, verify_logs
from recorder.review.verifying import UNSIGNED, ProofFault
from schemas.authority.proof import GrantRole, chain_text
from schemas.authority.trust import BY_SITE, Trust, fingerprint
from schemas.decisions import SignedStatement
from schemas.messages import Message
from tests.support.authority import Fleet, Party, S
from tests.support.logs import saved
from tests.support.messages import ROBOT
from tests.support.signed_run import SignedRun, log_of


class Rotation:
    """A robot's run in which the standby replaces the authority.

    Args:
        before_s: so long it runs under the first authority.
        without_s: so long it has taken over the rotation, and no grant of the next authority.
        after_s: so long it runs under the next one.
    """

    def __init__(self, before_s: int = 4, without_s: int = 2, after_s: int = 4) -> None:
        self.fleet = Fleet()
        self.active, self.standby = Party("next"), Party("next standby")
        self.next = Trust(self.active.key, self.standby.key)
        self.run = run = SignedRun(self.fleet)
        ann = self.fleet.operator("ann")
        former = self.fleet.authority.revoke(7, keys=(Party().key,)).text()
        run.show(chain_text(ann.chain))
        run.show(former)
        run.ask("acquire", ann)
        run.seconds(before_s)
        rotation = self.fleet.standby.rotate(1, self.active, self.standby)
        self.begin_ns = run.time_ns
        self.text = rotation.text()
        run.show(self.text)
        run.show(former)
        run.seconds(without_s)
        run.robot.chain = []
        self.active.grant(run.robot, role=GrantRole.ROBOT, robots=[ROBOT], not_before=run.time_ns // S)
        bob = Party("bob")
        self.active.grant(bob)
        for text in (chain_text(run.robot.chain), chain_text(bob.chain), self.active.revoke(1).text()):
            run.show(text)
        run.ask("acquire", bob)
        run.seconds(after_s)


ROTATED = Rotation()
SAMPLES: tuple[Message, ...] = tuple(ROTATED.run.samples)


def verified(logs: Sequence[Sequence[Message]], *trusts: Trust) -> RobotProofReport:
    """The result for logs of these samples, in files of their own."""
    with TemporaryDirectory() as name:
        paths = [saved(Path(name) / f"log-{number}.mcap", log_of(one)) for number, one in enumerate(logs)]
        faults = Faults()
        (report,) = verify_logs(find_logs(paths, faults), faults, trusts)
        assert not faults, faults.told
        # That nobody signed the files is another story.
        findings = [one for one in report.findings if one.what != UNSIGNED]
        return msgspec.structs.replace(report, findings=findings)


def split(samples: Sequence[Message], *places: int) -> list[Sequence[Message]]:
    """The samples, cut before these places."""
    begins = [0, *places, len(samples)]
    return [samples[begin:end] for begin, end in pairwise(begins) if begin < end]


@pytest.mark.parametrize("logs", [[SAMPLES], split(SAMPLES, 50, 101, 160)], ids=["one log", "four logs"])
@pytest.mark.parametrize("trusts", [[ROTATED.fleet.trust], [ROTATED.next, ROTATED.fleet.trust]])
def test_a_log_across_a_rotation_holds(logs: list[Sequence[Message]], trusts: list[Trust]) -> None:
    """Each grant is judged under the authority of its time, and the robot's key by the grants on both sides."""
    report = verified(logs, *trusts)
    assert report.is_proven, report.findings
    assert [(verb.operator, verb.holds) for verb in report.verbs] == [("ann", True), ("bob", True)]
    assert set(report.authorities) == {ROTATED.fleet.authority.key.hex(), ROTATED.active.key.hex()}


def test_who_is_given_the_new_authority_alone_is_told_so_once() -> None:
    """What was before the rotation cannot be told, and is no forgery."""
    report = verified([SAMPLES], ROTATED.next)
    assert {one.fault for one in report.findings} == {ProofFault.UNPROVEN}
    (own,) = (one for one in report.findings if "own grant" in one.what and "--authority" in one.what)
    assert own.time_ns == SAMPLES[0].time_ns
    assert len(report.findings) <= 4


def test_who_is_given_none_is_told_that_the_rotation_cannot_be_checked() -> None:
    """And nothing else: the log names both authorities."""
    report = verified([SAMPLES])
    assert [one.fault for one in report.findings] == [ProofFault.UNPROVEN]
    assert "standby" in report.findings[0].what


def test_a_grant_of_the_former_authority_is_none_after_the_rotation() -> None:
    """A robot that goes on under it was tampered with."""
    rotated = Rotation()
    rotated.run.ask("engage", rotated.fleet.operator("ann"))
    rotated.run.show(chain_text(rotated.fleet.operator("eve").chain))
    eve = rotated.fleet.operator("eve")
    rotated.run.show(chain_text(eve.chain))
    rotated.run.ask("engage", eve)
    rotated.run.seconds(1)
    report = verified([rotated.run.samples], rotated.fleet.trust)
    assert {one.fault for one in report.findings} >= {ProofFault.NOT_GRANTED}


def test_a_rotation_that_the_standby_did_not_sign_changes_nothing() -> None:
    """It is found, and what follows is under the authority of before."""
    fleet = Fleet()
    run, thief = SignedRun(fleet), Party("thief")
    run.seconds(2)
    run.show(Party().rotate(9, thief, Party()).text())
    run.seconds(2)
    report = verified([run.samples], fleet.trust)
    assert [one.fault for one in report.findings] == [ProofFault.WRONGLY_SIGNED]
    assert report.authorities == [fleet.authority.key.hex()]


def test_an_incident_after_the_rotation_holds() -> None:
    """The robot repeats each minute what is in force: its grant, the rotation, the list."""
    rotated = Rotation()
    place, end = len(rotated.run.samples), rotated.run.time_ns
    rotated.run.show(rotated.fleet.standby.rotate(1, rotated.active, rotated.standby).text())
    rotated.run.show(chain_text(rotated.run.robot.chain))
    rotated.run.seconds(3)
    for trust in (rotated.fleet.trust, rotated.next):
        report = verified([rotated.run.samples[place:]], trust)
        assert not report.findings, end


class Renewal:
    """A robot's run in which its own grant is renewed, several times, each one behind the one before."""

    def __init__(self, renewals: int = 3, seconds: int = 3) -> None:
        self.fleet = Fleet()
        self.run = SignedRun(self.fleet)
        for number in range(renewals):
            begins = self.run.time_ns // S
            self.run.robot.chain = []
            self.fleet.authority.grant(
                self.run.robot,
                role=GrantRole.ROBOT,
                robots=[ROBOT],
                serial=number + 2,
                not_before=begins,
                not_after=begins + seconds,
            )
            self.run.show(chain_text(self.run.robot.chain))
            self.run.seconds(seconds)


@given(places=st.lists(st.integers(1, 200), max_size=4).map(sorted), renewals=st.integers(1, 4))
def test_a_log_with_renewed_grants_holds_however_it_is_split(places: list[int], renewals: int) -> None:
    """Each head is judged by the grant of its time, and not by the newest one."""
    renewal = Renewal(renewals)
    samples = renewal.run.samples
    report = verified(split(samples, *(place for place in places if place < len(samples))), renewal.fleet.trust)
    assert report.is_proven, report.findings


@given(
    spans=st.tuples(st.integers(1, 4), st.integers(0, 3), st.integers(1, 4)),
    part=st.tuples(st.floats(0, 1), st.floats(0, 1)).map(sorted),
)
def test_no_part_of_an_honest_log_is_said_to_be_forged(spans: tuple[int, int, int], part: list[float]) -> None:
    """Wherever an incident begins and ends, and whichever authorities are given; what it lacks cannot be told."""
    rotated = Rotation(*spans)
    samples = rotated.run.samples
    begin, end = (int(at * len(samples)) for at in part)
    for trusts in ([rotated.fleet.trust], [rotated.next], [rotated.fleet.trust, rotated.next], []):
        if end - begin < 3:
            return
        report = verified([samples[begin:end]], *trusts)
        wrong = [one for one in report.findings if one.fault.is_tampering]
        # Where the rotation is not in it, an authority that was not given is one as foreign as any other.
        assert not wrong or (len(trusts) == 1 and rotated.text not in _texts(samples[begin:end])), trusts


def _texts(samples: Sequence[Message]) -> set[str]:
    return {one.text for one in samples if isinstance(one, SignedStatement)}


def test_a_log_of_before_the_rotation_is_under_another_authority_than_the_new_one() -> None:
    """That it was tampered with, nothing says; and it does not hold under the authority that was given."""
    before = [one for one in SAMPLES if one.time_ns <= ROTATED.begin_ns and _is_of_before(one)]
    report = verified([before], ROTATED.next)
    assert [one.fault for one in report.findings] == [ProofFault.OTHER_AUTHORITY]
    assert fingerprint(ROTATED.fleet.authority.key) in report.findings[0].what
    assert fingerprint(ROTATED.active.key) in report.findings[0].what
    assert report.authorities == [ROTATED.fleet.authority.key.hex()]
    assert not report.is_vouched


def _is_of_before(sample: Message) -> bool:
    return not isinstance(sample, SignedStatement) or sample.text != ROTATED.text


def test_a_log_that_ends_with_the_rotation_names_both_authorities() -> None:
    """It leads to the one that was given: what is before it wants the other one too."""
    place = next(n for n, one in enumerate(SAMPLES) if getattr(one, "text", "") == ROTATED.text)
    report = verified([SAMPLES[: place + 2]], ROTATED.next)
    assert {one.fault for one in report.findings} == {ProofFault.UNPROVEN}
    (own,) = (one.what for one in report.findings if "own grant" in one.what)
    assert f"rotation from it to {fingerprint(ROTATED.active.key)}" in own
    assert fingerprint(ROTATED.fleet.authority.key) in own


def test_a_robot_that_shows_a_grant_that_was_revoked_is_found() -> None:
    """Who has its key may be anybody from then on; what it showed before holds."""
    fleet = Fleet()
    run = SignedRun(fleet)
    run.seconds(2)
    run.show(fleet.authority.revoke(1, keys=(run.robot.key,)).text())
    run.seconds(4)
    assert not verified([run.samples], fleet.trust).findings
    run.show(chain_text(run.robot.chain))
    (found,) = verified([run.samples], fleet.trust).findings
    assert found.fault is ProofFault.NOT_GRANTED
    assert (found.time_ns, found.count) == (run.time_ns, 1)


def test_a_verb_under_a_sites_grant_is_unproven_and_read() -> None:
    """A log of before: what sites granted is verified no more, and the finding says so; nobody is accused."""
    fleet, ann = Fleet(), Party("ann")
    run = SignedRun(fleet)
    fleet.site().grant(ann)
    run.show(chain_text(ann.chain))
    run.seconds(1)
    run.ask("acquire", ann)
    run.seconds(3)
    report = verified([run.samples], fleet.trust)
    (found,) = report.findings
    assert (found.fault, BY_SITE in found.what) == (ProofFault.UNPROVEN, True)
    assert [grant.signers for grant in report.grants if grant.name == "ann"] == [["depot"]]

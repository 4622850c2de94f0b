"""Verification of logs: signatures of operators and recorders, authorities, and tampering."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode

from gateway.command.rulings import Credentials
from recorder.reading.logs import Faults, find_logs
from recorder.reading.survey import survey
from recorder.record.signed_mode import LogSigner
from recorder.review.verify import RobotProofReport, verify_logs
from recorder.review.verifying import UNSIGNED, ProofFault
from schemas import keys
from schemas.authority.key_files import Identity
from schemas.authority.proof import GrantRole, chain_text
from schemas.authority.trust import BY_SITE, AuthorityKeys, Trust, fingerprint, keys_fingerprint
from schemas.command_line import CommandError
from schemas.decisions import Decision, Journal, SafetyEvent
from schemas.journal import Kind
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.subjects import BY_VERB
from tests.support.authority import DAY_S, NOW_S, Fleet, Party, S
from tests.support.commands import review
from tests.support.logs import channel_of, encoded, foreign_log, mcap_log, saved
from tests.support.messages import ROBOT, key_of
from tests.support.provisioned import write_authority
from tests.support.signed_run import SignedRun, credentials_of, driven, log_of, of, recorder_of, replaced, signed

FLEET = Fleet()
RUN, ANN = driven(FLEET)
SAMPLES = tuple(RUN.samples)
RECORDER = recorder_of(FLEET)
KINDS = list(dict.fromkeys(type(one) for one in SAMPLES))
CHANNELS = [channel_of(kind, number, key_of(kind)) for number, kind in enumerate(KINDS, start=1)]
OTHERS_CHANNEL = len(KINDS) + 1
CHANGED, WRONG, NOT_GRANTED = ProofFault.CHANGED, ProofFault.WRONGLY_SIGNED, ProofFault.NOT_GRANTED
UNPROVEN, OTHERS = ProofFault.UNPROVEN, ProofFault.OTHER_AUTHORITY
MISSING = Credentials(Reason.PROOF_MISSING)


def verified_files(paths: Sequence[Path], *trusts: Trust) -> RobotProofReport:
    faults = Faults()
    (report,) = verify_logs(find_logs(paths, faults), faults, trusts)
    assert not faults, faults.told
    tampered = {CHANGED, WRONG, NOT_GRANTED} & faults_of(report)
    assert (report.is_broken, report.is_proven) == (bool(tampered), not report.findings)
    return report


def verified(
    logs: Sequence[Sequence[Message]], *trusts: Trust, signer: LogSigner | None = None
) -> RobotProofReport:
    with TemporaryDirectory() as name:
        paths = [saved(Path(name) / f"log-{number}.mcap", log_of(one)) for number, one in enumerate(logs)]
        report = verified_files([signed(one, signer) if signer else one for one in paths], *trusts)
        findings = [one for one in report.findings if one.what != UNSIGNED]
        return msgspec.structs.replace(report, findings=findings)


def faults_of(report: RobotProofReport) -> set[ProofFault]:
    return {one.fault for one in report.findings}


def words_of(report: RobotProofReport) -> str:
    return "\n".join(one.what for one in report.findings)


# Whose the files are: of a signed log a change, and what is found.

BESIDE: Final = "log.mcap.sig"
SIGNERS = {
    "signed by an operator": (recorder_of(FLEET, role=GrantRole.OPERATOR), WRONG),
    "signed under a grant that is over": (recorder_of(FLEET, not_after=NOW_S - 1), UNPROVEN),
    "signed by another fleet's recorder": (recorder_of(Fleet()), UNPROVEN),
}


def forged(change: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    return lambda log: (log.parent / BESIDE).write_bytes(change((log.parent / BESIDE).read_bytes()))


def is_pipe(log: Path) -> None:
    (log.parent / BESIDE).unlink()
    os.mkfifo(log.parent / BESIDE)


def flip(log: Path) -> None:
    """Change the log time of the last message in the statistics of the summary."""
    data = bytearray(log.read_bytes())
    data[-60] ^= 1
    log.write_bytes(data)


FILES: dict[str, tuple[Callable[[Path], object], ProofFault | None]] = {
    "as its recorder signed it": (lambda _: None, None),
    "without its last sample": (lambda log: log.write_bytes(log_of(SAMPLES[:-1])), CHANGED),
    "with a sample more": (lambda log: log.write_bytes(log_of([*SAMPLES, SAMPLES[-1]])), CHANGED),
    "without its signature": (lambda log: (log.parent / BESIDE).unlink(), UNPROVEN),
    "with junk beside it": (forged(lambda _: b"junk"), CHANGED),
    "with a signature of another name": (forged(lambda text: text.replace(b"log.mcap", b"LOG.mcap")), WRONG),
    "with very much beside it": (forged(lambda _: b"\n" * 100_000), CHANGED),
    "with a pipe beside it": (is_pipe, CHANGED),
    **{name: (partial(signed, signer=who), fault) for name, (who, fault) in SIGNERS.items()},
}  # fmt: skip


@pytest.mark.parametrize("row", FILES)
def test_a_file_is_compared_with_the_signature_beside_it(tmp_path: Path, row: str) -> None:
    """An unknown signer proves nothing, and is no tampering."""
    log = signed(saved(tmp_path / "log.mcap", log_of(SAMPLES)), RECORDER)
    change, fault = FILES[row]
    change(log)
    report = verified_files([log], FLEET.trust)
    assert faults_of(report) == {fault} - {None}
    assert [one.fits for one in report.files] == [fault is None or row in SIGNERS]


def test_a_byte_of_a_file_that_was_changed_is_found(tmp_path: Path) -> None:
    log = signed(saved(tmp_path / "log.mcap", log_of(SAMPLES)), RECORDER)
    flip(log)
    faults = Faults()
    (report,) = verify_logs(find_logs([log], faults), faults, [FLEET.trust])
    assert CHANGED in faults_of(report)
    assert report.is_broken


# What a run says: given what happens in its last second, what is found.

Story = Callable[[SignedRun, Party], object]


def proof_for(verb: str, operator: str = "ann", robot: str = ROBOT, payload: bytes = b"\x80") -> bytes:
    return ANN.prove(keys.command("fleet", robot, operator, verb), BY_VERB[verb].encoding, payload, b"challeng")


def engaged(by: Party = ANN, **how: Any) -> Story:  # noqa: ANN401 - of the request
    def story(run: SignedRun, _: Party) -> None:
        run.show(chain_text(by.chain))
        run.ask("engage", by, **how)

    return story


def granted(**said: Any) -> Story:  # noqa: ANN401 - fields of a grant
    role = said.get("role", GrantRole.OPERATOR)
    bob = FLEET.operator("bob", **said)
    return engaged(
        bob, credentials=credentials_of(bob) if role is GrantRole.OPERATOR else Credentials(Reason.NONE)
    )


def allowed(**said: Any) -> Story:  # noqa: ANN401 - fields of the credentials
    return engaged(credentials=credentials_of(ANN, **said))


def junk(run: SignedRun, ann: Party) -> None:
    run.waiting += [(1, 1, 1, 2, 3, 4, 5, 6, 7, 8), (1, 1, 1, "engage", "ann", b"", 0, "", b"", []), (1,) * 10]
    run.ask("engage", ann, attachment=os.urandom(89))


PROOF = proof_for("engage")
UNSIGNED_REQUEST = (Kind.REQUEST, 1, 1, "engage", "ann", b"\x80", 1, "")
RUNS: dict[str, tuple[Story, set[ProofFault]]] = {
    "a verb that its operator signed": (engaged(), set()),
    **{
        f"a verb with a signature that is {what}": (engaged(attachment=attachment), {WRONG})
        for what, attachment in {
            "none": b"",
            "short": PROOF[:-1],
            "wrong in its last byte": PROOF[:-1] + bytes([PROOF[-1] ^ 1]),
            "for another verb": proof_for("park"),
            "for another operator": proof_for("engage", operator="bob"),
            "for another robot": proof_for("engage", robot="cruiser-2"),
            "for another payload": proof_for("engage", payload=b"\x81"),
        }.items()
    },
    "a grant for another robot": (granted(robots=["cruiser-2"]), {NOT_GRANTED}),
    "a grant for another verb": (granted(verbs=["acquire"]), {NOT_GRANTED}),
    "a grant that is over": (granted(not_after=NOW_S - 1), {NOT_GRANTED}),
    "a grant that has not begun": (granted(not_before=NOW_S + DAY_S // 2), {NOT_GRANTED}),
    "a grant of a recorder": (granted(role=GrantRole.RECORDER), {NOT_GRANTED}),
    # The holder of the grant signed it so.
    "a grant of another": (engaged(operator="carl", attachment=proof_for("engage", "carl")), {NOT_GRANTED}),
    **{
        f"more than the grant allows: {said}": (allowed(**said), {NOT_GRANTED})
        for said in ({"serial": 2}, {"override": True}, {"speed_limit_mps": None}, {"speed_limit_mps": 2.0})
    },
    # A list of revocations that the authority did not sign revokes nothing.
    "a list of another": (lambda run, _: run.show(Party().revoke(1, keys=(ANN.key,)).text()), {WRONG}),
    # That a grant is not in the log is no proof that the verb was wrong.
    "a grant that is not there": (lambda run, _: run.ask("acquire", FLEET.operator("zoe")), {UNPROVEN}),
    # Of a request of open mode nobody can tell who sent it.
    "a request of open mode": (lambda run, _: run.waiting.append(UNSIGNED_REQUEST), {UNPROVEN}),
    "what is no journal": (junk, {CHANGED, WRONG}),
}  # fmt: skip


@pytest.mark.parametrize("row", RUNS)
def test_what_a_robot_accepted_is_judged_again(row: str) -> None:
    """A robot that accepted an invalid command was tampered with itself."""
    run, ann = driven(FLEET, robot=RUN.robot)
    story, faults = RUNS[row]
    story(run, ann)
    run.seconds(1)
    assert faults_of(verified([run.samples], FLEET.trust)) == faults


def test_stops_that_nobody_signed_are_told_beside_the_signed_one() -> None:
    run, ann = driven(FLEET, robot=RUN.robot)
    for operator in ("ann", "ann", "zoe"):
        run.ask("stop", ann, operator=operator, attachment=b"", credentials=MISSING)
    run.ask("stop", ann)
    run.ask("engage", ann, operator="zoe", attachment=b"x", credentials=MISSING)
    run.seconds(1)
    report = verified([run.samples], FLEET.trust)
    assert report.is_proven
    assert [(one.operator, one.count) for one in report.unproven_stops] == [("ann", 2), ("zoe", 1)]
    assert [(one.operator, one.verb, one.count) for one in report.refused] == [("zoe", "engage", 1)]
    assert [one.verb for one in report.verbs] == ["acquire", "engage", "stop"]


def test_a_copy_says_nothing_new_and_counts_once() -> None:
    place = of(SAMPLES, Decision)[2]
    once = verified([[*SAMPLES, SAMPLES[place]]], FLEET.trust)
    twice = verified([SAMPLES, SAMPLES], FLEET.trust)
    assert once.is_proven
    assert twice.is_proven
    assert (twice.holders, twice.verbs) == (once.holders, once.verbs)


# What the log says of its samples, and what its summary leaves out.


def row_of(message: Message, late_ns: int = 0) -> tuple[int, int, int, int, bytes]:
    at_ns = message.time_ns
    return KINDS.index(type(message)) + 1, message.sequence, at_ns, at_ns + late_ns, encoded(message)


def test_what_the_log_says_of_a_sample_is_held_against_the_sample(tmp_path: Path) -> None:
    changed = of(SAMPLES, Decision)[2]
    data = mcap_log(CHANNELS, [[row_of(one, late_ns=place == changed) for place, one in enumerate(SAMPLES)]])
    report = verified_files([signed(saved(tmp_path / "log.mcap", data), RECORDER)], FLEET.trust)
    assert faults_of(report) == {CHANGED}
    assert "another time" in words_of(report)
    assert report.findings[0].time_ns == SAMPLES[changed].time_ns


def test_a_robot_that_the_summary_leaves_out_is_verified(tmp_path: Path) -> None:
    topic = key_of(SafetyEvent).replace(ROBOT, "cruiser-2")
    channels = [*CHANNELS, channel_of(SafetyEvent, OTHERS_CHANNEL, topic)]
    of_other = (OTHERS_CHANNEL, *row_of(SAMPLES[of(SAMPLES, SafetyEvent)[2]])[1:])
    data = bytearray(mcap_log(channels, [map(row_of, SAMPLES), [of_other]]))
    # A record that nobody knows in the place of the channel's, and a summary without a checksum.
    begin = data.rfind(topic.encode()) - 17
    assert data[begin] == Opcode.CHANNEL
    data[begin] = 0x80
    data[-12:-8] = bytes(4)
    faults = Faults()
    logs = find_logs([signed(saved(tmp_path / "log.mcap", bytes(data)), RECORDER)], faults)
    assert survey(logs, faults).robots == [ROBOT]
    proven = {one.robot: one.is_proven for one in verify_logs(logs, faults, [FLEET.trust])}
    assert proven == {ROBOT: True, "cruiser-2": False}
    assert not faults


# Across a change of the authority: rotations, renewed grants, lists of revocations.


class Rotated:
    """A run in which the standby replaces the authority; ``without_s`` is the time without a new grant."""

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
        self.begin_ns = run.time_ns
        self.text = self.fleet.standby.rotate(1, self.active, self.standby).text()
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

    @property
    def place(self) -> int:
        return next(n for n, one in enumerate(self.run.samples) if getattr(one, "text", "") == self.text)

    @property
    def before(self) -> list[Message]:
        return self.run.samples[: self.place]


ROTATED = Rotated()
DRIVEN: tuple[Message, ...] = tuple(ROTATED.run.samples)


def split(samples: Sequence[Message], *places: int) -> list[Sequence[Message]]:
    begins = [0, *places, len(samples)]
    return [samples[begin:end] for begin, end in pairwise(begins) if begin < end]


@pytest.mark.parametrize("logs", [[DRIVEN], split(DRIVEN, 50, 101, 160)], ids=["one log", "four logs"])
@pytest.mark.parametrize("trusts", [[ROTATED.fleet.trust], [ROTATED.next, ROTATED.fleet.trust]])
def test_a_log_across_a_rotation_holds(logs: list[Sequence[Message]], trusts: list[Trust]) -> None:
    """Each grant is judged under the authority of its time, and the robot's key by the grants on both sides."""
    report = verified(logs, *trusts)
    assert report.is_proven, report.findings
    assert [(verb.operator, verb.holds) for verb in report.verbs] == [("ann", True), ("bob", True)]
    assert set(report.authorities) == {ROTATED.fleet.authority.key.hex(), ROTATED.active.key.hex()}


BOTH = (fingerprint(ROTATED.fleet.authority.key), fingerprint(ROTATED.active.key))
FORGED = Fleet()


@pytest.mark.parametrize(
    ("samples", "trusts", "fault", "words", "is_vouched"),
    [
        # What was before the rotation stays unproven, and is no forgery: once, with what to give.
        (DRIVEN, [ROTATED.next], UNPROVEN, ("own grant", "--authority", *BOTH), True),
        (
            DRIVEN[: ROTATED.place + 2],
            [ROTATED.next],
            UNPROVEN,
            ("own grant", f"rotation from it to {BOTH[1]}", BOTH[0]),
            True,
        ),
        # The log names both authorities, and nobody can check the rotation.
        (DRIVEN, [], UNPROVEN, ("does not name the standby",), False),
        # That it was tampered with, nothing says; and it does not hold under the authority that was given.
        (ROTATED.before, [ROTATED.next], OTHERS, BOTH, False),
        # A whole run of somebody else's making holds in itself.
        (driven(FORGED)[0].samples, [FLEET.trust], OTHERS, (fingerprint(FLEET.authority.key),), False),
        (driven(FORGED)[0].samples, [], None, (), False),
    ],
    ids=[
        "given the next",
        "ends with it",
        "given none",
        "before it",
        "somebody else's",
        "somebody else's, believed",
    ],
)
def test_a_log_under_an_authority_that_was_not_given_says_so(
    samples: Sequence[Message], trusts: list[Trust], fault: ProofFault, words: tuple[str, ...], *, is_vouched: bool
) -> None:
    report = verified([samples], *trusts)
    assert faults_of(report) == {fault} - {None}
    assert len(report.findings) <= 4
    said = [one for one in report.findings if all(word in one.what for word in words)]
    assert len(said) == bool(fault)
    assert all(one.time_ns in {None, samples[0].time_ns, ROTATED.begin_ns} for one in said)
    assert report.is_vouched is is_vouched
    if fault is not UNPROVEN:
        own = FORGED if samples[0] is not DRIVEN[0] else ROTATED.fleet
        assert report.authorities == [own.authority.key.hex()]


def rotation_of_a_thief(run: SignedRun, _: Fleet) -> None:
    run.show(Party().rotate(9, Party("thief"), Party()).text())


def robot_revoked(run: SignedRun, fleet: Fleet) -> None:
    run.show(fleet.authority.revoke(1, keys=(run.robot.key,)).text())
    run.seconds(4)
    assert not verified([run.samples], fleet.trust).findings
    run.show(chain_text(run.robot.chain))


def granted_by_a_site(run: SignedRun, fleet: Fleet) -> None:
    """As an earlier version let sites do: it is not verified any more."""
    ann = Party("ann")
    fleet.site().grant(ann)
    run.show(chain_text(ann.chain))
    run.seconds(1)
    run.ask("acquire", ann)
    run.seconds(3)


def revoked_after(run: SignedRun, fleet: Fleet) -> None:
    ann = fleet.operator("ann")
    run.show(chain_text(ann.chain))
    run.ask("acquire", ann)
    run.seconds(1)
    run.show(fleet.authority.revoke(1, keys=(ann.key,)).text())
    run.seconds(1)
    report = verified([run.samples], fleet.trust)
    assert not report.findings
    assert {one.name: one.objection for one in report.grants} == {"ann": "", ROBOT: ""}
    run.ask("engage", ann)
    run.seconds(1)
    assert [one.holds for one in verified([run.samples], fleet.trust).verbs] == [True, False]


@pytest.mark.parametrize(
    ("story", "fault", "words"),
    [
        (rotation_of_a_thief, WRONG, "standby"),
        (robot_revoked, NOT_GRANTED, "own grant"),
        (granted_by_a_site, UNPROVEN, BY_SITE),
        (revoked_after, NOT_GRANTED, "engage of ann"),
    ],
)
def test_what_changed_in_a_run_is_judged_from_then_on(
    story: Callable[[SignedRun, Fleet], None], fault: ProofFault, words: str
) -> None:
    fleet = Fleet()
    run = SignedRun(fleet)
    run.seconds(2)
    story(run, fleet)
    at_ns = run.time_ns
    run.seconds(1)
    report = verified([run.samples], fleet.trust)
    (found,) = report.findings
    assert (found.fault, found.count, words in found.what) == (fault, 1, True)
    assert at_ns - 3 * S <= (found.time_ns or 0) <= at_ns
    assert report.authorities == [fleet.authority.key.hex()]
    assert [one.signers for one in report.grants if one.name == "ann" and one.objection] in ([], [["depot"]])


def test_a_grant_of_the_former_authority_is_none_after_the_rotation() -> None:
    rotated = Rotated()
    eve = rotated.fleet.operator("eve")
    rotated.run.show(chain_text(eve.chain))
    rotated.run.ask("engage", eve)
    rotated.run.seconds(1)
    assert NOT_GRANTED in faults_of(verified([rotated.run.samples], rotated.fleet.trust))


def test_a_run_of_another_authority_beside_one_of_the_given_is_no_former_one() -> None:
    other, _ = driven(Fleet(), boot=b"boot no2", at_s=NOW_S + 60)
    assert NOT_GRANTED in faults_of(verified([SAMPLES, other.samples], FLEET.trust))


@pytest.mark.parametrize("is_revoked", [True, False])
def test_a_file_of_a_recorder_is_judged_at_its_end(*, is_revoked: bool) -> None:
    fleet, recorder = Fleet(), Party("depot-1")
    run, _ = driven(fleet)
    fleet.authority.grant(recorder, role=GrantRole.RECORDER)
    run.show(fleet.authority.revoke(1, keys=(recorder.key if is_revoked else Party().key,)).text())
    run.seconds(1)
    signer = LogSigner(Identity(recorder.private, recorder.chain, fleet.trust))
    found = faults_of(verified([run.samples], fleet.trust, signer=signer))
    assert found == ({NOT_GRANTED} if is_revoked else set())


@given(places=st.lists(st.integers(1, 200), max_size=4).map(sorted), renewals=st.integers(1, 4))
def test_a_log_with_renewed_grants_holds_however_it_is_split(places: list[int], renewals: int) -> None:
    fleet = Fleet()
    run = SignedRun(fleet)
    for number in range(renewals):
        begins = run.time_ns // S
        run.robot.chain = []
        span = {"not_before": begins, "not_after": begins + 3}
        fleet.authority.grant(run.robot, role=GrantRole.ROBOT, robots=[ROBOT], serial=number + 2, **span)
        run.show(chain_text(run.robot.chain))
        run.seconds(3)
    logs = split(run.samples, *(place for place in places if place < len(run.samples)))
    report = verified(logs, fleet.trust)
    assert report.is_proven, report.findings


@given(
    spans=st.tuples(st.integers(1, 4), st.integers(0, 3), st.integers(1, 4)),
    part=st.tuples(st.floats(0, 1), st.floats(0, 1)).map(sorted),
)
def test_no_part_of_an_honest_log_is_said_to_be_forged(spans: tuple[int, int, int], part: list[float]) -> None:
    rotated = Rotated(*spans)
    samples = rotated.run.samples
    begin, end = (int(at * len(samples)) for at in part)
    if end - begin < 3:
        return
    for trusts in ([rotated.fleet.trust], [rotated.next], [rotated.fleet.trust, rotated.next], []):
        report = verified([samples[begin:end]], *trusts)
        # Where the rotation is not in it, an authority that was not given is one as foreign as any other.
        assert not report.is_broken or (len(trusts) == 1 and not begin <= rotated.place < end), trusts


# The command.


OTHER, WHOLE, LONG = Fleet(), log_of(SAMPLES), log_of(driven(FLEET, 12)[0].samples)
OTHER_KEYS = keys_fingerprint(AuthorityKeys(OTHER.authority.key.hex(), OTHER.standby.key.hex()))
OPENED = log_of([one for one in SAMPLES if isinstance(one, Journal | Decision | SafetyEvent)])
OF_BOB = log_of(replaced(SAMPLES, of(SAMPLES, Decision)[3], operator="bob"))
BY_BOTH = (
    *(fingerprint(one.authority.key) for one in (FLEET, OTHER)),
    "no rotation",
    f"json: keys {OTHER_KEYS}\n",
)
COMMANDS: dict[str, tuple[bytes, bytes | None, Fleet | None, int, tuple[str, ...], dict[str, Any]]] = {
    "all holds": (WHOLE, WHOLE, FLEET, 0, (": all holds", "ann held lease 77"), {"is_vouched": True}),
    "by the log": (WHOLE, WHOLE, None, 0, (": all holds", "not verified (--authority)"), {"is_vouched": False}),
    "other authority": (WHOLE, WHOLE, OTHER, 3, (": UNDER ANOTHER AUTHORITY", *BY_BOTH), {"is_vouched": False}),
    "cut off": (cut := LONG[: len(LONG) * 4 // 5], cut, FLEET, 3, ("NOT ALL COULD BE READ",), {"unread": 1}),
    "changed": (OF_BOB, WHOLE, FLEET, 1, (": NOT AS IT WAS SIGNED", "NOT AS SIGNED by an unknown"), {"unread": 0}),
    "open mode": (OPENED, None, None, 3, ("can be proven", "open mode", "NOT SIGNED"), {"robot_key": ""}),
    "no robot": (foreign_log(), None, None, 3, (), {}),
}
"""A log, what its recorder signed, the authority that is given, the exit code, words and facts."""


@pytest.mark.parametrize("row", COMMANDS)
def test_the_command_says_what_is_proven(tmp_path: Path, capsys: pytest.CaptureFixture[str], row: str) -> None:
    data, of_recorder, fleet, code, (*words,), facts = COMMANDS[row]
    log = saved(tmp_path / "log.mcap", data if of_recorder is None else of_recorder)
    if of_recorder is not None:
        saved(signed(log, RECORDER), data)
    given_keys = ["--authority", f"{write_authority(tmp_path, fleet)}/authority.json"] if fleet else []
    assert review("verify", str(log), *given_keys) == code
    said = capsys.readouterr().out
    assert not words or words[0] in said.partition("\n")[0]
    assert [word for word in words if word not in said] == []
    assert (", as given" in said) == (fleet is FLEET)
    assert review("verify", str(log), *given_keys, "--json") == code
    for line in capsys.readouterr().out.splitlines():
        found = json.loads(line)
        assert found | facts == found
        assert [one for one in found["findings"] if json.dumps(one["what"]) in json.dumps(found["files"])] == []


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff", b'{"active": "1", "standby": "2"}'])
def test_an_authority_that_is_none_is_named_with_the_cure(tmp_path: Path, content: bytes) -> None:
    path = saved(tmp_path / "authority.json", content)
    with pytest.raises(CommandError, match=r"authority\.json.*cruiser provision") as raised:
        review("verify", str(saved(tmp_path / "log.mcap", WHOLE)), "--authority", str(path))
    assert raised.value.code == 2

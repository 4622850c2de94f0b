"""The proof of logs: what operators and recorders signed, and what somebody made of it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from mcap.opcode import Opcode

from gateway.command.rulings import Credentials
from recorder.disk.files import lock
from recorder.encoding.protobuf import compile_encoder, descriptor_set, schema_name
from recorder.mcap.writer import LogChannel, McapFile
from recorder.reading.logs import Faults, find_logs
from recorder.reading.survey import survey
from recorder.record.retention import LogSigner
from recorder.review.catalog.directory import SCHEMA, Catalog, known_logs, write_table
from recorder.review.info import CATALOG_NAME
from recorder.review.verify import RobotProofReport, verify_logs
from recorder.review.verifying import OPEN, STOPS_WAITING, UNSIGNED, ProofFault
from schemas import keys
from schemas.authority.identity import Identity
from schemas.authority.proof import GrantRole, chain_text
from schemas.authority.trust import AuthorityKeys, Trust, fingerprint, keys_fingerprint
from schemas.command_line import CommandError
from schemas.decisions import Decision, Journal, SafetyEvent
from schemas.journal import Kind
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.subjects import BY_VERB
from tests.support.authority import DAY_S, NOW_S, Fleet, Party
from tests.support.commands import review
from tests.support.logs import Disk, channel_of, foreign_log, saved, sealed
from tests.support.messages import ROBOT, key_of
from tests.support.signed_run import (
    SignedRun,
    credentials_of,
    driven,
    log_of,
    of,
    recorder_of,
    replaced,
    signed,
)

FLEET = Fleet()
RUN, ANN = driven(FLEET)
SAMPLES = tuple(RUN.samples)
RECORDER = recorder_of(FLEET)
GIVEN = object()
KINDS = list(dict.fromkeys(type(one) for one in SAMPLES))
OTHERS_CHANNEL = len(KINDS) + 1


def verified(
    directory: Path,
    *logs: bytes,
    trust: Any = GIVEN,  # noqa: ANN401 - a trust or None
    signer: LogSigner = RECORDER,
) -> RobotProofReport:
    """What is proven of one robot's logs, which their recorder has signed; nothing in them is unreadable."""
    paths = [signed(saved(directory / f"log-{number}.mcap", data), signer) for number, data in enumerate(logs)]
    return verified_files(paths, FLEET.trust if trust is GIVEN else trust)


def verified_files(paths: Sequence[Path], *trusts: Trust | None) -> RobotProofReport:
    """The same, of files as they are."""
    faults = Faults()
    (report,) = verify_logs(find_logs(paths, faults), faults, [one for one in trusts if one is not None])
    assert not faults, faults.told
    return report


def faults_of(report: RobotProofReport) -> set[ProofFault]:
    """The kinds of what is wrong."""
    return {one.fault for one in report.findings}


def words_of(report: RobotProofReport) -> str:
    """What is wrong, for people."""
    return "\n".join(one.what for one in report.findings)


def test_a_copy_says_nothing_new_and_counts_once(tmp_path: Path) -> None:
    """A log and its incident hold the same, and so do two recorders' logs."""
    place = of(SAMPLES, Decision)[2]
    report = verified(tmp_path, log_of([*SAMPLES, SAMPLES[place]]))
    assert report.is_proven
    twice = verified(tmp_path, log_of(SAMPLES), log_of(SAMPLES))
    assert twice.is_proven
    assert twice.holders == report.holders
    assert twice.verbs == report.verbs


def test_a_whole_run_of_somebody_elses_making_is_found(tmp_path: Path) -> None:
    """It holds in itself; its authority is not the fleet's, so nothing vouches for it."""
    forger = Fleet()
    run, _ = driven(forger)
    report = verified(tmp_path, log_of(run.samples), signer=recorder_of(forger))
    assert faults_of(report) == {ProofFault.OTHER_AUTHORITY}
    assert not report.is_vouched
    assert not report.is_proven
    assert not report.is_broken
    believed = verified(tmp_path, log_of(run.samples), signer=recorder_of(forger), trust=None)
    assert not believed.findings
    assert not believed.is_vouched
    assert believed.authorities == [forger.authority.key.hex()]


# Whose the files are.


def signed_log(directory: Path, signer: LogSigner = RECORDER) -> Path:
    """A log of a drive, and the signature beside it."""
    return signed(saved(directory / "log.mcap", log_of(SAMPLES)), signer)


@pytest.mark.parametrize("place", [0, 200, -1])
def test_a_file_that_was_changed_is_found(tmp_path: Path, place: int) -> None:
    """Any byte of it, and one behind its end."""
    path = signed_log(tmp_path)
    data = bytearray(path.read_bytes())
    if place < 0:
        # The log time of its last message, in the statistics of the summary.
        data[-60] ^= 1
    else:
        data = bytearray(log_of(SAMPLES[: len(SAMPLES) - 1 - place // 200]))
    path.write_bytes(data)
    faults = Faults()
    (report,) = verify_logs(find_logs([path], faults), faults, [FLEET.trust])
    assert ProofFault.CHANGED in faults_of(report)
    assert report.is_broken


def test_a_file_that_no_recorder_signed_proves_nothing(tmp_path: Path) -> None:
    """Nor one that is being written: that is said, and is no tampering."""
    path = saved(tmp_path / "log.mcap", log_of(SAMPLES))
    report = verified_files([path], FLEET.trust)
    assert words_of(report) == UNSIGNED
    assert not report.is_broken
    assert not report.is_proven
    with path.open("rb") as stream:
        assert lock(stream.fileno())
        assert words_of(verified_files([path], FLEET.trust)) == OPEN


@pytest.mark.parametrize(
    ("signer", "fault"),
    [
        (recorder_of(FLEET, role=GrantRole.OPERATOR), ProofFault.WRONGLY_SIGNED),
        (recorder_of(FLEET, not_after=NOW_S - 1), ProofFault.UNPROVEN),
        (recorder_of(Fleet()), ProofFault.UNPROVEN),
    ],
    ids=["no recorder", "over", "another fleet's"],
)
def test_a_file_that_somebody_else_signed_is_not_proven(
    tmp_path: Path, signer: LogSigner, fault: ProofFault
) -> None:
    """Whoever changes a log can sign it with a key of theirs."""
    assert faults_of(verified_files([signed_log(tmp_path, signer)], FLEET.trust)) == {fault}


def test_a_file_that_a_revoked_recorder_signed_is_found(tmp_path: Path) -> None:
    """Its key may be anybody's."""
    run, _ = driven(FLEET, robot=RUN.robot)
    recorder = Party("depot-1")
    FLEET.authority.grant(recorder, role=GrantRole.RECORDER)
    run.show(FLEET.authority.revoke(1, keys=(recorder.key,)).text())
    run.seconds(1)
    signer = LogSigner(Identity(recorder.private, recorder.chain, FLEET.trust))
    assert faults_of(verified(tmp_path, log_of(run.samples), signer=signer)) == {ProofFault.NOT_GRANTED}


def test_a_signature_is_read_with_care(tmp_path: Path) -> None:
    """One in another form, one of which a part was changed, and what is no file."""
    path = signed_log(tmp_path)
    beside = tmp_path / "log.mcap.sig"
    text = beside.read_bytes()
    for forged, fault in (
        (b"junk", ProofFault.CHANGED),
        (text.replace(b"log.mcap", b"LOG.mcap"), ProofFault.WRONGLY_SIGNED),
        (b"\n" * 100_000, ProofFault.CHANGED),
    ):
        beside.write_bytes(forged)
        assert faults_of(verified_files([path], FLEET.trust)) == {fault}
    beside.unlink()
    os.mkfifo(beside)
    assert faults_of(verified_files([path], FLEET.trust)) == {ProofFault.CHANGED}


# What is in them.


def test_what_the_log_says_of_a_sample_is_held_against_the_sample(tmp_path: Path) -> None:
    """Other questions go by the log's own times and sequences."""
    place = of(SAMPLES, Decision)[2]
    at_ns = SAMPLES[place].time_ns
    log = signed(saved(tmp_path / "log.mcap", log_of_shifted(SAMPLES, place)), RECORDER)
    report = verified_files([log], FLEET.trust)
    assert faults_of(report) == {ProofFault.CHANGED}
    assert "another time" in words_of(report)
    assert report.findings[0].time_ns == at_ns


def log_of_shifted(samples: Sequence[Message], place: int) -> bytes:
    """The log of these samples, one of them at another publish time."""
    return log_of_changed(
        samples,
        [
            (sequence, at_ns, publish_ns + (number == place), data)
            for number, (sequence, at_ns, publish_ns, data) in enumerate(map(row_of, samples))
        ],
    )


def log_of_changed(samples: Sequence[Message], rows: Sequence[tuple[int, int, int, bytes]]) -> bytes:
    """The log of these samples with these records."""
    disk = Disk()
    file = McapFile(disk, "test")
    for number, kind in enumerate(KINDS, start=1):
        file.add_channel(LogChannel(number, key_of(kind), schema_name(kind), descriptor_set(kind)))
    file.write_chunk(sealed((KINDS.index(type(one)) + 1, *row) for one, row in zip(samples, rows, strict=True)))
    file.finish()
    return disk.getvalue()


def log_with(kind: type[Message], topic: str, message: Message, channel: int) -> bytes:
    """The log of all samples, one more channel, and in a chunk of its own this message, on a channel of these."""
    disk = Disk()
    file = McapFile(disk, "test")
    for number, one in enumerate(KINDS, start=1):
        file.add_channel(channel_of(one, number, key_of(one)))
    file.add_channel(channel_of(kind, OTHERS_CHANNEL, topic))
    file.write_chunk(sealed((KINDS.index(type(one)) + 1, *row_of(one)) for one in SAMPLES))
    file.write_chunk(sealed([(channel, *row_of(message))]))
    file.finish()
    return disk.getvalue()


def row_of(message: Message) -> tuple[int, int, int, bytes]:
    """Sequence, log time, publish time and data of a record."""
    return message.sequence, message.time_ns, message.time_ns, compile_encoder(type(message))(message)


def test_a_robot_that_the_summary_leaves_out_is_verified(tmp_path: Path) -> None:
    """Other questions show what it said, and nothing proves that."""
    forged = SAMPLES[of(SAMPLES, SafetyEvent)[2]]
    topic = key_of(SafetyEvent).replace(ROBOT, "cruiser-2")
    data = bytearray(log_with(SafetyEvent, topic, forged, OTHERS_CHANNEL))
    # A record that nobody knows in the place of the channel's, and a summary without a checksum.
    begin = data.rfind(topic.encode()) - 17
    assert data[begin] == Opcode.CHANNEL
    data[begin] = 0x80
    data[-12:-8] = bytes(4)
    faults = Faults()
    logs = find_logs([signed(saved(tmp_path / "log.mcap", bytes(data)), RECORDER)], faults)
    assert survey(logs, faults).robots == [ROBOT]
    assert [(one.robot, one.is_proven) for one in verify_logs(logs, faults, [FLEET.trust])] == [
        (ROBOT, True),
        ("cruiser-2", False),
    ]
    assert not faults


def test_no_catalog_hides_a_log_from_the_command(tmp_path: Path) -> None:
    """It says when logs begin and end, and what lies at no time is not read."""
    logs = tmp_path / "logs"
    signed(saved(logs / "a.mcap", log_of(SAMPLES)), RECORDER)
    saved(signed(saved(logs / "b.mcap", log_of(SAMPLES)), RECORDER), log_of(SAMPLES[:-1]))
    catalog = Catalog(logs, SCHEMA.names)
    catalog.refresh(Faults())
    ends = [-1 if file == "b.mcap" else 2**62 for file in catalog.table.column("file").to_pylist()]
    number = SCHEMA.get_field_index("end_ns")
    write_table(logs / CATALOG_NAME, catalog.table.set_column(number, SCHEMA.field(number), pa.array(ends)))
    assert known_logs(logs)
    assert review("verify", str(logs), "--authority", str(authority_file(tmp_path))) == 1


def test_a_run_in_open_mode_has_nothing_to_verify(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It says so, and the exit code is not that of a log that holds."""
    run = SignedRun(FLEET)
    run.seconds(3)
    opened = [one for one in run.samples if isinstance(one, Journal | Decision | SafetyEvent)]
    path = saved(tmp_path / "open.mcap", log_of(opened))
    report = verified_files([path], None)
    assert faults_of(report) == {ProofFault.UNPROVEN}
    assert review("verify", str(path)) == 3
    assert "open mode" in capsys.readouterr().out


# Who commanded.


def asked(tmp_path: Path, verb: str = "engage", *, by: Party = ANN, **how: Any) -> RobotProofReport:  # noqa: ANN401
    """A run in which one more request is journaled."""
    run, _ = driven(FLEET, robot=RUN.robot)
    run.show(chain_text(by.chain))
    run.ask(verb, by, **how)
    run.seconds(1)
    return verified(tmp_path, log_of(run.samples))


def test_a_verb_that_its_operator_signed_holds(tmp_path: Path) -> None:
    """The oracle of the tests below: the same without a fault."""
    assert asked(tmp_path).is_proven


def _signed_for(verb: str, operator: str = "ann", robot: str = ROBOT, payload: bytes = b"\x80") -> bytes:
    """Ann's proof, for something else."""
    return ANN.prove(keys.command("fleet", robot, operator, verb), BY_VERB[verb].encoding, payload, b"challeng")


@pytest.mark.parametrize(
    "attachment",
    [
        b"",
        _signed_for("engage")[:-1],
        (SIGNED := _signed_for("engage"))[:-1] + bytes([SIGNED[-1] ^ 1]),
        _signed_for("park"),
        _signed_for("engage", operator="bob"),
        _signed_for("engage", robot="cruiser-2"),
        _signed_for("engage", payload=b"\x81"),
    ],
    ids=["none", "short", "last byte", "other verb", "other operator", "other robot", "other payload"],
)
def test_a_verb_that_was_accepted_and_not_signed_is_found(tmp_path: Path, attachment: bytes) -> None:
    """A robot that says that it was has been tampered with itself."""
    assert faults_of(asked(tmp_path, attachment=attachment)) == {ProofFault.WRONGLY_SIGNED}


@pytest.mark.parametrize(
    ("granted", "asked_as"),
    [
        ({"robots": ["cruiser-2"]}, {}),
        ({"verbs": ["acquire"]}, {}),
        ({"not_after": NOW_S - 1}, {}),
        ({"not_before": NOW_S + DAY_S // 2}, {}),
        ({"role": GrantRole.RECORDER}, {}),
        # The holder of the grant signed it so.
        ({}, {"operator": "carl", "attachment": _signed_for("engage", operator="carl")}),
        *(
            ({}, {"credentials": credentials_of(ANN, **allowed)})
            for allowed in ({"serial": 2}, {"override": True}, {"speed_limit_mps": None}, {"speed_limit_mps": 2.0})
        ),
    ],
    # The numbers of what is signed differ in each process.
    ids=lambda case: ", ".join(case) or "as granted",
)
def test_a_verb_that_its_grant_did_not_allow_is_found(
    tmp_path: Path, granted: dict[str, Any], asked_as: dict[str, Any]
) -> None:
    """Though the robot took it: another robot, verb, time, role or operator, or more than the grant allows."""
    if granted:
        asked_as = {"by": FLEET.operator("bob", **granted), "credentials": Credentials(Reason.NONE, serial=1)}
    assert faults_of(asked(tmp_path, **asked_as)) == {ProofFault.NOT_GRANTED}


@pytest.mark.parametrize(
    ("said", "fault"),
    [
        # A list of revocations that the authority did not sign revokes nothing.
        (lambda run: run.show(Party().revoke(1, keys=(ANN.key,)).text()), ProofFault.WRONGLY_SIGNED),
        # That a grant is not in the log is no proof that the verb was wrong.
        (lambda run: run.ask("acquire", FLEET.operator("zoe")), ProofFault.UNPROVEN),
        # Of a request of open mode nobody can tell who sent it.
        (
            lambda run: run.waiting.append((Kind.REQUEST, 1, 1, "engage", "ann", b"\x80", 1, "")),
            ProofFault.UNPROVEN,
        ),
    ],
    ids=["list of another", "no grant", "open mode"],
)
def test_what_does_not_hold_in_a_signed_log_is_said(
    tmp_path: Path, said: Callable[[SignedRun], object], fault: ProofFault
) -> None:
    """As what it is."""
    run, _ = driven(FLEET, robot=RUN.robot)
    said(run)
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples))
    assert faults_of(report) == {fault}
    assert report.is_broken is (fault is ProofFault.WRONGLY_SIGNED)


def test_a_verb_after_its_grant_was_revoked_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One before it holds, in the same log, which says that the grant was revoked later."""
    fleet = Fleet()
    run, ann = driven(fleet)
    run.show(fleet.authority.revoke(1, keys=(ann.key,)).text())
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples), trust=fleet.trust, signer=recorder_of(fleet))
    assert report.is_proven
    assert {one.name: (one.objection, "by list 1" in one.revoked_later) for one in report.grants} == {
        "ann": ("", True),
        ROBOT: ("", False),
        "depot-1": ("", False),
    }
    log = str(tmp_path / "log-0.mcap")
    assert review("verify", log, "--authority", str(authority_file(tmp_path, fleet))) == 0
    assert "held then, and ended later" in capsys.readouterr().out
    run.ask("engage", ann)
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples), trust=fleet.trust, signer=recorder_of(fleet))
    assert faults_of(report) == {ProofFault.NOT_GRANTED}
    assert [verb.holds for verb in report.verbs] == [True, True, False]


def test_after_a_rotation_the_new_authority_is_believed(tmp_path: Path) -> None:
    """By whoever knew the standby key before."""
    fleet, active, standby = Fleet(), Party("new"), Party("next")
    run, _ = driven(fleet)
    run.show(fleet.standby.rotate(1, active, standby).text())
    active.grant(run.robot, role=GrantRole.ROBOT, robots=[ROBOT])
    run.robot.chain = run.robot.chain[:1]
    run.show(chain_text(run.robot.chain))
    bob = Party("bob")
    active.grant(bob)
    run.show(chain_text(bob.chain))
    run.ask("acquire", bob)
    run.seconds(2)
    report = verified(tmp_path, log_of(run.samples), trust=fleet.trust, signer=recorder_of(fleet))
    assert [(verb.operator, verb.holds) for verb in report.verbs][-1] == ("bob", True)
    assert not [one for one in report.findings if "bob" in one.what]


def test_stops_that_nobody_signed_and_refused_requests_are_listed(tmp_path: Path) -> None:
    """They are no fault of the log."""
    run, ann = driven(FLEET, robot=RUN.robot)
    for _ in range(3):
        run.ask("stop", ann, operator="zoe", attachment=b"", credentials=Credentials(Reason.PROOF_MISSING))
    run.ask("engage", ann, operator="zoe", attachment=b"x", credentials=Credentials(Reason.PROOF_MISSING))
    run.ask("stop", ann)
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples))
    assert report.is_proven
    assert [(one.operator, one.count, one.reason) for one in report.unproven_stops] == [
        ("zoe", 3, "proof_missing")
    ]
    assert [(one.operator, one.verb, one.count) for one in report.refused] == [("zoe", "engage", 1)]
    assert [verb.verb for verb in report.verbs] == ["acquire", "engage", "stop"]
    assert report.verbs[-1].unsigned_before == 0


def stops_of(run: SignedRun, ann: Party, steps: str) -> None:
    """Say stops: s is one that ann signs, 3 are so many seconds, a is an unsigned one of ann and z of zoe."""
    other = ann.prove(keys.command("fleet", ROBOT, "ann", "engage"), BY_VERB["engage"].encoding, b"\x80", bytes(8))
    for step in steps:
        if step.isdigit():
            run.seconds(int(step))
        elif step in "sx":
            run.ask("stop", ann, attachment=other if step == "x" else None)
        else:
            refused = Credentials(Reason.PROOF_MISSING)
            run.ask("stop", ann, operator={"a": "ann", "z": "zoe"}[step], attachment=b"", credentials=refused)


@pytest.mark.parametrize(
    ("steps", "unproven", "before", "after"),
    [
        # A stop goes out before its proof can be made. Another's proof is none of it.
        ("aas1", 0, 2, 0),
        ("aa4s1", 0, 2, 0),
        ("aa6s1", 2, 0, 0),
        ("zz1s1", 2, 0, 0),
        # It is said until the robot is seen to stand.
        ("s1aaa1", 0, 0, 3),
        ("s14aaa1", 0, 0, 3),
        ("s16aaa1", 3, 0, 0),
        ("s11zzz1", 3, 0, 0),
        # All of a flood are counted.
        ("a" * (STOPS_WAITING + 50) + "s1", 50, STOPS_WAITING, 0),
    ],
)
def test_a_stop_that_is_signed_soon_is_its_operators(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], steps: str, unproven: int, before: int, after: int
) -> None:
    """Nobody is accused for those around it; later ones, and those in another name, are unproven."""
    run, ann = driven(FLEET, robot=RUN.robot)
    stops_of(run, ann, steps)
    report = verified(tmp_path, log_of(run.samples))
    assert report.is_proven
    assert sum(one.count for one in report.unproven_stops) == unproven
    last = report.verbs[-1]
    assert (last.verb, last.unsigned_before, last.unsigned_after) == ("stop", before, after)
    assert review("verify", str(tmp_path / "log-0.mcap"), "--authority", str(authority_file(tmp_path))) == 0
    assert ("3 more in this name right after it, unsigned" in capsys.readouterr().out) == bool(after)


def test_a_signed_stop_that_does_not_hold_proves_none(tmp_path: Path) -> None:
    """Its operator is not known then."""
    run, ann = driven(FLEET, robot=RUN.robot)
    stops_of(run, ann, "ax1")
    report = verified(tmp_path, log_of(run.samples))
    assert report.is_broken
    assert [one.count for one in report.unproven_stops] == [1]


# The command.


def authority_file(directory: Path, fleet: Fleet = FLEET) -> Path:
    """The fleet's authority.json."""
    said = {"active": fleet.authority.key.hex(), "standby": fleet.standby.key.hex()}
    return saved(directory / "authority.json", json.dumps(said).encode())


def test_the_command_says_that_all_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With exit code 0, and in JSON the report itself."""
    log = str(signed(saved(tmp_path / "log.mcap", log_of(SAMPLES)), RECORDER))
    words = ["verify", log, "--authority", str(authority_file(tmp_path))]
    assert review(*words) == 0
    out = capsys.readouterr().out
    assert "all holds" in out
    assert "ann held lease 77" in out
    assert review(*words, "--json") == 0
    assert json.loads(capsys.readouterr().out)["robot_key"] == RUN.robot.key.hex()


def test_the_command_says_that_nobody_vouches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where it is not given the authority."""
    assert review("verify", str(signed(saved(tmp_path / "log.mcap", log_of(SAMPLES)), RECORDER))) == 0
    assert "nobody vouches" in capsys.readouterr().out


def test_the_command_names_another_authority_and_the_one_that_was_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3, as where nothing proves it: a log of before a rotation was not tampered with."""
    log = str(signed(saved(tmp_path / "log.mcap", log_of(SAMPLES)), RECORDER))
    other = Fleet()
    assert review("verify", log, "--authority", str(authority_file(tmp_path, other))) == 3
    said = capsys.readouterr().out
    assert said.partition("\n")[0].startswith(f"{ROBOT}: UNDER ANOTHER AUTHORITY")
    for key in (FLEET.authority.key, other.authority.key):
        assert fingerprint(key) in said
    assert "no rotation" in said
    assert ", as given" not in said
    keys = AuthorityKeys(other.authority.key.hex(), other.standby.key.hex())
    assert said.endswith(f"{tmp_path / 'authority.json'}: keys {keys_fingerprint(keys)}\n")


def test_a_run_of_another_authority_beside_one_of_the_given_is_no_former_one(tmp_path: Path) -> None:
    """Where the robot has a grant of the authority that was given, a run under another one was put in."""
    forged, _ = driven(Fleet(), boot=b"boot no2", at_s=NOW_S + 60)
    report = verified(tmp_path, log_of(SAMPLES), log_of(forged.samples))
    assert ProofFault.NOT_GRANTED in faults_of(report)
    assert report.is_broken


def test_a_log_that_is_cut_off_says_so_in_its_first_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What can be read holds; the verdict is on all of it."""
    whole = log_of(driven(FLEET, 12)[0].samples)
    log = str(signed(saved(tmp_path / "log.mcap", whole[: len(whole) * 4 // 5]), RECORDER))
    assert review("verify", log, "--authority", str(authority_file(tmp_path))) == 3
    assert "NOT ALL COULD BE READ" in capsys.readouterr().out.partition("\n")[0]
    assert review("verify", log, "--authority", str(authority_file(tmp_path)), "--json") == 3
    assert json.loads(capsys.readouterr().out)["unread"] == 1


def test_the_command_ends_with_1_for_a_log_that_was_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And says first that it is not as it was signed."""
    log = str(signed(saved(tmp_path / "log.mcap", log_of(SAMPLES)), RECORDER))
    saved(Path(log), log_of(replaced(SAMPLES, of(SAMPLES, Decision)[3], operator="bob")))
    assert review("verify", log, "--authority", str(authority_file(tmp_path))) == 1
    assert "NOT AS IT WAS SIGNED" in capsys.readouterr().out.splitlines()[0]


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff", b'{"active": "1", "standby": "2"}'])
def test_an_authority_that_is_none_is_named_with_the_cure(tmp_path: Path, content: bytes) -> None:
    """Before a log is read."""
    log = str(saved(tmp_path / "log.mcap", log_of(SAMPLES[:5])))
    path = saved(tmp_path / "authority.json", content)
    with pytest.raises(CommandError, match=r"authority\.json.*cruiser provision") as raised:
        review("verify", log, "--authority", str(path))
    assert raised.value.code == 2


def test_a_log_without_robots_has_nothing_to_verify(tmp_path: Path) -> None:
    """Exit code 3: nothing was proven."""
    assert review("verify", str(saved(tmp_path / "log.mcap", foreign_log()))) == 3


def test_what_is_no_journal_is_no_failure_of_ours(tmp_path: Path) -> None:
    """Whatever stands in the inputs of a journal that somebody made."""
    run, ann = driven(FLEET, robot=RUN.robot)
    junk = [(1, 1, 1, 2, 3, 4, 5, 6, 7, 8), (1, 1, 1, "engage", "ann", b"", 0, "", b"", []), (1,) * 10]
    run.waiting += junk
    run.ask("engage", ann, attachment=os.urandom(89))
    run.seconds(1)
    assert verified(tmp_path, log_of(run.samples)).is_broken

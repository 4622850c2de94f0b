"""The proof of logs: what a robot signed, and what somebody made of it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap import records
from mcap.opcode import Opcode

from gateway.command.request import Credentials
from recorder.encoding.protobuf_schema import descriptor_set, message_class, schema_name
from recorder.encoding.transcode import compile_encoder
from recorder.mcap.channel import LogChannel
from recorder.mcap.writer import McapFile
from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.reading.rows import Selection
from recorder.reading.survey import survey
from recorder.review.catalog.directory import Catalog, known_logs
from recorder.review.catalog.known import CATALOG_NAME
from recorder.review.catalog.table import SCHEMA, write_table
from recorder.review.cut import cut
from recorder.review.verify import RobotProofReport, shown_statements, verify_logs
from recorder.review.verifying.commands import STOPS_WAITING
from recorder.review.verifying.findings import ProofFault
from schemas import codec, keys
from schemas.authority.chain import first_link, heads_text, next_link
from schemas.authority.fingerprint import fingerprint
from schemas.authority.statement import GrantRole, chain_text
from schemas.authority.trust import AuthorityKeys, Trust, keys_fingerprint
from schemas.decisions import ChainHead, ChainHeads, Decision, Journal, SafetyEvent, SignedStatement
from schemas.exit_codes import CommandError
from schemas.messages import Message, RobotState
from schemas.reasons import Reason
from schemas.subjects import BY_TYPE, BY_VERB
from tests.support.authority import DAY_S, NOW_S, Fleet, Party, S
from tests.support.commands import review
from tests.support.logs import Disk, channel_of, foreign_log, saved, sealed, with_record_replaced
from tests.support.messages import ROBOT, key_of
from tests.support.signed_run import (
    CHAINED_KINDS,
    LEASE,
    PER_SECOND,
    SignedRun,
    credentials_of,
    driven,
    log_of,
    of,
    replaced,
    without,
)

FLEET = Fleet()
RUN, ANN = driven(FLEET)
SAMPLES = tuple(RUN.samples)
GIVEN = object()
CHAINED = [message for message in SAMPLES if type(message) in CHAINED_KINDS]


def verified(directory: Path, *logs: bytes, trust: Any = GIVEN) -> RobotProofReport:  # noqa: ANN401 - a trust or None
    """What is proven of one robot's logs; nothing in them is unreadable."""
    paths = [saved(directory / f"log-{number}.mcap", data) for number, data in enumerate(logs)]
    return verified_files(paths, FLEET.trust if trust is GIVEN else trust)


def verified_files(paths: Sequence[Path], *trusts: Trust | None, **given: Any) -> RobotProofReport:  # noqa: ANN401
    """The same, of files."""
    faults = Faults()
    (report,) = verify_logs(find_logs(paths, faults), faults, [one for one in trusts if one is not None], **given)
    assert not faults, faults.told
    return report


def faults_of(report: RobotProofReport) -> set[ProofFault]:
    """The kinds of what is wrong."""
    return {one.fault for one in report.findings}


def words_of(report: RobotProofReport) -> str:
    """What is wrong, for people."""
    return "\n".join(one.what for one in report.findings)


def test_a_run_as_it_was_holds_to_its_last_head(tmp_path: Path) -> None:
    """Every sample is proven, and by whom it was commanded."""
    report = verified(tmp_path, log_of(SAMPLES))
    assert not report.findings
    assert report.is_proven
    assert report.is_vouched
    assert report.authorities == [FLEET.authority.key.hex()]
    assert report.robot_key == RUN.robot.key.hex()
    (run,) = report.runs
    assert sum(count.proven for count in run.subjects.values()) == len(CHAINED)
    assert [(verb.verb, verb.operator, verb.holds) for verb in report.verbs] == [
        ("acquire", "ann", True),
        ("engage", "ann", True),
    ]
    (holder,) = report.holders
    assert (holder.lease, holder.operator, holder.grant) == (LEASE, "ann", ANN.chain[0].id.hex())
    assert holder.drives == len(of(SAMPLES, Decision)) - 2
    assert {grant.name for grant in report.grants} == {"ann", ROBOT}


@pytest.mark.parametrize("kind", CHAINED_KINDS)
@pytest.mark.parametrize("number", [0, 2, -2])
def test_a_sample_that_is_missing_is_found(tmp_path: Path, kind: type[Message], number: int) -> None:
    """Wherever it stood between the first head and the last one."""
    report = verified(tmp_path, log_of(without(SAMPLES, of(SAMPLES, kind)[number])))
    assert faults_of(report) == {ProofFault.MISSING}
    assert sum(count.missing for count in report.runs[0].subjects.values()) == 1


CHANGES: dict[type[Message], dict[str, Any]] = {
    Journal: {"inputs": b"\x90"},
    Decision: {"operator": "bob"},
    SafetyEvent: {"text": "otherwise"},
}


@pytest.mark.parametrize("kind", CHAINED_KINDS)
@pytest.mark.parametrize("number", [0, 3, -1])
def test_a_sample_that_was_changed_is_found(tmp_path: Path, kind: type[Message], number: int) -> None:
    """Whatever was changed, and wherever."""
    report = verified(tmp_path, log_of(replaced(SAMPLES, of(SAMPLES, kind)[number], **CHANGES[kind])))
    assert faults_of(report) == {ProofFault.CHANGED}


@pytest.mark.parametrize("kind", CHAINED_KINDS)
def test_samples_that_changed_places_are_found(tmp_path: Path, kind: type[Message]) -> None:
    """Each with the sequence and the time of the other."""
    one, other = of(SAMPLES, kind)[2:4]
    places = [{"sequence": SAMPLES[place].sequence, "time_ns": SAMPLES[place].time_ns} for place in (one, other)]
    swapped = replaced(replaced(SAMPLES, one, **places[1]), other, **places[0])
    assert ProofFault.CHANGED in faults_of(verified(tmp_path, log_of(swapped)))


@pytest.mark.parametrize("kind", CHAINED_KINDS)
def test_a_second_sample_of_one_place_is_found(tmp_path: Path, kind: type[Message]) -> None:
    """The robot signed one of them; before it or behind it, the other was put in."""
    place = of(SAMPLES, kind)[2]
    other = msgspec.structs.replace(SAMPLES[place], **CHANGES[kind])
    for at in (place, place + 1, len(SAMPLES)):
        report = verified(tmp_path, log_of([*SAMPLES[:at], other, *SAMPLES[at:]]))
        assert faults_of(report) == {ProofFault.CHANGED}, at
        assert "contradict" in words_of(report)
        assert sum(count.proven for count in report.runs[0].subjects.values()) == len(CHAINED)


def test_a_copy_says_nothing_new_and_counts_once(tmp_path: Path) -> None:
    """A log and its incident hold the same, and so do two recorders' logs."""
    place = of(SAMPLES, Decision)[2]
    report = verified(tmp_path, log_of([*SAMPLES, SAMPLES[place]]))
    assert report.is_proven
    assert report.runs[0].subjects["safety/decision"].repeated == 1
    twice = verified(tmp_path, log_of(SAMPLES), log_of(SAMPLES))
    assert twice.is_proven
    assert twice.holders == report.holders
    assert twice.verbs == report.verbs


@pytest.mark.parametrize("number", [1, 3, -2])
def test_a_head_that_is_missing_is_found(tmp_path: Path, number: int) -> None:
    """And what the next one proves is proven all the same."""
    report = verified(tmp_path, log_of(without(SAMPLES, of(SAMPLES, ChainHeads)[number])))
    assert faults_of(report) == {ProofFault.MISSING}
    assert words_of(report) == "chain heads"
    assert sum(count.proven for count in report.runs[0].subjects.values()) == len(CHAINED)


def test_a_run_whose_last_heads_were_cut_off_is_found(tmp_path: Path) -> None:
    """What comes so long after the last head is not what the robot left unsigned."""
    run, _ = driven(FLEET, 12)
    heads = of(run.samples, ChainHeads)
    report = verified(tmp_path, log_of(without(run.samples, *heads[4:])))
    assert faults_of(report) == {ProofFault.MISSING}


def test_a_run_whose_heads_were_all_cut_out_is_found(tmp_path: Path) -> None:
    """Its journal says that requests had to be signed."""
    report = verified(tmp_path, log_of(without(SAMPLES, *of(SAMPLES, ChainHeads))))
    assert ProofFault.MISSING in faults_of(report)


@pytest.mark.parametrize("number", [0, 3])
def test_a_head_that_somebody_else_signed_is_found(tmp_path: Path, number: int) -> None:
    """Over exactly what the robot had signed."""
    place = of(SAMPLES, ChainHeads)[number]
    head = SAMPLES[place]
    assert isinstance(head, ChainHeads)
    said = {one.subject: (one.count, one.head) for one in head.heads}
    text = heads_text(head.boot, head.time_ns, head.sequence, said)
    report = verified(tmp_path, log_of(replaced(SAMPLES, place, signature=Party().private.sign(text))))
    assert ProofFault.WRONGLY_SIGNED in faults_of(report)


@pytest.mark.parametrize("changes", [{"signature": bytes(64)}, {"time_ns": 0}, {"former": b"x"}, {"heads": []}])
@pytest.mark.parametrize("at", [0, 1])
def test_a_forged_head_beside_that_of_the_robot_displaces_nothing(
    tmp_path: Path, at: int, changes: dict[str, Any]
) -> None:
    """Whether it came first or last. It is found, and what the robot signed is proven."""
    place = of(SAMPLES, ChainHeads)[2]
    forged = msgspec.structs.replace(SAMPLES[place], **changes)
    report = verified(tmp_path, log_of([*SAMPLES[: place + at], forged, *SAMPLES[place + at :]]))
    assert faults_of(report) == {ProofFault.WRONGLY_SIGNED}
    assert words_of(report) == "chain heads that the robot did not sign"
    assert report.runs == verified(tmp_path / "alone", log_of(SAMPLES)).runs


@pytest.mark.parametrize("is_first", [True, False])
def test_heads_that_name_a_subject_twice_prove_nothing(tmp_path: Path, is_first: bool) -> None:  # noqa: FBT001
    """The robot signed one of each: a second one could be anybody's, with chains made up for it."""
    count, chain = 0, first_link(RUN.signer.boot, "safety/decision")
    forged: list[Message] = []
    for one in SAMPLES:
        if isinstance(one, Decision):
            other: Message = msgspec.structs.replace(one, operator="bob")
            count, chain = count + 1, next_link(chain, codec.encode(other))
        elif isinstance(one, ChainHeads):
            made_up = ChainHead("safety/decision", count, chain)
            heads = [made_up, *one.heads] if is_first else [*one.heads, made_up]
            other = msgspec.structs.replace(one, heads=heads)
        else:
            other = one
        forged.append(other)
    report = verified(tmp_path, log_of(forged))
    assert ProofFault.WRONGLY_SIGNED in faults_of(report)
    assert not report.runs
    assert not any(one.is_proven for one in report.holders)


@pytest.mark.parametrize(
    "changes", [{"time_ns": 2**63}, {"boot": b""}, {"boot": bytes(99)}, {"former": bytes(999)}]
)
def test_a_head_whose_fields_are_none_is_found(tmp_path: Path, changes: dict[str, Any]) -> None:
    """In a log that no recorder wrote. It ends no verification."""
    forged = msgspec.structs.replace(SAMPLES[of(SAMPLES, ChainHeads)[2]], **changes)
    log = saved(tmp_path / "log.mcap", log_of_shifted([*SAMPLES, forged], -1))
    assert faults_of(verified_files([log], FLEET.trust)) == {ProofFault.WRONGLY_SIGNED}


def test_a_whole_run_of_somebody_elses_making_is_found(tmp_path: Path) -> None:
    """It holds in itself; its authority is not the fleet's, so nothing vouches for it."""
    forger = Fleet()
    run, _ = driven(forger)
    report = verified(tmp_path, log_of(run.samples))
    assert faults_of(report) == {ProofFault.OTHER_AUTHORITY}
    assert not report.is_vouched
    assert not report.is_proven
    assert not report.is_broken
    believed = verified(tmp_path, log_of(run.samples), trust=None)
    assert not believed.findings
    assert not believed.is_vouched
    assert believed.authorities == [forger.authority.key.hex()]


def test_a_log_joined_from_two_runs_is_found(tmp_path: Path) -> None:
    """Seconds of one run stand in the place of another's, with their sequences."""
    other, _ = driven(FLEET, robot=RUN.robot, boot=b"boot no2")
    begin, end = NOW_S * S + 2 * S, NOW_S * S + 4 * S
    part = [one for one in other.samples if begin < one.time_ns <= end and type(one) in CHAINED_KINDS]
    rest = [one for one in SAMPLES if not begin < one.time_ns <= end or type(one) not in CHAINED_KINDS]
    joined = sorted([*rest, *part], key=lambda one: one.time_ns)
    assert ProofFault.MISSING in faults_of(verified(tmp_path, log_of(joined)))


def test_two_runs_of_one_robot_hold_each_for_itself(tmp_path: Path) -> None:
    """In one log, or in one each; the second gateway may have begun right behind the first."""
    second, _ = driven(FLEET, robot=RUN.robot, boot=b"boot no2", at_s=NOW_S + 7, former=RUN.signer.last_heads)
    for logs in ([log_of([*SAMPLES, *second.samples])], [log_of(SAMPLES), log_of(second.samples)]):
        report = verified(tmp_path, *logs)
        assert report.is_proven, words_of(report)
        assert [run.boot for run in report.runs] == [b"boot no1".hex(), b"boot no2".hex()]


def test_what_the_log_says_of_a_sample_is_held_against_the_sample(tmp_path: Path) -> None:
    """Other questions go by the log's own times and sequences."""
    place = of(SAMPLES, SafetyEvent)[2]
    at_ns = SAMPLES[place].time_ns
    log = saved(tmp_path / "log.mcap", log_of_shifted(SAMPLES, place))
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


def log_of_changed(
    samples: Sequence[Message],
    rows: Sequence[tuple[int, int, int, bytes]],
    schema: Callable[[bytes], bytes] = bytes,
) -> bytes:
    """The log of these samples with these records, and with the schemas that this makes of ours."""
    disk = Disk()
    file = McapFile(disk, "test")
    for number, kind in enumerate(KINDS, start=1):
        file.add_channel(LogChannel(number, key_of(kind), schema_name(kind), schema(descriptor_set(kind))))
    file.write_chunk(sealed((KINDS.index(type(one)) + 1, *row) for one, row in zip(samples, rows, strict=True)))
    file.finish()
    return disk.getvalue()


def with_defaults(schema: bytes) -> bytes:
    """A schema by which a decision that says nothing of its reason, and gives no words, says something else."""
    files = FileDescriptorSet.FromString(schema)
    if not any(message.name == "Decision" for file in files.file for message in file.message_type):
        return schema
    for file in files.file:
        file.syntax = "proto2"
        for field in (field for message in file.message_type for field in message.field):
            field.ClearField("proto3_optional")
            if field.name == "reason":
                field.default_value = "REASON_REMOTE_STOP"
    return files.SerializeToString()


def with_number_below_zero(schema: bytes) -> bytes:
    """A schema that has a word for the last reason counted from behind."""
    files = FileDescriptorSet.FromString(schema)
    for enum in (enum for file in files.file for enum in file.enum_type if enum.name == "Reason"):
        enum.value.add(name="REASON_SOMEBODY_WAS_RUN_OVER", number=-len(Reason) - 1)
    return files.SerializeToString()


def without_zeros(message: Message) -> bytes:
    """Its record by any other writer of protobuf: a field that is zero is left out."""
    return message_class(type(message)).FromString(row_of(message)[3]).SerializeToString()


def from_behind(message: Message) -> bytes:
    """Its record, in which a reason is counted from behind."""
    record: Any = message_class(type(message)).FromString(row_of(message)[3])
    if isinstance(message, Decision | SafetyEvent):
        record.reason -= len(Reason) + 1
    data: bytes = record.SerializeToString()
    return data


@pytest.mark.parametrize(
    ("schema", "record"),
    [
        (with_defaults, without_zeros),
        (with_number_below_zero, from_behind),
        (bytes, lambda message: row_of(message)[3] + b"\xfa\x3e\x04evil"),
    ],
)
def test_a_log_of_which_others_read_something_else_does_not_hold(
    tmp_path: Path, schema: Callable[[bytes], bytes], record: Callable[[Message], bytes]
) -> None:
    """By the schema in the log, or by fields that are in none."""
    rows = [(*row_of(one)[:3], record(one)) for one in SAMPLES]
    log = saved(tmp_path / "log.mcap", log_of_changed(SAMPLES, rows, schema))
    report = verified_files([log], FLEET.trust)
    assert faults_of(report) & {ProofFault.CHANGED, ProofFault.MISSING}


def test_a_log_that_another_writer_of_protobuf_wrote_holds(tmp_path: Path) -> None:
    """What it says is the same."""
    rows = [(*row_of(one)[:3], without_zeros(one)) for one in SAMPLES]
    log = saved(tmp_path / "log.mcap", log_of_changed(SAMPLES, rows))
    assert faults_of(verified_files([log], FLEET.trust)) == set()


KINDS = list(dict.fromkeys(type(one) for one in SAMPLES))
OTHERS_CHANNEL = len(KINDS) + 1


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


def test_a_message_that_no_index_has_is_held_against_the_chain(tmp_path: Path) -> None:
    """Message indexes may say that a chunk has nothing of what is verified, and others read it all the same."""
    place = of(SAMPLES, SafetyEvent)[2]
    forged = msgspec.structs.replace(SAMPLES[place], text="otherwise")
    number = KINDS.index(SafetyEvent) + 1
    data = log_with(RobotState, key_of(RobotState), forged, number)
    hidden = with_record_replaced(
        data,
        records.MessageIndex(number, [(forged.time_ns, 0)]),
        records.MessageIndex(OTHERS_CHANNEL, [(forged.time_ns, 0)]),
    )
    faults = Faults()
    (report,) = verify_logs(find_logs([saved(tmp_path / "log.mcap", hidden)], faults), faults, [FLEET.trust])
    assert faults_of(report) == {ProofFault.CHANGED}
    assert report.unread


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
    logs = find_logs([saved(tmp_path / "log.mcap", bytes(data))], faults)
    assert survey(logs, faults).robots == [ROBOT]
    assert [(one.robot, one.is_proven) for one in verify_logs(logs, faults, [FLEET.trust])] == [
        (ROBOT, True),
        ("cruiser-2", False),
    ]
    assert not faults


def test_no_catalog_hides_a_log_from_the_command(tmp_path: Path) -> None:
    """It says when logs begin and end, and what lies at no time is not read."""
    place = of(SAMPLES, SafetyEvent)[2]
    logs = tmp_path / "logs"
    saved(logs / "a.mcap", log_of(SAMPLES))
    saved(logs / "b.mcap", log_of([msgspec.structs.replace(SAMPLES[place], text="otherwise")]))
    catalog = Catalog(logs, SCHEMA.names)
    catalog.refresh(Faults())
    ends = [-1 if file == "b.mcap" else 2**62 for file in catalog.table.column("file").to_pylist()]
    number = SCHEMA.get_field_index("end_ns")
    write_table(logs / CATALOG_NAME, catalog.table.set_column(number, SCHEMA.field(number), pa.array(ends)))
    assert known_logs(logs)
    assert review("verify", str(logs), "--authority", str(authority_file(tmp_path))) == 1


# A log may begin and end anywhere.


def test_a_log_that_begins_in_mid_run_holds_from_its_first_head_on(tmp_path: Path) -> None:
    """What is before it hangs on nothing, and that is said, with figures; it is no fault."""
    begin = of(SAMPLES, ChainHeads)[3] - 7
    report = verified(
        tmp_path, log_of([*(SAMPLES[place] for place in of(SAMPLES, SignedStatement)), *SAMPLES[begin:]])
    )
    assert not report.findings
    journal = report.runs[0].subjects["journal"]
    assert journal.before == 5
    assert journal.absent == 3 * PER_SECOND - 5
    assert journal.proven == 3 * PER_SECOND
    assert journal.from_ns == SAMPLES[of(SAMPLES, ChainHeads)[3]].time_ns


def test_what_came_late_into_a_part_of_a_log_is_not_called_missing(tmp_path: Path) -> None:
    """Nothing proves what a recorder fetched of a robot's memory as the part began; nobody took anything out."""
    heads = of(SAMPLES, ChainHeads)
    late = [one for one in SAMPLES[heads[0] + 1 : heads[1]] if isinstance(one, Journal)][2:-2]
    told = [SAMPLES[place] for place in of(SAMPLES, SignedStatement)]
    report = verified(tmp_path, log_of([*told, *SAMPLES[heads[3] :], *late]))
    assert faults_of(report) == {ProofFault.UNPROVEN}
    assert "before the heads that would prove them" in words_of(report)
    assert not report.is_broken
    assert not report.is_proven
    near = SAMPLES[heads[3] - 9 : heads[3] - 3]
    assert ProofFault.MISSING in faults_of(
        verified(tmp_path / "gap", log_of([*told, *near, *SAMPLES[heads[3] :]]))
    )


def begun_at(samples: Sequence[Message], head: int, since: int) -> list[Message]:
    """The log that begins with this head, before it the chained samples from a place on; statements stay."""
    first = of(samples, ChainHeads)[head]
    return [
        one
        for place, one in enumerate(samples)
        if place >= first or isinstance(one, SignedStatement) or (place >= since and type(one) in CHAINED_KINDS)
    ]


@pytest.mark.parametrize("seconds", [2, 3])
@pytest.mark.parametrize("head", [4, 5, -1])
def test_what_lies_before_the_first_head_proves_no_holder(tmp_path: Path, head: int, seconds: int) -> None:
    """Whoever made it up could give the drive to anybody; and more than a head's second of it is said."""
    since = of(SAMPLES, ChainHeads)[head - seconds] + 1
    forged = [
        msgspec.structs.replace(one, operator="bob") if isinstance(one, Decision) else one
        for one in SAMPLES[: of(SAMPLES, ChainHeads)[head]]
    ]
    samples = begun_at([*forged, *SAMPLES[len(forged) :]], head, since)
    report = verified(tmp_path, log_of(samples))
    assert faults_of(report) == {ProofFault.UNPROVEN}
    assert {one.is_proven for one in report.holders if one.operator == "bob"} == {False}
    assert sum(one.drives for one in report.holders if one.is_proven) == sum(
        isinstance(one, Decision) for one in SAMPLES[len(forged) :]
    )


def test_what_comes_after_the_last_head_proves_no_holder(tmp_path: Path) -> None:
    """For a second it is what the robot had no time to sign; whoever comes with more is not believed either."""
    (last,) = [one for one in SAMPLES if isinstance(one, Decision)][-1:]
    for far_s, faults in ((1.0, set()), (4.0, {ProofFault.UNPROVEN}), (8.0, {ProofFault.MISSING})):
        forged = [
            msgspec.structs.replace(
                last, operator="bob", lease=99, sequence=last.sequence + 1 + n, time_ns=RUN.time_ns + at_ns
            )
            for n, at_ns in enumerate((S // 2, int(far_s * S)))
        ]
        report = verified(tmp_path, log_of([*SAMPLES, *forged]))
        assert faults_of(report) == faults
        assert [(one.operator, one.is_proven) for one in report.holders] == [("ann", True), ("bob", False)]


def test_a_verb_before_the_first_head_is_marked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its operator signed it at some time; that the robot accepted it then, nothing shows."""
    log = str(saved(tmp_path / "log.mcap", log_of(begun_at(SAMPLES, 3, of(SAMPLES, ChainHeads)[1]))))
    assert review("verify", log, "--authority", str(authority_file(tmp_path))) == 3
    said = capsys.readouterr().out
    assert "holds; nothing proves it" in said
    report = verified_files([Path(log)], FLEET.trust)
    assert [(one.holds, one.is_proven) for one in report.verbs] == [(True, False)] * 2
    assert [(one.is_proven, bool(one.grant)) for one in report.holders] == [(False, True), (True, False)]


@pytest.mark.parametrize("kind", [Decision, SafetyEvent])
@pytest.mark.parametrize("seconds", [1, 2, 60])
def test_the_first_second_of_a_subject_cannot_be_left_out(
    tmp_path: Path, kind: type[Message], seconds: int
) -> None:
    """A head from before it says that there was none yet."""
    run = SignedRun(FLEET)
    run.seconds(seconds, quiet=True)
    place = len(run.samples)
    run.seconds(2)
    assert verified(tmp_path, log_of(run.samples)).is_proven
    end = of(run.samples, ChainHeads)[-2]
    kept = [one for at, one in enumerate(run.samples) if not (place <= at < end and isinstance(one, kind))]
    report = verified(tmp_path, log_of(kept))
    assert faults_of(report) == {ProofFault.MISSING}


def test_heads_that_nobody_vouches_for_prove_no_holder(tmp_path: Path) -> None:
    """Without the robot's grant anybody may have signed them."""
    report = verified(tmp_path, log_of([one for one in SAMPLES if not isinstance(one, SignedStatement)]))
    assert ProofFault.UNPROVEN in faults_of(report)
    assert {one.is_proven for one in report.holders} == {one.is_proven for one in report.verbs} == {False}


@pytest.mark.parametrize("dropped", [(Journal,), (Decision,), (SafetyEvent,), (Journal, Decision, SafetyEvent)])
def test_a_log_that_was_gutted_between_its_heads_does_not_pass_for_one_that_begins_later(
    tmp_path: Path, dropped: tuple[type[Message], ...]
) -> None:
    """The heads say how many there were. Only at the first of them a log may begin in mid-run."""
    kept = [one for one in SAMPLES if not isinstance(one, dropped)]
    assert ProofFault.MISSING in faults_of(verified(tmp_path, log_of(kept)))


def test_a_log_without_the_first_sample_after_each_head_does_not_pass_for_one_that_begins_later(
    tmp_path: Path,
) -> None:
    """What is left could have been changed: no proof goes through the gap."""
    heads = of(SAMPLES, ChainHeads)
    journal = of(SAMPLES, Journal)
    firsts = {next((place for place in journal if place > head), -1) for head in (-1, *heads)}
    kept = [one for place, one in enumerate(SAMPLES) if place not in firsts]
    assert ProofFault.MISSING in faults_of(verified(tmp_path, log_of(kept)))


@pytest.mark.parametrize("kind", CHAINED_KINDS)
@pytest.mark.parametrize("gone", [slice(0, 1), slice(0, None)])
def test_behind_the_first_head_nothing_is_left_out_of_what_was_there_before_it(
    tmp_path: Path, kind: type[Message], gone: slice
) -> None:
    """A log that begins in mid-run, with samples of before its first head, lacks none until the second."""
    heads = of(SAMPLES, ChainHeads)
    told = [SAMPLES[place] for place in of(SAMPLES, SignedStatement)]
    begin = heads[3] - 9
    dropped = [place - begin for place in of(SAMPLES, kind) if heads[3] < place < heads[4]][gone]
    assert verified(tmp_path / "whole", log_of([*told, *SAMPLES[begin:]])).is_proven
    report = verified(tmp_path, log_of([*told, *without(SAMPLES[begin:], *dropped)]))
    assert faults_of(report) == {ProofFault.MISSING}
    assert report.runs[0].subjects[BY_TYPE[kind].name].missing == len(dropped)


@pytest.mark.parametrize("kind", CHAINED_KINDS)
@pytest.mark.parametrize("seconds", [1, 2])
def test_a_subject_that_begins_behind_the_first_head_cannot_be_told_to_be_whole(
    tmp_path: Path, kind: type[Message], seconds: int
) -> None:
    """A recorder may have been linked with it so late, or somebody took the first ones out."""
    heads = of(SAMPLES, ChainHeads)
    told = [SAMPLES[place] for place in of(SAMPLES, SignedStatement)]
    kept = [
        one
        for place, one in enumerate(SAMPLES)
        if place >= heads[2] and not (isinstance(one, kind) and place < heads[2 + seconds])
    ]
    report = verified(tmp_path, log_of([*told, *kept]))
    assert faults_of(report) == {ProofFault.UNPROVEN}
    assert "behind the first head" in words_of(report)
    assert not report.is_proven


def test_a_head_alone_proves_nothing_of_what_stands_beside_it(tmp_path: Path) -> None:
    """Anybody who has one could put samples around it."""
    head = of(SAMPLES, ChainHeads)[3]
    last = [one for one in SAMPLES[:head] if isinstance(one, Decision)][-1]
    place = {"sequence": last.sequence + 1, "time_ns": SAMPLES[head].time_ns}
    forged = msgspec.structs.replace(last, operator="bob", **place)
    told = [SAMPLES[place] for place in of(SAMPLES, SignedStatement)]
    report = verified(tmp_path, log_of([*told, SAMPLES[head], forged]))
    assert faults_of(report) == {ProofFault.UNPROVEN}
    assert "no sample stands between two chain heads" in words_of(report)


def test_a_log_that_ends_in_mid_run_has_no_proof_of_its_end_yet(tmp_path: Path) -> None:
    """That is said as well."""
    end = of(SAMPLES, ChainHeads)[4] + 5
    report = verified(tmp_path, log_of(SAMPLES[:end]))
    assert not report.findings
    assert report.runs[0].subjects["journal"].after == 4


def test_several_logs_of_one_run_hold_together(tmp_path: Path) -> None:
    """They are cut anywhere, and read in one go; without the one in the middle something is missing."""
    cuts = [SAMPLES[:40], SAMPLES[40:81], SAMPLES[81:]]
    logs = [log_of(part) for part in cuts]
    assert verified(tmp_path, *logs).is_proven
    assert ProofFault.MISSING in faults_of(verified(tmp_path / "some", logs[0], logs[2]))


def test_samples_that_a_recorder_asked_for_later_count(tmp_path: Path) -> None:
    """They stand behind newer ones in the log."""
    heads = of(SAMPLES, ChainHeads)
    late = [*SAMPLES[heads[2] :], *SAMPLES[: heads[2]]]
    assert verified(tmp_path, log_of(late)).is_proven


def test_a_cut_log_holds(tmp_path: Path) -> None:
    """A part of a log holds from its first head on, as long as it is told the grants."""
    whole = saved(tmp_path / "whole.mcap", log_of(SAMPLES))
    faults = Faults()
    logs = find_logs([whole], faults)
    period = Selection(from_ns=NOW_S * S + 2 * S + S // 2, to_ns=NOW_S * S + 5 * S)
    cut(logs[0], tmp_path / "cut.mcap", period, [], faults)
    assert faults_of(verified_files([tmp_path / "cut.mcap"], FLEET.trust)) == {ProofFault.UNPROVEN}
    told = shown_statements(logs, faults)
    report = verified_files([tmp_path / "cut.mcap"], FLEET.trust, statements=told)
    assert not report.findings
    assert report.runs[0].subjects["journal"].proven == PER_SECOND
    assert not faults


def test_a_run_in_open_mode_has_nothing_to_verify(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It says so, and the exit code is not that of a log that holds."""
    run = SignedRun(FLEET)
    run.seconds(3)
    opened = [one for one in run.samples if type(one) in CHAINED_KINDS]
    path = saved(tmp_path / "open.mcap", log_of(opened))
    report = verified_files([path], None)
    assert report.unsigned_runs == 1
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
    "changes",
    [
        {"robots": ["cruiser-2"]},
        {"verbs": ["acquire"]},
        {"not_after": NOW_S - 1},
        {"not_before": NOW_S + DAY_S // 2},
        {"role": GrantRole.RECORDER},
    ],
)
def test_a_verb_that_its_grant_did_not_allow_is_found(tmp_path: Path, changes: dict[str, Any]) -> None:
    """Though the robot took it."""
    bob = FLEET.operator("bob", **changes)
    credentials = Credentials(Reason.NONE, serial=1)
    report = asked(tmp_path, by=bob, credentials=credentials)
    assert faults_of(report) == {ProofFault.NOT_GRANTED}


def test_a_verb_under_somebody_elses_grant_is_found(tmp_path: Path) -> None:
    """The key expression names another operator than the grant; the holder of the grant signed it so."""
    report = asked(tmp_path, operator="carl", attachment=_signed_for("engage", operator="carl"))
    assert faults_of(report) == {ProofFault.NOT_GRANTED}


@pytest.mark.parametrize(
    "changes", [{"serial": 2}, {"override": True}, {"speed_limit_mps": None}, {"speed_limit_mps": 2.0}]
)
def test_a_robot_that_allowed_more_than_the_grant_is_found(tmp_path: Path, changes: dict[str, Any]) -> None:
    """Role, override and speed limit are the grant's."""
    assert faults_of(asked(tmp_path, credentials=credentials_of(ANN, **changes))) == {ProofFault.NOT_GRANTED}


def test_a_verb_after_its_grant_was_revoked_is_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One before it holds, in the same log, which says that the grant was revoked later."""
    fleet = Fleet()
    run, ann = driven(fleet)
    run.show(fleet.authority.revoke(1, keys=(ann.key,)).text())
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples), trust=fleet.trust)
    assert report.is_proven
    assert {one.name: (one.objection, "by list 1" in one.revoked_later) for one in report.grants} == {
        "ann": ("", True),
        ROBOT: ("", False),
    }
    log = str(tmp_path / "log-0.mcap")
    assert review("verify", log, "--authority", str(authority_file(tmp_path, fleet))) == 0
    assert "held then, and ended later" in capsys.readouterr().out
    run.ask("engage", ann)
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples), trust=fleet.trust)
    assert faults_of(report) == {ProofFault.NOT_GRANTED}
    assert [verb.holds for verb in report.verbs] == [True, True, False]


def test_a_list_of_revocations_that_the_authority_did_not_sign_is_found(tmp_path: Path) -> None:
    """And revokes nothing."""
    run, _ = driven(FLEET, robot=RUN.robot)
    run.show(Party().revoke(1, keys=(ANN.key,)).text())
    run.seconds(1)
    assert faults_of(verified(tmp_path, log_of(run.samples))) == {ProofFault.WRONGLY_SIGNED}


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
    report = verified(tmp_path, log_of(run.samples), trust=fleet.trust)
    assert [(verb.operator, verb.holds) for verb in report.verbs][-1] == ("bob", True)
    assert not [one for one in report.findings if "bob" in one.what]


def test_a_verb_whose_grant_is_not_in_the_log_cannot_be_told(tmp_path: Path) -> None:
    """That is no proof that it was wrong."""
    run, ann = SignedRun(FLEET), FLEET.operator("ann")
    run.ask("acquire", ann)
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples))
    assert faults_of(report) == {ProofFault.UNPROVEN}
    assert not report.is_broken


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


@pytest.mark.parametrize(
    ("after_s", "by", "proven", "left"), [(0, "ann", 2, 0), (4, "ann", 2, 0), (6, "ann", 0, 2), (1, "zoe", 0, 2)]
)
def test_a_stop_that_is_signed_right_after_is_its_operators(
    tmp_path: Path, after_s: int, by: str, proven: int, left: int
) -> None:
    """A stop goes out before its proof can be made; nobody is accused for it. Another's proof is none of it."""
    run, ann = driven(FLEET, robot=RUN.robot)
    for _ in range(2):
        run.ask("stop", ann, operator=by, attachment=b"", credentials=Credentials(Reason.PROOF_MISSING))
    run.seconds(after_s)
    run.ask("stop", ann)
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples))
    assert report.is_proven
    assert sum(one.count for one in report.unproven_stops) == left
    assert (report.verbs[-1].verb, report.verbs[-1].unsigned_before) == ("stop", proven)


@pytest.mark.parametrize(
    ("after_s", "by", "repeats"), [(0, "ann", 3), (4, "ann", 3), (6, "ann", 0), (1, "zoe", 0)]
)
def test_a_stop_that_is_said_again_right_after_it_was_signed_is_counted_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], after_s: int, by: str, repeats: int
) -> None:
    """It is said until the robot is seen to stand. Later ones, and those in another name, are unproven."""
    run, ann = driven(FLEET, robot=RUN.robot)
    run.ask("stop", ann)
    run.seconds(1)
    run.seconds(after_s)
    for _ in range(3):
        run.ask("stop", ann, operator=by, attachment=b"", credentials=Credentials(Reason.PROOF_MISSING))
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples))
    assert report.is_proven
    assert (report.verbs[-1].verb, report.verbs[-1].unsigned_after) == ("stop", repeats)
    assert sum(one.count for one in report.unproven_stops) == 3 - repeats
    assert review("verify", str(tmp_path / "log-0.mcap"), "--authority", str(authority_file(tmp_path))) == 0
    assert ("3 more in this name right after it, unsigned" in capsys.readouterr().out) == bool(repeats)


def test_a_flood_of_unsigned_stops_is_counted(tmp_path: Path) -> None:
    """All of them, whether somebody signs one afterwards or not."""
    run, ann = driven(FLEET, robot=RUN.robot)
    for _ in range(STOPS_WAITING + 50):
        run.ask("stop", ann, attachment=b"", credentials=Credentials(Reason.PROOF_MISSING))
    run.ask("stop", ann)
    run.seconds(1)
    report = verified(tmp_path, log_of(run.samples))
    assert [one.count for one in report.unproven_stops] == [50]
    assert report.verbs[-1].unsigned_before == STOPS_WAITING


def test_a_signed_stop_that_does_not_hold_proves_none(tmp_path: Path) -> None:
    """Its operator is not known then."""
    run, ann = driven(FLEET, robot=RUN.robot)
    run.ask("stop", ann, attachment=b"", credentials=Credentials(Reason.PROOF_MISSING))
    other = ann.prove(keys.command("fleet", ROBOT, "ann", "engage"), BY_VERB["engage"].encoding, b"\x80", bytes(8))
    run.ask("stop", ann, attachment=other)
    run.seconds(1)
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
    log = str(saved(tmp_path / "log.mcap", log_of(SAMPLES)))
    words = ["verify", log, "--authority", str(authority_file(tmp_path))]
    assert review(*words) == 0
    out = capsys.readouterr().out
    assert "all holds" in out
    assert "ann held lease 77" in out
    assert review(*words, "--json") == 0
    assert json.loads(capsys.readouterr().out)["robot_key"] == RUN.robot.key.hex()


def test_the_command_says_that_nobody_vouches(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Where it is not given the authority."""
    assert review("verify", str(saved(tmp_path / "log.mcap", log_of(SAMPLES)))) == 0
    assert "nobody vouches" in capsys.readouterr().out


def test_the_command_names_another_authority_and_the_one_that_was_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 3, as where nothing proves it: a log of before a rotation was not tampered with."""
    log = str(saved(tmp_path / "log.mcap", log_of(SAMPLES)))
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


@pytest.mark.parametrize("kind", CHAINED_KINDS)
def test_what_was_tampered_with_is_found_under_another_authority_too(tmp_path: Path, kind: type[Message]) -> None:
    """The log is held against the authority that it names itself."""
    changed = replaced(SAMPLES, of(SAMPLES, kind)[3], **CHANGES[kind])
    report = verified(tmp_path, log_of(changed), trust=Fleet().trust)
    assert faults_of(report) == {ProofFault.OTHER_AUTHORITY, ProofFault.CHANGED}
    assert report.is_broken


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
    log = str(saved(tmp_path / "log.mcap", whole[: len(whole) * 4 // 5]))
    assert review("verify", log, "--authority", str(authority_file(tmp_path))) == 3
    assert "NOT ALL COULD BE READ" in capsys.readouterr().out.partition("\n")[0]
    assert review("verify", log, "--authority", str(authority_file(tmp_path)), "--json") == 3
    assert json.loads(capsys.readouterr().out)["unread"] == 1


def test_the_command_ends_with_1_for_a_log_that_was_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And says first that it is not as it was signed."""
    changed = replaced(SAMPLES, of(SAMPLES, Decision)[3], operator="bob")
    log = str(saved(tmp_path / "log.mcap", log_of(changed)))
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

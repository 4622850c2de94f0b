"""Logs, run again."""

from collections.abc import Iterable, Iterator
from copy import copy
from functools import cache
from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Message, Schema
from mcap.writer import Writer

from gateway import core
from gateway.rerun import rerun
from recorder.reading.logs import Faults, find_logs
from recorder.reading.survey import CONFIGURATION
from recorder.review.rerun import Rerun, RerunPlayer, RerunResult, rerun_parts
from recorder.review.what_if import TriedSettings, rerun_tasks
from schemas import codec
from schemas.codec import Sample, encode
from schemas.configuration import to_toml
from schemas.decisions import Decision, Journal, Verdict
from schemas.journal import Kind
from schemas.messages import Variant
from schemas.settings import CommandSettings, Settings
from schemas.subjects import BY_NAME
from tests.support.logs import Log, small_log
from tests.support.messages import MS, SECOND, WALL_NS, FakeSample, info, sample_of
from tests.support.rigs.day import Day
from tests.support.rigs.gateway import Operator


@cache
def day_log() -> bytes:
    """The log of some seconds in which much happens."""
    day = Day(1, Variant.COARSE, ticks=1500)
    day.live()
    return day.rig.log()


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The same as a file."""
    path = tmp_path / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(day_log())
    return path


LoggedMessage = tuple[Schema | None, Channel, Message]


def run_again(path: Path, again: Rerun = rerun) -> tuple[list[RerunResult], Faults]:
    """What comes of the logs there."""
    faults = Faults()
    found: list[RerunResult] = []
    for task in rerun_tasks(find_logs([path], faults), TriedSettings(None, "", {}), faults):
        player = RerunPlayer(task.robot, task.logs, task.configurations, faults, lambda _: None)
        found += rerun_parts(player, again)
    return found, faults


def altered(settings: Settings, journals: Iterable[Journal]) -> Iterator[Sample]:
    """An arbiter that refuses what the recorded one accepted, once."""
    done = False
    for sample in rerun(settings, journals):
        if sample.subject == "safety/decision" and not done:
            decision = codec.decode(BY_NAME[sample.subject], sample.payload)
            assert isinstance(decision, Decision)
            if decision.verdict is Verdict.ACCEPTED:
                done = True
                changed = msgspec.structs.replace(decision, verdict=Verdict.REFUSED)
                yield Sample(sample.subject, encode(changed))
                continue
        yield sample


def test_another_decision_is_found_and_told(log: Path) -> None:
    """One among thousands of messages: which, when, what it was and what it is."""
    [result], _ = run_again(log, altered)
    assert result.difference_count == 1
    [difference] = result.differences
    assert difference.subject == "safety/decision"
    assert difference.fields == {"verdict": (Verdict.ACCEPTED, Verdict.REFUSED)}
    assert result.start_ns <= difference.time_ns <= result.end_ns


def test_other_settings_give_other_decisions(log: Path) -> None:
    """The comparison can fail."""

    def slower(settings: Settings, journals: Iterable[Journal]) -> Iterator[Sample]:
        command = msgspec.structs.replace(settings.command, deadman_s=0.1)
        return rerun(msgspec.structs.replace(settings, command=command), journals)

    [result], _ = run_again(log, slower)
    assert result.difference_count > 10


def test_the_settings_are_those_of_the_run(log: Path) -> None:
    """They come from the log, not from this machine."""
    seen: list[Settings] = []

    def watch(settings: Settings, journals: Iterable[Journal]) -> Iterator[Sample]:
        seen.append(settings)
        return rerun(settings, journals)

    run_again(log, watch)
    assert [settings.command.speed_limit_mps for settings in seen] == [1.5]


def test_a_log_in_two_files_is_one_run(tmp_path: Path, log: Path) -> None:
    """The second alone is the rest of it, and has no place to begin if the gateway was never at rest."""
    first, second = split(log, tmp_path / "halves")
    [result], _ = run_again(first.parent)
    assert (result.detail, result.difference_count) == ("", 0)
    [late], _ = run_again(second)
    assert late.first == early_inputs(first)
    assert late.same == {}
    assert "are missing; it holds no checkpoint of this version, and the gateway was never at rest" in late.detail
    [early], _ = run_again(first)
    assert 0 < early.inputs < result.inputs
    assert early.difference_count == 0


def test_a_file_alone_is_run_again_from_where_the_gateway_was_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its beginning is lost with the file before, and all that was done later comes out the same."""
    monkeypatch.setattr(core, "REST_PERIOD_NS", 1_000_000_000)
    day = Day(1, Variant.COARSE, ticks=0)
    rig = day.rig
    rig.run(12)
    operator = Operator(rig)
    operator.engage()
    operator.drive(1.0, 5.0, 2.0)
    operator.ask("disengage")
    rig.run(10)
    operator.take_lease()
    operator.engage()
    operator.drive(-0.5, 0.0, 2.0)
    rig.run(5)
    log = tmp_path / "cruiser-1-20260102T030405Z.mcap"
    log.write_bytes(day.rig.log())
    _, second = split(log, tmp_path / "halves")
    [result], _ = run_again(second)
    assert result.first > 0
    assert "are missing" in result.detail
    assert result.difference_count == 0
    assert result.same["safety/decision"] > 90
    assert result.same["can/{bus}/tx"] > 1000
    [whole], _ = run_again(log)
    assert whole.same["can/{bus}/tx"] > result.same["can/{bus}/tx"]


def test_what_two_recorders_wrote_is_compared_once(log: Path) -> None:
    """A second copy of a frame or of a decision is no other one."""
    log.with_name("depot-20260102T030405Z.mcap").write_bytes(log.read_bytes())
    [result], faults = run_again(log.parent)
    assert not faults
    assert (result.difference_count, result.detail) == (0, "")


def said_journal(run: int, inputs: bytes, time_ns: int) -> FakeSample:
    """A journal of one message."""
    message = Journal(time_ns, 0, run=run, first=0, count=1, inputs=inputs)
    return sample_of(message)  # type: ignore[return-value]


SHUT_DOWN = msgspec.msgpack.encode([[Kind.SHUT_DOWN, 1]])


def test_each_run_has_the_configuration_that_its_gateway_told(tmp_path: Path) -> None:
    """A recorder attaches a configuration only when it has changed; the next run's is not this one's."""
    log = Log()
    begins = [(1, WALL_NS, 0.5), (2, WALL_NS + 5 * SECOND, 0.5), (3, WALL_NS + 9 * SECOND, 1.0)]
    for number, (run, time_ns, limit_mps) in enumerate(begins):
        text = to_toml(Settings(command=CommandSettings(speed_limit_mps=limit_mps)))
        answer = msgspec.structs.replace(info(sequence=number), started_ns=time_ns - MS, configuration=text)
        log.receive(said_journal(run, SHUT_DOWN, time_ns), sample_of(answer), wall_ns=time_ns)
    path = tmp_path / "log.mcap"
    path.write_bytes(log.close())
    seen: list[float] = []

    def watch(settings: Settings, journals: Iterable[Journal]) -> Iterator[Sample]:
        seen.append(settings.command.speed_limit_mps)
        return rerun(settings, journals)

    run_again(path, watch)
    assert seen == [0.5, 0.5, 1.0]


@pytest.mark.parametrize(
    "inputs", [b"\xc1", b"\x05", msgspec.msgpack.encode([[99, 1]]), msgspec.msgpack.encode([[Kind.TICK, 1]])]
)
def test_a_journal_that_makes_no_sense_ends_its_part(tmp_path: Path, inputs: bytes) -> None:
    """Another version wrote it, or it was damaged: a fault, and the next run is run again all the same."""
    log = Log()
    log.receive(sample_of(info()), said_journal(1, inputs, WALL_NS), said_journal(2, SHUT_DOWN, WALL_NS + SECOND))
    path = tmp_path / "log.mcap"
    path.write_bytes(log.close())
    results, faults = run_again(path)
    assert [result.run for result in results] == [1, 2]
    assert "cannot be run again" in results[0].detail
    assert "cannot be run again" not in results[1].detail
    assert faults.count == 1


def early_inputs(first: Path) -> int:
    """How many inputs the first of the files holds."""
    return run_again(first)[0][0].inputs


def split(log: Path, directory: Path) -> tuple[Path, Path]:
    """The log in two files, by the half of its messages."""
    directory.mkdir()
    paths = (directory / "cruiser-1-20260102T030405Z.mcap", directory / "cruiser-1-20260102T030410Z.mcap")
    messages, attachments = read(log)
    half = len(messages) // 2
    for path, part, begins in ((paths[0], messages[:half], 0), (paths[1], messages[half:], half)):
        write(path, part, attachments, begins)
    return paths


def read(log: Path) -> tuple[list[LoggedMessage], list[Attachment]]:
    """Messages, with schema and channel, and attachments."""
    with log.open("rb") as stream:
        reader = make_reader(stream)
        return list(reader.iter_messages(log_time_order=False)), list(reader.iter_attachments())


def write(
    path: Path, messages: Iterable[LoggedMessage], attachments: Iterable[Attachment], begins: int = 0
) -> None:
    """A log of these."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        ids: dict[int, int] = {}
        for one in attachments:
            writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
        for number, (schema, channel, message) in enumerate(messages, start=begins):
            assert schema is not None
            if channel.id not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            # In this log all times of receipt are the same.
            log_ns = message.log_time + number
            writer.add_message(ids[channel.id], log_ns, message.data, message.publish_time, message.sequence)
        writer.finish()


@pytest.mark.parametrize("topic", ["can/can0/rx", "can/can0/tx", "safety/state", "safety/event"])
@pytest.mark.parametrize("is_put_in", [True, False])
def test_what_was_changed_or_put_in_is_a_difference(
    tmp_path: Path, log: Path, topic: str, *, is_put_in: bool
) -> None:
    """Whatever the journal says otherwise."""
    messages, attachments = read(log)
    [*places] = (place for place, one in enumerate(messages) if one[1].topic.endswith(topic))
    place = places[len(places) // 2]
    schema, channel, message = messages[place]
    forged = copy(message)
    forged.data = message.data[:-1] + bytes([message.data[-1] ^ 1])
    messages[place : place + (not is_put_in)] = [(schema, channel, forged)]
    write(changed := tmp_path / "changed.mcap", messages, attachments)
    [result], _ = run_again(changed)
    assert result.difference_count > 0
    assert result.differences[0].subject.rpartition("/")[2] == topic.rpartition("/")[2]


@pytest.mark.parametrize("subject", ["can/{bus}/rx", "safety/state"])
def test_a_subject_that_is_not_in_the_log_is_told_and_no_difference(
    tmp_path: Path, log: Path, subject: str
) -> None:
    """A log need not hold the received frames; whoever takes all states out of one is told of."""
    messages, attachments = read(log)
    write(
        fewer := tmp_path / "fewer.mcap",
        (one for one in messages if not one[1].topic.endswith(subject.format(bus="can0"))),
        attachments,
    )
    [result], _ = run_again(fewer)
    assert (list(result.unrecorded), result.difference_count) == ([subject], 0)
    assert result.unrecorded[subject] > 100


def test_a_log_without_a_configuration_is_not_run_with_another(log: Path) -> None:
    """Start values would give decisions that nobody made."""
    data = day_log().replace(CONFIGURATION.encode(), CONFIGURATION.replace("f", "g").encode())
    log.write_bytes(data)
    [result], _ = run_again(log)
    assert (result.inputs, result.detail) == (0, "the log does not hold the robot's configuration")


def test_robots_of_one_name_under_two_roots_are_run_each(log: Path) -> None:
    """Each by itself, with the name and the root."""
    other = log.with_name("other.mcap")
    other.write_bytes(day_log().replace(b"fleet/", b"depot/"))
    found = [(one.robot, one.difference_count, one.detail) for one in run_again(log.parent)[0]]
    assert found == [("depot/cruiser-1", 0, ""), ("fleet/cruiser-1", 0, "")]


def test_a_log_without_a_journal_has_nothing_to_run(tmp_path: Path) -> None:
    """Nor any result."""
    path = tmp_path / "log.mcap"
    path.write_bytes(small_log())
    assert run_again(path)[0] == []

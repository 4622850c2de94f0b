"""Segments of a log run again, each by itself."""

import dataclasses
import pickle
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import cache
from io import BytesIO
from pathlib import Path
from random import Random
from typing import Any, Final

import msgspec
import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.writer import CompressionType, Writer

from gateway import core
from recorder.encoding.transcode import compile_encoder
from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.reading.topics import typed_decoder
from recorder.review.rerun import parallel as parallel_module
from recorder.review.rerun.parallel import (
    RerunTask,
    join,
    rerun_in,
    rerun_in_parallel,
)
from recorder.review.rerun.player import RerunResult, rerun_logs
from recorder.review.rerun.segments import WHOLE, Plan, RunSegment
from recorder.review.rerun.tapes import PartEnd
from schemas.decisions import Decision, Journal, Verdict
from schemas.messages import Variant
from tests.support.messages import MS, SECOND
from tests.support.nights import by_night
from tests.support.rigs.day import Day, restful_day

LENGTH_NS: Final = 5 * SECOND
DRIVEN_NS: Final = 1_700_000_034_200_000_000
"""Somebody drives then."""
NAME = "cruiser-1-20260102T030405Z.mcap"


@cache
def day_log() -> bytes:
    """A day in which the robot is now driven and now at rest."""
    return restful_day(1, rounds=2).rig.log(lag_ns=MS)


def alone(path: Path) -> tuple[list[RerunResult], set[str]]:
    """What one process gives, and what it found to be wrong."""
    faults = Faults()
    return list(rerun_logs(find_logs([path], faults), faults)), set(faults.told)


class Here(Executor):
    """Does each task at once, in this process; counts them."""

    def __init__(self) -> None:
        self.tasks: list[RerunTask] = []

    def submit(self, act: Callable[..., Any], /, *words: Any, **_: Any) -> Future[Any]:  # noqa: ANN401 - as of an Executor
        self.tasks.append(words[0])
        future = Future[Any]()
        # What goes to a process and comes back from it can be sent there.
        future.set_result(pickle.loads(pickle.dumps(act(*pickle.loads(pickle.dumps(words))))))  # noqa: S301 - our own
        return future


def in_parallel(path: Path) -> tuple[list[RerunResult], set[str], list[RerunTask]]:
    """What the segments give together, what they found to be wrong, and what was done."""
    faults = Faults()
    pool = Here()
    results = list(rerun_in(pool, find_logs([path], faults), faults, LENGTH_NS))
    return results, set(faults.told), pool.tasks


class Change:
    """What happens to a log: each function takes a message, and returns what is written in its place."""

    def __init__(self, seed: int) -> None:
        self.random = Random(seed)  # noqa: S311 - the same ones each time
        self.end_ns = DRIVEN_NS + seed * 17 * MS

    def nothing(self, topic: str, message: Message) -> list[Message]:  # noqa: ARG002 - as all
        return [message]

    def other_decisions(self, topic: str, message: Message) -> list[Message]:
        if topic.endswith("safety/decision") and self.random.random() < 0.1:
            decision = typed_decoder(Decision)(message.data)
            assert isinstance(decision, Decision)
            decision = msgspec.structs.replace(decision, verdict=Verdict.REFUSED, operator="otherwise")
            return [_with(message, data=DECISION(decision))]
        return [message]

    def losses(self, topic: str, message: Message) -> list[Message]:
        """And states that nobody made."""
        if topic.endswith("safety/state") and self.random.random() < 0.05:
            return [message, _with(message, sequence=message.sequence + 1_000_000)]
        is_lost = "journal" not in topic and self.random.random() < 0.1
        return [] if is_lost else [message]

    def gaps(self, topic: str, message: Message) -> list[Message]:
        is_lost = topic.endswith("journal") and self.random.random() < 0.003
        return [] if is_lost else [message]

    def latecomers(self, topic: str, message: Message) -> list[Message]:  # noqa: ARG002 - as all
        """And second copies."""
        late_ns = 3 * SECOND if self.random.random() < 0.05 else 0
        return [_with(message, log_time=message.log_time + late_ns), _with(message, log_time=message.log_time + 2)]

    def ends(self, topic: str, message: Message) -> list[Message]:  # noqa: ARG002 - as all
        """In the midst of a drive: what is in a batch then is not in the log."""
        return [message] if message.publish_time < self.end_ns else []

    def nonsense(self, topic: str, message: Message) -> list[Message]:
        """Only whoever gives it to a core sees that it is none."""
        if topic.endswith("journal") and self.random.random() < 0.003:
            journal = typed_decoder(Journal)(message.data)
            assert isinstance(journal, Journal)
            inputs = msgspec.msgpack.encode([[99, 1]] * journal.count)
            return [_with(message, data=JOURNAL(msgspec.structs.replace(journal, inputs=inputs)))]
        return [message]


DECISION, JOURNAL = compile_encoder(Decision), compile_encoder(Journal)


def _with(message: Message, **changes: Any) -> Message:  # noqa: ANN401 - whatever a message has
    return dataclasses.replace(message, **changes)


def changed(path: Path, change: Callable[[str, Message], list[Message]]) -> Path:
    """The day's log, changed."""
    reader = make_reader(BytesIO(day_log()))
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        ids: dict[int, int] = {}
        for kept in reader.iter_attachments():
            writer.add_attachment(kept.create_time, kept.log_time, kept.name, kept.media_type, kept.data)
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.id not in ids:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            for one in change(channel.topic, message):
                writer.add_message(ids[channel.id], one.log_time, one.data, one.publish_time, one.sequence)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "name",
    ["nonsense", *map(by_night, ["losses", "gaps", "nothing", "other_decisions", "latecomers"])],
)
def test_the_answer_is_the_one_that_a_single_process_gives(name: str, tmp_path: Path) -> None:
    """Whatever is in the log, with the same differences, counts and faults."""
    path = changed(tmp_path / NAME, getattr(Change(1), name))
    results, faults, tasks = in_parallel(path)
    assert (results, faults) == alone(path)
    # Where the segments do not fit together all is done once more, in one piece.
    assert len(tasks) > 2
    assert (tasks[-1].segment == WHOLE) == (name == "nonsense")


@pytest.mark.parametrize("seed", [0, by_night(1), by_night(2)])
def test_a_log_that_ends_in_a_drive_has_the_same_end(seed: int, tmp_path: Path) -> None:
    """To the last frame that came out of the inputs."""
    path = changed(tmp_path / NAME, Change(seed).ends)
    results, _, tasks = in_parallel(path)
    assert results == alone(path)[0]
    assert len(tasks) > 1


def test_a_robot_that_never_rests_is_cut_at_its_checkpoints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the midst of drives and stops; the answer is the one that a single process gives."""
    monkeypatch.setattr(core, "CHECKPOINT_PERIOD_NS", 2 * SECOND)
    monkeypatch.setattr(core, "REST_PERIOD_NS", 3600 * SECOND)
    day = Day(4, Variant.COARSE, ticks=2500)
    day.live()
    path = tmp_path / NAME
    path.write_bytes(day.rig.log(lag_ns=MS))
    results, faults, tasks = in_parallel(path)
    assert (results, faults) == alone(path)
    assert [(one.difference_count, one.detail) for one in results] == [(0, "")]
    assert len(tasks) > 3
    assert all(task.segment != WHOLE for task in tasks)


def test_a_short_log_of_one_robot_needs_no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would take longer."""
    monkeypatch.setattr(parallel_module, "processes", None)
    change = Change(0)
    change.end_ns = DRIVEN_NS - 20 * SECOND
    path = changed(tmp_path / NAME, change.ends)
    faults = Faults()
    [run] = rerun_in_parallel(find_logs([path], faults), faults, 2)
    assert [run] == alone(path)[0]
    assert run.inputs


def result(run: int = 1, start_s: int = 0, end_s: int = 100, **more: Any) -> RerunResult:  # noqa: ANN401 - its fields
    """What came of a run."""
    fields = {"first": 0, "inputs": 5, "detail": "", "same": {"a": 1}, "unrecorded": {}, "given_up": 0, **more}
    return RerunResult(
        robot="a",
        run=run,
        start_ns=start_s * SECOND,
        end_ns=end_s * SECOND,
        difference_count=0,
        differences=[],
        **fields,
    )


CUT = Plan([PartEnd(1, 0, 9, "")], [RunSegment(to_ns=50 * SECOND), RunSegment(from_ns=50 * SECOND)])


def test_segments_that_fit_together_are_one_run() -> None:
    """From the first one's begin to the last one's end, with all inputs; what overlaps counts once."""
    before, behind = result(start_s=1, end_s=52), result(start_s=48, first=7, detail="inputs 0 to 6 are missing")
    [joined] = join(CUT, [[before], [behind]]) or []
    assert joined == result(start_s=1, end_s=100, inputs=9, same={"a": 2})


@pytest.mark.parametrize(
    ("before", "behind"),
    [
        ([result(end_s=49)], [result(start_s=48)]),
        ([result(end_s=52)], [result(start_s=51)]),
        ([result(end_s=52)], [result(start_s=0)]),
        ([result(end_s=52)], [result(run=2, start_s=48)]),
        ([result(end_s=52)], [result(start_s=48), result(run=2)]),
        ([result(end_s=52, first=1)], [result(start_s=48)]),
        ([result(end_s=52)], [result(start_s=48, detail="the inputs that follow cannot be run again: why")]),
        ([result(end_s=52)], []),
        ([], [result(start_s=48)]),
    ],
)
def test_segments_that_do_not_fit_are_not_put_together(
    before: list[RerunResult], behind: list[RerunResult]
) -> None:
    """One ended too early or began too late, is of another run, or something came that was not looked for."""
    assert join(CUT, [before, behind]) is None

"""Logs, run again."""

from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from gateway import core
from gateway.rerun import rerun
from gateway.telemetry.sample import Sample
from recorder.review.faults import Faults
from recorder.review.logs import find_logs
from recorder.review.rerun import CONFIGURATION, Rerun, RerunResult, installed, rerun_logs, settings_from
from schemas import codec
from schemas.codec import encode
from schemas.decisions import Decision, Journal, Verdict
from schemas.exit_codes import CommandError
from schemas.messages import Variant
from schemas.settings import Settings
from schemas.subjects import BY_NAME
from tests.gateway.command.loop_rig import Operator
from tests.gateway.recorded_day import Day, recorded
from tests.recorder.fakes import small_log


@cache
def day_log() -> bytes:
    """The log of some seconds in which much happens."""
    day = Day(1, Variant.COARSE, ticks=1500)
    day.live()
    return recorded(day)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The same as a file."""
    path = tmp_path / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(day_log())
    return path


def run_again(path: Path, again: Rerun | None = None) -> tuple[list[RerunResult], Faults]:
    """What comes of the logs there."""
    faults = Faults()
    return list(rerun_logs(find_logs([path], faults), faults, rerun=again)), faults


def test_all_comes_out_byte_for_byte(log: Path) -> None:
    """Decisions, events, states and sent frames; by the arbiter that is installed."""
    [result], faults = run_again(log)
    assert not faults
    assert (result.robot, result.detail, result.difference_count) == ("cruiser-1", "", 0)
    assert min(result.same.values()) > 10
    assert set(result.same) == {"safety/decision", "safety/event", "safety/state", "can/{bus}/tx"}
    assert 10e9 < result.end_ns - result.start_ns < 20e9


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
    faults = Faults()
    logs = find_logs([log], faults)

    def slower(text: str) -> Settings:
        settings = settings_from(text)
        return msgspec.structs.replace(settings, command=msgspec.structs.replace(settings.command, deadman_s=0.1))

    [result] = rerun_logs(logs, faults, settings_of=slower)
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
    assert "are missing; the gateway was never at rest" in late.detail
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
    log.write_bytes(recorded(day))
    _, second = split(log, tmp_path / "halves")
    [result], _ = run_again(second)
    assert result.first > 0
    assert "are missing" in result.detail
    assert result.difference_count == 0
    assert result.same["safety/decision"] > 90
    assert result.same["can/{bus}/tx"] > 1000
    [whole], _ = run_again(log)
    assert whole.same["can/{bus}/tx"] > result.same["can/{bus}/tx"]


def early_inputs(first: Path) -> int:
    """How many inputs the first of the files holds."""
    return run_again(first)[0][0].inputs


def split(log: Path, directory: Path) -> tuple[Path, Path]:
    """The log in two files, by the half of its messages."""
    directory.mkdir()
    paths = (directory / "cruiser-1-20260102T030405Z.mcap", directory / "cruiser-1-20260102T030410Z.mcap")
    with log.open("rb") as stream:
        reader = make_reader(stream)
        messages = list(reader.iter_messages(log_time_order=False))
        attachments = list(reader.iter_attachments())
    half = len(messages) // 2
    for path, part, begins in ((paths[0], messages[:half], 0), (paths[1], messages[half:], half)):
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            ids: dict[int, int] = {}
            for one in attachments:
                writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, one.data)
            for number, (schema, channel, message) in enumerate(part, start=begins):
                assert schema is not None
                if channel.id not in ids:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                    ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
                # In this log all times of receipt are the same.
                log_ns = message.log_time + number
                writer.add_message(ids[channel.id], log_ns, message.data, message.publish_time, message.sequence)
            writer.finish()
    return paths


def test_a_log_without_a_configuration_is_not_run_with_another(log: Path) -> None:
    """Start values would give decisions that nobody made."""
    data = day_log().replace(CONFIGURATION.encode(), CONFIGURATION.replace("f", "g").encode())
    log.write_bytes(data)
    [result], _ = run_again(log)
    assert (result.inputs, result.detail) == (0, "the log does not hold the robot's configuration")


def test_a_log_without_a_journal_has_nothing_to_run(tmp_path: Path) -> None:
    """Nor any result."""
    path = tmp_path / "log.mcap"
    path.write_bytes(small_log())
    assert run_again(path)[0] == []


def test_what_is_not_installed_is_one_clear_error() -> None:
    """A recorder alone cannot run anything again."""
    with pytest.raises(CommandError, match="no gateway is installed"):
        installed("no-such-entry")

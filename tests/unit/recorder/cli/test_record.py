"""``cruiser record`` before it records: flags, name, plan, SIGHUP; and its output."""

import os
import pkgutil
import signal
from collections.abc import Iterator
from pkgutil import resolve_name

import pytest

from gateway.cli import main
from recorder.cli import record, remote
from recorder.cli.remote import describe
from recorder.loop import Recorded
from recorder.record.accounting import KeyReport
from schemas.command_line import CommandError, ExitCode
from schemas.recording import RecorderReply, RecorderState
from schemas.settings import RecorderSettings, Settings, ZenohSettings
from tests.support.messages import recorder_health


def test_a_reply_reads_like_a_sentence() -> None:
    reply = RecorderReply(ok=False, detail="why", files=["a.mcap"], health=recorder_health(RecorderState.FULL))
    assert describe("depot", "mark", reply) == "depot: refused: why\n  a.mcap"
    text = describe("depot", "status", reply)
    assert text.startswith("depot: refused: why\n  a.mcap\n  in this state for 1 s, running for 2 s, version 1\n")
    assert "0.0 MB of logs, 0.0 MB of them incidents, 0.0 MB free" in text
    assert "dropped: none" in text


@pytest.mark.parametrize(
    ("shard", "zenoh", "lease_ms"),
    [
        ("", ZenohSettings(), 1000),
        ("2/4", ZenohSettings(), 5000),
        ("2/4", ZenohSettings(lease_ms=300, given=frozenset({"lease_ms"})), 300),
        ("2/4", ZenohSettings(lease_ms=1000, given=frozenset({"lease_ms"})), 1000),
    ],
)
def test_a_shard_has_patience_with_its_router_unless_a_setting_says_otherwise(
    shard: str, zenoh: ZenohSettings, lease_ms: int
) -> None:
    settings = record.with_shard_lease(Settings(recorder=RecorderSettings(shard=shard), zenoh=zenoh))
    assert settings.zenoh.lease_ms == lease_ms
    assert settings.zenoh.given == zenoh.given


@pytest.mark.parametrize(("budget", "ring"), [(0, 9000), (40_000, 9000), (20_000, 5000)])
def test_an_incident_does_not_begin_with_more_than_a_part_of_the_budget(budget: int, ring: int) -> None:
    settings = Settings(recorder=RecorderSettings(budget_bytes=budget, incident_ring_bytes=9000))
    assert record.recorder_plan(settings, "depot", ["fleet/**"], "1").ring_bytes == ring


@pytest.mark.parametrize(
    ("expressions", "name"),
    [
        (["fleet/cruiser-1/**"], "cruiser-1"),
        (["fleet/cruiser-1/state", "fleet/cruiser-1/chassis/*"], "cruiser-1"),
        (["fleet/cruiser-1"], "cruiser-1"),
        (["fleet/cruiser-1/**", "fleet/cruiser-2/**"], "fleet"),
        (["fleet/**"], "fleet"),
        (["fleet/*/state"], "fleet"),
        (["fleet/cr$*/state"], "fleet"),
        (["other/cruiser-1/**"], "fleet"),
    ],
)
def test_a_logs_name_begins_with_its_robot(expressions: list[str], name: str) -> None:
    assert record.log_name("fleet", expressions) == name


class ReachedError(Exception):
    """Start-up has reached this point."""


@pytest.fixture
def hangup() -> Iterator[None]:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("hangup")
def test_a_hangup_ends_no_recorder_that_is_only_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGHUP is handled before anything is opened or imported."""

    def connect(*_: object) -> None:
        assert callable(signal.getsignal(signal.SIGHUP))
        raise ReachedError

    def import_late(name: str) -> object:
        assert callable(signal.getsignal(signal.SIGHUP))
        os.kill(os.getpid(), signal.SIGHUP)
        return resolve_name(name)

    monkeypatch.setattr(record, "ZenohSource", connect)
    monkeypatch.setattr(pkgutil, "resolve_name", import_late)
    with pytest.raises(ReachedError):
        main.main(["record"])


@pytest.mark.usefixtures("hangup")
@pytest.mark.parametrize("before", [signal.SIG_DFL, signal.SIG_IGN])
def test_a_hangup_ends_who_only_asks_a_recorder(monkeypatch: pytest.MonkeyPatch, before: signal.Handlers) -> None:
    """As any other command, except under nohup."""
    signal.signal(signal.SIGHUP, before)
    found: list[object] = []

    def ask(*_: object) -> int:
        found.append(signal.getsignal(signal.SIGHUP))
        return 0

    monkeypatch.setattr(remote, "run", ask)
    assert main.main(["record", "status"]) == 0
    assert found == [before]


@pytest.mark.parametrize(("unfinished", "code"), [(0, ExitCode.OK), (1, ExitCode.PARTIAL)])
def test_that_a_file_is_not_whole_is_no_success(
    capsys: pytest.CaptureFixture[str], unfinished: int, code: ExitCode
) -> None:
    """Nothing is lost, but the file needs recovery."""
    keys = {"fleet/cruiser-1/key": KeyReport(received=1, written=1)}
    recorded = Recorded("a.mcap", 1, 1, 0, 0, 0, 0, 0, 0, 100, 1, 0, keys, unfinished=unfinished)
    assert record._report(recorded, as_json=False) == code
    assert ("1 files not finished" in capsys.readouterr().err) == bool(unfinished)


def test_why_there_is_no_log_is_said() -> None:
    said = {0: "no sample received", 5: "no log could be written; 5 messages are lost"}
    for received, code in ((0, ExitCode.UNREACHABLE), (5, ExitCode.FAILURE)):
        keys = {"fleet/cruiser-1/key": KeyReport(received=received, lost_full=received)}
        recorded = Recorded(None, 0, 0, received, 0, 0, 0, received, 0, 0, 0, 0, keys)
        with pytest.raises(CommandError, match=said[received]) as error:
            record._report(recorded, as_json=False)
        assert error.value.code is code

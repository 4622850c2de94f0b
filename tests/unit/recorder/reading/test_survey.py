"""What logs hold besides messages."""

from pathlib import Path

import msgspec
import pytest

from recorder.reading import survey as module
from recorder.reading.logs import Faults, find_logs
from recorder.reading.survey import Survey, configurations_of, survey
from recorder.record.robots import METADATA_NAME
from schemas.messages import GatewayInfo
from tests.support.logs import channel_of, encoded, mcap_log, saved, small_log
from tests.support.messages import WALL_NS, info, key_of


def found_in(path: Path) -> tuple[Survey, Faults]:
    faults = Faults()
    return survey(find_logs([path], faults), faults), faults


@pytest.mark.parametrize("cut", [0, 200], ids=["whole", "without its end"])
def test_topics_metadata_and_attachments_are_found(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "log.mcap"
    data = small_log()
    path.write_bytes(data[: len(data) - cut])
    found, faults = found_in(path)
    assert sorted(found.topics) == [
        "fleet/cruiser-1/can/can0/rx",
        "fleet/cruiser-1/chassis/gear",
        "fleet/cruiser-1/gateway/info",
        "fleet/elsewhere",
    ]
    assert found.robots == ["cruiser-1"]
    assert dict(found.metadata)[METADATA_NAME]["robots"] == "cruiser-1"
    names = [one.name for one in found.attachments]
    assert names[:2] == ["cruiser-1/configuration.toml", "cruiser-1/cruiser-coarse.dbc"]
    assert all(name.startswith("cruiser-1/layout.") for name in names[2:])
    assert faults.count == bool(cut)


def test_of_several_logs_all_is_found(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.mcap").write_bytes(small_log())
    faults = Faults()
    logs = find_logs([tmp_path], faults)
    (tmp_path / "a.mcap").unlink()
    found = survey(logs, faults)
    names = [one.name for one in found.attachments]
    assert names.count("cruiser-1/configuration.toml") == 1
    assert faults.count == 1


def test_what_is_kept_of_all_configurations_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TEXTS_MAX", 1000)
    said = [msgspec.structs.replace(info(), started_ns=n, configuration="#" * 100) for n in range(50)]
    rows = [(1, n, WALL_NS + n, WALL_NS + n, encoded(one)) for n, one in enumerate(said)]
    log = mcap_log([channel_of(GatewayInfo, topic=key_of(GatewayInfo))], [rows])
    logs = find_logs([saved(tmp_path / "log.mcap", log)], Faults())
    assert len(configurations_of("cruiser-1", logs, survey(logs, Faults()), Faults()).told) == 10

"""The configurations of a robot's runs."""

from pathlib import Path

import msgspec
import pytest

from recorder.reading import survey as module
from recorder.reading.logs import Faults, find_logs
from recorder.reading.survey import configurations_of, survey
from schemas.messages import GatewayInfo
from tests.support.logs import channel_of, encoded, mcap_log
from tests.support.messages import WALL_NS, info, key_of


def test_what_is_kept_of_all_configurations_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log of some kilobytes could else fill the memory with very many of them, no two of them the same."""
    monkeypatch.setattr(module, "TEXTS_MAX", 1000)
    said = [msgspec.structs.replace(info(), started_ns=n, configuration="#" * 100) for n in range(50)]
    rows = [(1, n, WALL_NS + n, WALL_NS + n, encoded(one)) for n, one in enumerate(said)]
    path = tmp_path / "log.mcap"
    path.write_bytes(mcap_log([channel_of(GatewayInfo, topic=key_of(GatewayInfo))], [rows]))
    logs = find_logs([path], Faults())
    assert len(configurations_of("cruiser-1", logs, survey(logs, Faults()), Faults()).told) == 10

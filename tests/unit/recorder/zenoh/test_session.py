"""How a session is configured."""

import json
from pathlib import Path

import pytest

from recorder.zenoh.session import _configuration
from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import ZenohSettings


def test_a_zenoh_file_gives_what_it_says(tmp_path: Path) -> None:
    """Its endpoints hold where none are given; it says nothing of multicast, so that is off."""
    endpoint = "tcp/127.0.0.1:9"
    path = tmp_path / "zenoh.json5"
    path.write_text(json.dumps({"connect": {"endpoints": [endpoint]}, "mode": "client"}))
    config = _configuration(ZenohSettings(config=str(path)), [])
    assert json.loads(config.get_json("connect/endpoints")) == [endpoint]
    assert config.get_json("scouting/multicast/enabled") == "false"
    assert config.get_json("listen/endpoints") == "[]"
    assert config.get_json("transport/link/tx/batch_size") == "16384"
    path.write_text(json.dumps({"transport": {"link": {"tx": {"batch_size": 30_000}}}}))
    config = _configuration(ZenohSettings(config=str(path)), [])
    assert config.get_json("transport/link/tx/batch_size") == "30000"
    for broken in (tmp_path / "none.json5", tmp_path / "broken.json5"):
        (tmp_path / "broken.json5").write_text("{")
        with pytest.raises(CommandError, match="wrong Zenoh settings") as caught:
            _configuration(ZenohSettings(config=str(broken)), [])
        assert caught.value.code == ExitCode.USAGE

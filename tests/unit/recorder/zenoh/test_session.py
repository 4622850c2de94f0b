"""How a session is configured."""

import json
from pathlib import Path

import pytest

from recorder.zenoh.session import _configuration, key_matches, listens_only
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


def test_only_who_is_told_to_listen_and_nowhere_to_connect_is_apart(tmp_path: Path) -> None:
    """By the settings, or by a Zenoh file; without a word it connects to this machine's gateway."""
    here, there = "tcp/127.0.0.1:9", "tcp/127.0.0.1:10"
    path = tmp_path / "zenoh.json5"
    path.write_text(json.dumps({"connect": {"endpoints": [there]}}))
    assert listens_only(ZenohSettings(listen=[here]))
    assert not listens_only(ZenohSettings())
    assert not listens_only(ZenohSettings(listen=[here], connect=[there]))
    assert not listens_only(ZenohSettings(listen=[here], config=str(path)))
    config = _configuration(ZenohSettings(listen=[here]), [here], is_apart=True)
    assert config.get_json("connect/endpoints") == "[]"
    assert config.get_json("scouting/gossip/enabled") == "false"


@pytest.mark.parametrize(
    ("expression", "topic", "expected"),
    [
        ("fleet/**", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/*/chassis/*", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/cruiser-1/chassis/gear", "fleet/cruiser-1/chassis/gear", True),
        ("fleet/cruiser-2/**", "fleet/cruiser-1/chassis/gear", False),
        ("fleet/**", "fleet/@recorder/depot/health", False),
        ("no//key", "fleet/cruiser-1/chassis/gear", False),
        ("@more", "@more", True),
        ("", "fleet/cruiser-1/chassis/gear", False),
        ("fleet/**", "no//key", False),
    ],
)
def test_keys_match_as_they_do_in_zenoh(expression: str, topic: str, expected: bool) -> None:  # noqa: FBT001 - pytest gives it
    """What is no key expression matches nothing but itself."""
    assert key_matches(expression, topic) == expected

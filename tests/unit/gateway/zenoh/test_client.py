import json
from pathlib import Path

from gateway.zenoh.client import (
    _configuration,
    client_endpoints,
    lease_in_force_ms,
    place,
    said_of,
)
from schemas.configuration import merge
from schemas.settings import DEFAULT_ENDPOINT, ZenohSettings


def test_multicast_is_off_and_nothing_listens_unless_asked() -> None:
    """A session neither scouts by multicast nor listens on any interface by itself."""
    config = _configuration(ZenohSettings(), ["tcp/127.0.0.1:7447"], [])
    assert json.loads(config.get_json("scouting/multicast/enabled")) is False
    assert json.loads(config.get_json("listen/endpoints")) == []


def test_a_zenoh_file_that_says_nothing_of_it_changes_neither(tmp_path: Path) -> None:
    """Multicast stays off unless a Zenoh file asks for it; a command listens on nothing, whatever it says."""
    file = tmp_path / "zenoh.json5"
    file.write_text("{ transport: { link: { tx: { keep_alive: 5 } } } }")
    config = _configuration(ZenohSettings(config=str(file)), [], [])
    assert json.loads(config.get_json("scouting/multicast/enabled")) is False
    assert json.loads(config.get_json("listen/endpoints")) == []
    file.write_text(
        "{ scouting: { multicast: { enabled: true } }, listen: { endpoints: ['tcp/127.0.0.1:7500'] },"
        " connect: { endpoints: ['tcp/127.0.0.1:7501'] } }"
    )
    config = _configuration(ZenohSettings(config=str(file)), [], [])
    assert json.loads(config.get_json("scouting/multicast/enabled")) is True
    assert json.loads(config.get_json("listen/endpoints")) == []
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/127.0.0.1:7501"]
    config = _configuration(ZenohSettings(config=str(file)), ["tcp/127.0.0.1:7502"], [])
    assert json.loads(config.get_json("connect/endpoints")) == ["tcp/127.0.0.1:7502"]


def test_what_a_zenoh_file_says_holds_unless_a_setting_is_given(tmp_path: Path) -> None:
    """Mode, lease and what is no setting of ours are the file's; a given setting wins, as its start value too."""
    file = tmp_path / "zenoh.json5"
    file.write_text(
        "{ mode: 'client', timestamping: { enabled: false },"
        " transport: { link: { tx: { lease: 3000, queue: { size: { data: 4 } } } } } }"
    )
    others = ("timestamping/enabled", "transport/link/tx/queue/size/data")

    def in_force_with(flags: dict[str, object]) -> list[object]:
        settings = merge(None, {"CRUISER_ZENOH_CONFIG": str(file)}, flags).zenoh
        config = _configuration(settings, [], [])
        read = [json.loads(config.get_json(path)) for path in others]
        return [said_of(settings).mode, lease_in_force_ms(settings), *read]

    assert in_force_with({}) == ["client", 3000, False, 4]
    assert in_force_with({"zenoh.mode": "peer", "zenoh.lease_ms": 1000}) == ["peer", 1000, False, 4]
    file.write_text("{}")
    assert in_force_with({}) == ["peer", 1000, True, 8]


def test_a_command_connects_to_this_machine_unless_told_otherwise(tmp_path: Path) -> None:
    """The settings say where to connect, else the Zenoh file, else it is the gateway's own start endpoint."""
    assert client_endpoints(ZenohSettings()) == [DEFAULT_ENDPOINT]
    assert client_endpoints(ZenohSettings(connect=["tcp/127.0.0.1:1"])) == ["tcp/127.0.0.1:1"]
    file = tmp_path / "zenoh.json5"
    file.write_text("{ connect: { endpoints: ['tcp/127.0.0.1:7501'] } }")
    assert client_endpoints(ZenohSettings(config=str(file))) == ["tcp/127.0.0.1:7501"]
    assert place(ZenohSettings(config=str(file))) == "tcp/127.0.0.1:7501"
    file.write_text("{}")
    assert client_endpoints(ZenohSettings(config=str(file))) == [DEFAULT_ENDPOINT]

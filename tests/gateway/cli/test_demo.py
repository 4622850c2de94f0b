"""``cruiser demo``: the whole main job, as a user starts it."""

import json
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from tests.gateway.cli.running import run


def test_the_demo_records_everything(tmp_path: Path) -> None:
    """Three processes; a whole log; no frame lost, no sample missed; the robot was driven by hand in it."""
    done = run(["demo", "--seconds", "4", "--out", str(tmp_path), "--json"])
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["frames_lost"], summary["samples_missed"], summary["whole"]) == (0, 0, True)
    log = Path(summary["path"])
    assert [path.name for path in tmp_path.iterdir()] == [log.name]
    with log.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        states = [message for _, _, _, message in reader.iter_decoded_messages(topics=["fleet/cruiser-1/state"])]
    assert max(state.speed_mps for state in states if state.HasField("speed_mps")) > 0.5
    assert any(state.front_bumper for state in states)


def test_the_demo_is_of_the_robot_that_the_configuration_says(tmp_path: Path) -> None:
    """Chassis, gateway and recorder read the demo's --config: names, variants, all of it."""
    file, out = tmp_path / "robot.toml", tmp_path / "log"
    file.write_text(
        '[robot]\nroot = "yard"\nname = "r-7"\n[can]\nbus = "can7"\n[chassis]\nvariant = "fine"\n'
        '[sim]\nvariant = "fine"\n[recorder]\nchunk_bytes = 2048\n'
    )
    done = run(["demo", "--config", str(file), "--seconds", "2", "--out", str(out), "--json"])
    assert done.returncode == 0, done.stderr
    with Path(json.loads(done.stdout)["path"]).open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        topics = {channel.topic for channel in summary.channels.values()}
        states = [message for _, _, _, message in reader.iter_decoded_messages(topics=["yard/r-7/state"])]
    # The wheel speeds of a chassis that plays the other variant would be evidence against it.
    variants = states[0].DESCRIPTOR.fields_by_name["variant"].enum_type.values_by_number
    assert {variants[state.variant].name for state in states} == {"VARIANT_FINE"}
    assert "yard/r-7/can/can7/rx" in topics
    assert len(summary.chunk_indexes) > 10


def test_the_summary_is_for_people(tmp_path: Path) -> None:
    """Without --json it says frames, messages, losses, the log's path and what opens it."""
    done = run(["demo", "--seconds", "1", "--out", str(tmp_path)])
    assert done.returncode == 0, done.stderr
    assert "0 lost" in done.stdout
    assert str(next(tmp_path.iterdir())) in done.stdout
    for viewer in ("Foxglove", "PlotJuggler", "rerun"):
        assert viewer in done.stdout


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "x"])
def test_a_wrong_time_is_a_matter_of_usage(seconds: str) -> None:
    """Nothing starts."""
    assert run(["demo", "--seconds", seconds]).returncode == 2


def test_a_directory_that_cannot_be_written_is_one_clear_line() -> None:
    """What the recorder says is passed on, with its exit code."""
    done = run(["demo", "--seconds", "1", "--out", "/proc/nowhere"])
    assert done.returncode == 1
    assert len([line for line in done.stderr.splitlines() if line.startswith("cruiser")]) == 1
    assert "/proc/nowhere" in done.stderr

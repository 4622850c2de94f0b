"""A drive of real processes, recorded, and run again from its log alone."""

import signal
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap_protobuf.decoder import DecoderFactory

from gateway.client.robot import Robot
from gateway.journal import reach
from recorder.encoding.protobuf import compile_encoder
from schemas import codec
from schemas.can_word import EXTENDED
from schemas.codec import Sample
from schemas.configuration import TomlSource, merge
from schemas.decisions import Decision, Journal, SafetyEvent
from schemas.messages import Message
from schemas.reasons import Reason
from schemas.subjects import BY_NAME
from tests.support.fakes.peer import free_endpoint
from tests.support.processes.gateway import Running, chassis, gateway
from tests.support.waiting import DEADLINE_S, wait_until
from tests.unit.gateway.test_rerun import ReadBack

SAFETY: dict[str, type[Message]] = {"safety/decision": Decision, "safety/event": SafetyEvent}


def recorder(endpoint: str, directory: Path) -> Running:
    """A recorder of all that the gateway says."""
    return Running("record", "-o", str(directory), "--connect", endpoint)


def drive(endpoint: str) -> None:
    """Engage, drive, stop, reset, and stand by again."""
    settings = merge(TomlSource("", f'[zenoh]\nconnect = ["{endpoint}"]\n'), {}, {})
    with Robot.connect("cruiser-1", settings=settings, timeout_s=DEADLINE_S) as robot, robot.lease() as lease:
        wait_until(lambda: robot.state().state.blocked_by == [Reason.NOT_ENGAGED])
        lease.engage()
        lease.unpark()
        wait_until(
            lambda: abs(robot.state().state.output_speed_mps) > 0.2, lambda: lease.drive(0.4, angle_deg=5.0)
        )
        robot.stop(30)


def close(recording: Running, directory: Path) -> bytes:
    """End a recording; its log."""
    wait_until(lambda: any(directory.glob("*.mcap*")))
    assert recording.stop(signal.SIGINT) == 0, recording.said
    (log,) = (path for path in directory.glob("*.mcap") if ".incident." not in path.name)
    return log.read_bytes()


def check(log: ReadBack) -> list[tuple[int, bytes]]:
    """Run it again: every decision and event of the run is in the log. Returns the frames that it offered."""
    frames: list[tuple[int, bytes]] = []
    samples: list[Sample] = []
    for offered, published in log.run_again():
        frames += [(frame.can_id & ~EXTENDED, frame.data) for frame in offered]
        samples += published
    for name, kind in SAFETY.items():
        encode = compile_encoder(kind)
        again = [
            encode(codec.decode(BY_NAME[name], sample.payload)) for sample in samples if sample.subject == name
        ]
        assert len(again) > 2
        assert sorted(log.records[name], key=again.index) == again, name
    return frames


def is_whole(directory: Path) -> bool:
    """Does the log that is being written hold the whole drive?

    That is a journal from its first input on to the newest, the last decision, and the last event: each comes for
    itself.
    """
    read = defaultdict(list)
    for path in directory.glob("*.part"):
        with path.open("rb") as stream, suppress(McapError):
            reader = NonSeekingReader(stream, decoder_factories=[DecoderFactory()])
            for _, _, _, message in reader.iter_decoded_messages(log_time_order=False):
                read[message.DESCRIPTOR.name].append(message)
    journals = [
        Journal(**{name: getattr(one, name) for name in Journal.__struct_fields__}) for one in read["Journal"]
    ]
    return (
        bool(journals)
        and reach(journals)[journals[-1].run] >= max(one.first + one.count for one in journals)
        and any(one.request == "release" for one in read["Decision"])
        and any(one.text.startswith("stopped: ") for one in read["SafetyEvent"])
    )


def test_a_recorder_that_is_there_first_misses_nothing(tmp_path: Path) -> None:
    """The gateway begins before the two are linked: its journal comes whole, and all frames since then."""
    endpoint = free_endpoint()
    with recorder(endpoint, tmp_path) as recording, chassis() as (_, address):
        recording.wait_says("waiting")
        with gateway(address, endpoint) as running:
            drive(endpoint)
            wait_until(lambda: is_whole(tmp_path))
            assert running.stop() == 0, running.said
        log = ReadBack(close(recording, tmp_path))
    sent = [(identifier, data) for _, identifier, data in log.sent]
    assert len(sent) > 100
    # Raw frames are not kept for who comes late: a busy machine may send the first before they are linked.
    assert check(log)[-len(sent) :] == sent


def test_a_recorder_that_comes_after_the_drive_gets_the_journal_of_before(tmp_path: Path) -> None:
    """And the decisions and events. The frames themselves went by; the journal makes them again."""
    endpoint = free_endpoint()
    with chassis() as (_, address), gateway(address, endpoint):
        drive(endpoint)
        with recorder(endpoint, tmp_path) as recording:
            wait_until(lambda: is_whole(tmp_path))
            log = ReadBack(close(recording, tmp_path))
    assert len(check(log)) > 100

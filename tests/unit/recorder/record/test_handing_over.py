"""A robot that another recorder goes on with, and that comes back."""

from recorder.encoding.key_counters import KeyCounters
from recorder.record.actions import Query
from schemas.decisions import EventKind, SafetyEvent, Severity
from schemas.messages import GatewayInfo
from tests.support.messages import ROBOT, SECOND, gear, info, key_of, safety_event, sample_of
from tests.support.rigs.recorder import GEAR_KEY, RecorderRig, metadata, times


def let_go(bench: RecorderRig) -> None:
    """Another recorder goes on with the robot."""
    bench.writer.apply(bench.recorder.let_go(ROBOT, bench.now_ns))
    bench.run(2 * SECOND)


def receive(bench: RecorderRig, *sequences: int) -> None:
    """So many gears, each 10 ms after the one before."""
    for sequence in sequences:
        bench.receive(sample_of(gear(sequence)))
        bench.run(SECOND // 100)


def test_the_file_ends_and_another_one_begins_when_the_robot_comes_back(bench: RecorderRig) -> None:
    """Each says so, and no message is in both."""
    receive(bench, 1, 2)
    let_go(bench)
    receive(bench, 500, 501)
    bench.close()
    first, second = bench.logs()[ROBOT]
    assert first.is_ended
    assert (len(times(first)), len(times(second))) == (2, 2)
    assert metadata(second, "cruiser.continued")[0]["because"] == "handed over"


def test_what_the_other_recorder_wrote_is_no_loss_here(bench: RecorderRig) -> None:
    """The sequences between are another's; gaps before and after them count as they did."""
    receive(bench, 1, 3)
    let_go(bench)
    receive(bench, 500, 502, 503)
    assert bench.recorder.counts[GEAR_KEY].lost_link == 2
    assert bench.recorder.counts[GEAR_KEY].received == 5


def test_kept_samples_of_the_time_between_are_asked_for_and_no_loss(bench: RecorderRig) -> None:
    """Events hang together in the logs of each recorder, as far back as the gateway keeps them."""
    bench.receive(sample_of(info()))
    bench.receive(sample_of(safety_event(EventKind.LEASE, Severity.INFO)))
    bench.run(10 * SECOND)
    let_go(bench)
    asked = len(bench.writer.asked)
    bench.run(10 * SECOND)
    assert len(bench.writer.asked) == asked
    bench.receive(sample_of(safety_event(EventKind.LEASE, Severity.INFO, sequence=40)))
    bench.run(SECOND // 10)
    key = key_of(SafetyEvent)
    assert Query(key, 1) in bench.writer.asked[asked:]
    assert bench.recorder.counts[key].lost_link == 0


def test_the_gateway_is_asked_again_who_it_is(bench: RecorderRig) -> None:
    """Its configuration may be another one since."""
    bench.receive(sample_of(info()))
    receive(bench, 1)
    let_go(bench)
    bench.run(60 * SECOND)
    asked = len(bench.writer.asked)
    receive(bench, 500)
    bench.run(5 * SECOND)
    assert key_of(GatewayInfo) in [query.key for query in bench.writer.asked[asked:]]


def test_frames_that_were_lost_on_the_bus_meanwhile_are_the_others() -> None:
    """The gateway's own count goes on; what it grew by in between was another recorder's time."""
    counters = KeyCounters()
    counters.count_bus(10)
    counters.count_bus(13)
    counters.begin_anew()
    counters.count_bus(100)
    counters.count_bus(101)
    assert counters.lost_bus == 4


def test_a_robot_that_is_not_known_is_let_go_of(bench: RecorderRig) -> None:
    """Nothing came of it yet, so nothing is to be done."""
    bench.writer.apply(bench.recorder.let_go("cruiser-9", bench.now_ns))
    assert bench.logs() == {}

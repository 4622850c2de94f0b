"""Gateways whose liveliness token is gone: the dead are an incident, the others are not."""

import msgspec
import pytest

from recorder.encoding.samples import ReceivedSample
from schemas import keys
from schemas.decisions import ArbiterState, EventKind, SafetyState, Severity
from schemas.recording import RecorderEventKind
from tests.support.messages import MS, ROOT, SECOND, STANDBY, key_of, safety_event, sample_of
from tests.support.rigs.recorder import RecorderRig, messages

TOKEN = keys.liveliness(ROOT, "cruiser-1")


def arbiter(bench: RecorderRig, sequence: int, engaged: ArbiterState, *, run: int = 1) -> ReceivedSample:
    """A state that is published now, of one of several runs of the gateway."""
    tick = run * 10**10 + sequence
    said = msgspec.structs.replace(STANDBY, sequence=sequence, tick=tick, state=engaged, output_speed_mps=0.6)
    return sample_of(msgspec.structs.replace(said, time_ns=bench.wall_ns))


def drive(
    bench: RecorderRig, engaged: ArbiterState = ArbiterState.ENGAGED, *, first: int = 0, run: int = 1
) -> None:
    """Half a second of states."""
    for sequence in range(first, first + 10):
        bench.receive(arbiter(bench, sequence, engaged, run=run))
        bench.run(50 * MS)


@pytest.mark.parametrize("restart_ns", [None, 100 * MS, 2 * SECOND])
def test_a_gateway_that_dies_at_work_is_an_incident(bench: RecorderRig, restart_ns: int | None) -> None:
    """Whether another one begins soon, late, or never; it is said, with what the dead one told the chassis."""
    drive(bench)
    dead_ns = bench.wall_ns
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    if restart_ns is not None:
        bench.run(restart_ns)
        drive(bench, ArbiterState.STANDBY, run=2)
    bench.run(SECOND)
    assert bench.recorder.incidents == 1
    (gone,) = [one for one in bench.events() if one.kind is RecorderEventKind.GATEWAY]
    assert (gone.robot, gone.severity, gone.time_ns) == ("cruiser-1", Severity.ERROR, dead_ns)
    assert "its token is gone, and it was engaged, and told 0.60 m/s" in gone.text
    bench.close()
    (incident,) = bench.writer.files["cruiser-1!"]
    held = [log_ns for topic, log_ns in messages(incident) if topic == key_of(SafetyState)]
    assert min(held) < dead_ns, "what came before is kept"


def test_a_gateway_that_stands_by_is_told_and_makes_no_incident(bench: RecorderRig) -> None:
    """Nothing was told the chassis; links of robots that stand come and go all day."""
    drive(bench, ArbiterState.STANDBY)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    bench.run(SECOND)
    assert bench.recorder.incidents == 0
    (gone,) = [one for one in bench.events() if one.kind is RecorderEventKind.GATEWAY]
    assert gone.severity is Severity.WARNING


def test_a_gateway_that_was_told_to_end_has_not_died(bench: RecorderRig) -> None:
    """It says so, and is at rest; one that says so and goes silent in the midst of its stop has died."""
    for sequence, (engaged, incidents) in enumerate([(ArbiterState.STANDBY, 0), (ArbiterState.STOPPING, 1)]):
        drive(bench, engaged, first=10 * sequence)
        ends = msgspec.structs.replace(safety_event(EventKind.GATEWAY, Severity.INFO, sequence), tick=10**10)
        bench.receive(sample_of(ends))
        bench.recorder.lose_token(TOKEN, bench.now_ns)
        bench.run(SECOND)
        assert bench.recorder.incidents == incidents


def test_a_token_that_goes_while_the_states_go_on_tells_nothing(bench: RecorderRig) -> None:
    """Anybody may declare it and take it back. Nor does one of a robot that is not recorded."""
    drive(bench)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    bench.recorder.lose_token(keys.liveliness(ROOT, "stranger"), bench.now_ns)
    bench.recorder.lose_token("odd", bench.now_ns)
    for first in range(10, 310, 10):
        drive(bench, first=first)
    bench.run(SECOND)
    assert bench.recorder.incidents == 0
    assert bench.events() == []


def test_states_that_wait_for_a_busy_recorder_hide_no_death(bench: RecorderRig) -> None:
    """They come in after the token is gone, and then no more."""
    drive(bench)
    bench.recorder.lose_token(TOKEN, bench.now_ns)
    drive(bench, first=10)
    drive(bench, first=20)
    bench.run(SECOND)
    assert bench.recorder.incidents == 1

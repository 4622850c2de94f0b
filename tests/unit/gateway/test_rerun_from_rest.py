"""A run whose beginning is lost, run again from a place where the gateway was at rest."""

from random import Random

import pytest

from gateway.chassis.frame import Frame
from gateway.command.restart import QUIET_NS
from gateway.journal import inputs_of
from gateway.rerun import WARM_UP_NS, rerun, run_again, run_of
from schemas.codec import Sample
from schemas.journal import Kind
from tests.support.rigs.day import RestfulDay, restful_day

SAFETY = ("safety/decision", "safety/event", "safety/state")


@pytest.fixture(scope="module")
def day() -> RestfulDay:
    """Such a day, with a place of rest wherever there is one."""
    return restful_day(1, rounds=3)


def safety(samples: list[Sample]) -> list[Sample]:
    """What the arbiter says."""
    return [sample for sample in samples if sample.subject in SAFETY]


def offered(bursts: list[list[Frame]]) -> list[list[Frame]]:
    """The ticks in which anything is sent."""
    return [frames for frames in bursts if frames]


def test_from_any_place_of_rest_on_all_comes_out_the_same(day: RestfulDay) -> None:
    """Decisions, events and states byte for byte, with their sequences, and every frame with its counter."""
    journals = day.rig.journals
    bursts, said = offered(day.rig.offered), safety([sample for _, sample in day.rig.recorded])
    starts = [number for number in range(1, len(journals)) if number % 61 == 0]
    lengths = set()
    for start in Random(1).sample(starts, 4):  # noqa: S311 - the same ones each time
        run = run_of(journals[start:])
        if run is None:
            continue
        again: list[Sample] = []
        sent: list[list[Frame]] = []
        for frames, samples in run_again(run.core(day.rig.settings), run.inputs):
            sent.append(frames)
            again += samples
        told = safety(again)
        # The journal's last batch, and so the last ticks, are not in it.
        missing = next(count for count in range(4) if told[-1] == said[-1 - count])
        assert told == said[len(said) - missing - len(told) : len(said) - missing]
        assert offered(sent) == bursts[len(bursts) - len(offered(sent)) :]
        lengths.add(len(told))
    assert len(lengths) >= 3


def test_the_places_are_told_from_seconds_of_quiet_on(day: RestfulDay) -> None:
    """There are some after each drive, and none while anybody asks anything."""
    inputs = [one for journal in day.rig.journals for one in inputs_of(journal)]
    asked_ns = 0
    places = 0
    for one in inputs:
        if one[0] == Kind.REQUEST:
            asked_ns = one[1]
        elif one[0] == Kind.REST:
            places += 1
            assert one[1] - asked_ns >= QUIET_NS
    assert places > 10


def test_without_such_a_place_there_is_nothing_to_run(day: RestfulDay) -> None:
    """Nor with one that comes before enough was seen."""
    journals = day.rig.journals
    resting = [any(one[0] == Kind.REST for one in inputs_of(journal)) for journal in journals]
    first = resting.index(True)
    seconds = len([j for j in journals if j.time_ns < journals[first].time_ns])
    assert seconds > 0
    assert run_of(journals[1:first]) is None
    assert not list(rerun(day.rig.settings, journals[1:first]))
    begins = run_of(journals[first:])
    assert begins is not None
    assert begins.warm_up[-1][0] == Kind.REST
    assert begins.warm_up[-1][1] - begins.warm_up[0][1] <= WARM_UP_NS
    assert begins.warm_up[-1][1] - inputs_of(journals[first])[0][1] > WARM_UP_NS - 50_000_000

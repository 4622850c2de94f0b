"""What arrives from Zenoh, for the bridge's one thread."""

import logging

import pytest

from gateway.zenoh.ros import BATCH, Arrivals


def test_a_source_that_floods_delays_no_other() -> None:
    """And its oldest arrivals go."""
    arrivals, taken = Arrivals(), []
    flood = arrivals.to(lambda item, _: taken.append(item), 10 * BATCH)
    other = arrivals.to(lambda item, _: taken.append(item))
    for number in range(20 * BATCH):
        flood(number)
    other("stop")
    arrivals.handle(0)
    assert taken == [*range(10 * BATCH, 11 * BATCH), "stop"]
    for _ in range(20):
        arrivals.handle(0)
    assert taken[BATCH + 1 :] == list(range(11 * BATCH, 20 * BATCH))


def test_an_arrival_that_fails_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    """It is logged once, however often it comes."""
    arrivals, taken = Arrivals(), []

    def take(item: int, _: int) -> None:
        taken.append(1 // item)

    handler = arrivals.to(take)
    for item in (0, 1, 0, 1):
        handler(item)
    with caplog.at_level(logging.ERROR):
        arrivals.handle(0)
    assert taken == [1, 1]
    assert len(caplog.records) == 1

"""Real-time scheduling, where the system allows it."""

import logging
import os

import pytest

from gateway.host import process


def test_nothing_is_asked_for_at_priority_0(monkeypatch: pytest.MonkeyPatch) -> None:
    """0 is off: the system is not even asked."""
    monkeypatch.delattr(os, "sched_setscheduler")
    assert process.request_realtime(0) is False


def test_a_refusal_is_logged_and_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """An ordinary user may not have it; the gateway runs all the same."""

    def refuse(_pid: int, _policy: int, _parameter: os.sched_param) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with caplog.at_level(logging.INFO):
        assert process.request_realtime(10) is False
    assert "no real-time scheduling" in caplog.text


def test_real_time_priority_is_what_the_system_says_whoever_gave_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also a policy that was there from the start; locked memory is another matter."""
    for policy, is_realtime in (
        (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, True),
        (os.SCHED_RR, True),
        (os.SCHED_OTHER, False),
        (os.SCHED_BATCH | os.SCHED_RESET_ON_FORK, False),
    ):
        monkeypatch.setattr(os, "sched_getscheduler", lambda _pid, policy=policy: policy)
        assert process.has_realtime() is is_realtime

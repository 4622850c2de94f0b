"""Two arbiters side by side, of which one has other settings; a minute has three seconds here."""

from collections.abc import Iterator
from functools import cache

import pytest

from gateway import core as core_module
from gateway.rerun import run_pair as pair_module
from gateway.rerun.run_pair import run_pair
from recorder.review.rerun.minutes import COMMANDS
from recorder.review.rerun.tried_settings import TriedSettings
from recorder.shadow import shadow as module
from recorder.shadow.shadow import NOTHING, Shadow, ShadowDifference
from schemas.configuration import to_toml
from schemas.messages import Variant
from tests.support.messages import SECOND
from tests.support.rigs.day import COMMAND
from tests.support.rigs.gateway import Operator
from tests.support.rigs.recorded import RecordedRig

MINUTE_NS = 3 * SECOND


@pytest.fixture(autouse=True)
def short_minutes(monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes a minute in a robot takes three seconds."""
    monkeypatch.setattr(module, "MINUTE_NS", MINUTE_NS)
    monkeypatch.setattr(pair_module, "ALIKE_NS", SECOND)


@cache
def driven() -> RecordedRig:
    """A drive: slow, fast, slow, without a word for 0.2 s, slow."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(core_module, "CHECKPOINT_PERIOD_NS", MINUTE_NS)
        rig = RecordedRig(Variant.COARSE, COMMAND)
        rig.run(0.6)
        operator = Operator(rig)
        operator.engage()
        operator.drive(0.5, 2.0, 3.0)
        operator.drive(1.2, 2.0, 3.0)
        operator.drive(0.5, 2.0, 2.0)
        rig.run(0.2)
        operator.drive(0.5, 2.0, 4.5)
    return rig


class Shadowed:
    """A rig's journal through both, from a place in it on, as ``cruiser shadow`` does it.

    Attributes:
        begun: so often the other arbiter took the state of the robot's.
        found: the differences.
    """

    def __init__(self, rig: RecordedRig, changes: dict[str, object], skipped: int = 0) -> None:
        self.shadow = Shadow("cruiser-1")
        self.begun = 0
        self.found: list[ShadowDifference] = []
        journals = rig.journals[skipped:]
        other = TriedSettings(None, "", changes)(to_toml(rig.settings))
        place = 0
        while place < len(journals):
            self.begun += 1

            def rest(begin: int = place) -> Iterator[object]:
                nonlocal place
                for place in range(begin, len(journals)):
                    yield journals[place]
                place = len(journals)

            for _ in run_pair(rig.settings, other, rest(), self.shadow):  # type: ignore[arg-type]
                self.found += self.shadow.differences()
                if self.shadow.has_strayed:
                    break


def test_a_setting_that_is_never_reached_changes_nothing() -> None:
    """No difference, no minute, and both stay in the same state."""
    both = Shadowed(driven(), {"command.steering_limit_deg": 20.0})
    assert (both.found, both.shadow.otherwise, both.begun) == ([], 0, 1)
    assert both.shadow.minutes == pytest.approx(len(driven().journals) * 0.05 / 3, abs=1)


def test_a_limit_that_is_reached_is_told_with_both_reasons_once_a_minute() -> None:
    """The figures of each stand beside it; minutes in which it is not reached are not counted."""
    both = Shadowed(driven(), {"command.speed_limit_mps": 0.8})
    assert 1 <= both.shadow.otherwise <= 2
    decided = next(one for one in both.found if one.what == "drive of first" and "0.80 m/s" in one.other)
    assert "bound by" in decided.other
    assert "speed" in decided.other
    assert "speed" not in decided.recorded.replace("m/s", "")
    told = [one for one in both.found if one.what == COMMANDS]
    assert 1 <= len(told) <= both.shadow.otherwise
    assert told[0].other.startswith("0.8")
    assert told[0].other.endswith("; engaged")


def test_after_a_difference_it_begins_again_with_the_robots_own_state() -> None:
    """At the next checkpoint: a stop that would have been ends no shadow."""
    both = Shadowed(driven(), {"command.deadman_s": 0.1})
    stop = next(one for one in both.found if one.what == "event stop, deadman")
    assert stop.recorded == NOTHING
    assert stop.other.endswith("none for 110 ms")
    assert both.begun > 1
    assert both.shadow.otherwise < both.shadow.minutes
    assert both.found[-1].time_ns < driven().wall_ns - 2 * SECOND


def test_in_mid_drive_it_begins_at_a_checkpoint_as_if_the_setting_had_been_changed_there() -> None:
    """The robot is faster than the other limit, and would have slowed down."""
    rig = driven()
    fast = next(
        number for number, one in enumerate(rig.journals) if one.time_ns > rig.journals[0].time_ns + 4 * SECOND
    )
    both = Shadowed(rig, {"command.speed_limit_mps": 0.6}, fast)
    assert not both.shadow.is_clear
    assert both.shadow.is_certain
    assert any(one.what == COMMANDS for one in both.found)


def test_a_stop_that_comes_sooner_is_told_so() -> None:
    """One event of both, with how far it is moved."""
    rig = RecordedRig(Variant.COARSE, COMMAND)
    rig.run(0.6)
    operator = Operator(rig)
    operator.engage()
    operator.drive(0.5, 0.0, 2.0)
    rig.run(6.0)
    both = Shadowed(rig, {"command.deadman_s": 0.15})
    [stop] = [one for one in both.found if one.what == "event stop, deadman"]
    assert stop.other.startswith("0.15 s sooner: ") or stop.other.startswith("0.1")
    assert "sooner" in stop.other
    assert stop.recorded != NOTHING


def test_a_clock_that_is_set_begins_another_minute() -> None:
    """And not hundreds of them."""
    shadow = Shadow("cruiser-1")
    for time_ns in (10 * SECOND, 11 * SECOND, 10_000 * SECOND, 10_001 * SECOND, 20 * SECOND):
        shadow.tick(time_ns)
    assert shadow.minutes == 3

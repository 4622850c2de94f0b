"""The table of states."""

from gateway.command.rulings import TRANSITIONS, Trigger, diagram
from schemas.decisions import ArbiterState


def test_only_engage_leads_to_motion() -> None:
    """Nothing resumes by itself: from standby only ENGAGE leads to engaging, and only CONFIRMED to engaged."""
    to = {(before, trigger, after) for (before, trigger), after in TRANSITIONS.items()}
    assert {(b, t) for b, t, after in to if after is ArbiterState.ENGAGING} == {
        (ArbiterState.STANDBY, Trigger.ENGAGE)
    }
    assert {(b, t) for b, t, after in to if after is ArbiterState.ENGAGED} == {
        (ArbiterState.ENGAGING, Trigger.CONFIRMED)
    }


def test_stop_is_possible_everywhere() -> None:
    """And leads to stopping from each state."""
    assert {TRANSITIONS[state, Trigger.STOP] for state in ArbiterState} == {ArbiterState.STOPPING}


def test_the_diagram_has_every_row() -> None:
    """And no other."""
    lines = diagram().splitlines()
    assert lines[:2] == ["stateDiagram-v2", "    [*] --> standby"]
    assert len(lines) == 2 + len(TRANSITIONS)
    assert "    engaging --> engaged: the chassis reads auto" in lines

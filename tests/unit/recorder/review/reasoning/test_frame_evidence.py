"""What the raw frames of the chassis show."""

from collections import deque

import pytest

from recorder.review.reasoning.chain import Step
from recorder.review.reasoning.frame_evidence import mode
from recorder.review.reasoning.signals import BODY, DecodedFrame
from recorder.review.reasoning.window import EvidenceWindow, Limits
from tests.support.messages import MS, WALL_NS

AUTO, REMOTE = bytes.fromhex("013f30000000909e"), bytes.fromhex("013f30000001707f")


@pytest.mark.parametrize(("over_ms", "step"), [(10, Step.EVIDENCE), (50, Step.EVIDENCE), (70, Step.MISSING)])
def test_what_the_arbiter_last_said_may_just_be_over(over_ms: int, step: Step) -> None:
    """It says so every 50 ms: the frame that showed it is found, though a newer one says otherwise."""
    window = EvidenceWindow("cruiser-1", WALL_NS, 0, Limits())
    heard = ((300, AUTO), (200, REMOTE), (over_ms, AUTO))
    window.frames[BODY] = deque(DecodedFrame(WALL_NS - ms * MS, BODY, data) for ms, data in heard), deque()
    window.settle()
    (link,) = mode(window, 1)
    assert link.step is step
    if step is Step.EVIDENCE:
        assert "said Mode = remote, 200 ms before that moment; the one 100 ms earlier said auto" in link.text

"""Where to look, for each reason."""

import pytest

from recorder.review.evidence import evidence_of
from recorder.review.window import EvidenceWindow, Limits, Step
from schemas.reasons import Reason
from tests.support.messages import WALL_NS


@pytest.mark.parametrize("reason", Reason, ids=lambda one: one.value)
def test_of_an_empty_log_nothing_is_claimed(reason: Reason) -> None:
    """Whatever the reason: no exception, and no evidence."""
    window = EvidenceWindow("cruiser-1", WALL_NS, 0, Limits())
    window.detail = "Auto_GearFeedBack"
    window.settle()
    links = evidence_of(reason)(window)
    assert {link.step for link in links} <= {Step.MISSING}
    assert all(link.text for link in links)


def test_the_frames_that_a_detail_names_are_found() -> None:
    """In the order of the DBC."""
    window = EvidenceWindow("cruiser-1", WALL_NS, 0, Limits())
    window.detail = "stopping: feedback of the chassis is missing; Auto_DriveFeedBack, Auto_GearFeedBack"
    assert window.named_frames == ["Auto_GearFeedBack", "Auto_DriveFeedBack"]

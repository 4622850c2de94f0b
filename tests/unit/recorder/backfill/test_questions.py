"""How it is asked for holes."""

from hypothesis import given
from hypothesis import strategies as st

from recorder.backfill.holes import Hole, HoleKind
from recorder.backfill.questions import WIDEN_NS, BackfillQuestion, questions
from tests.support.backfill_logs import CAMERA, GEAR, HEALTH, ROBOT, RX, SECOND

ALL = f"{ROBOT}/**"
TOPICS = {ROBOT: {GEAR, RX, HEALTH, f"{ROBOT}/state"}, "fleet/cruiser-2": {"fleet/cruiser-2/state", "x"}}


def hole(topic: str, from_s: float, to_s: float) -> Hole:
    """A hole, in seconds."""
    kind = HoleKind.SILENCE if topic.endswith("/**") else HoleKind.SEQUENCE
    return Hole(topic, kind, round(from_s * SECOND), round(to_s * SECOND), None)


def asked(*holes: Hole) -> list[tuple[str, float, float]]:
    """The questions, in seconds."""
    return [(one.key, one.from_ns / SECOND, one.to_ns / SECOND) for one in questions(holes, TOPICS)]


@given(
    st.lists(
        st.builds(
            lambda topic, from_s, length_s: hole(topic, from_s, from_s + length_s),
            st.sampled_from([GEAR, RX, HEALTH, CAMERA, ALL, "fleet/cruiser-2/state", "other/key"]),
            st.integers(0, 300),
            st.integers(1, 40),
        ),
        max_size=12,
    )
)
def test_every_hole_is_asked_for_and_no_topic_twice(holes: list[Hole]) -> None:
    """Second by second."""
    found = questions(holes, TOPICS)
    for one in holes:
        for second in range(one.from_ns // SECOND, one.to_ns // SECOND):
            time_ns = second * SECOND
            hits = [q for q in found if q.covers(one.topic) and q.from_ns <= time_ns < q.to_ns]
            assert len(hits) == 1
    assert found == sorted(found, key=lambda one: (one.from_ns, one.key))


def test_near_holes_of_a_topic_are_one_question() -> None:
    """And far ones are not."""
    assert asked(hole(GEAR, 0, 1), hole(GEAR, 1.5, 2), hole(GEAR, 10, 11)) == [(GEAR, 0, 2), (GEAR, 10, 11)]


def test_what_many_topics_lack_is_asked_for_at_once() -> None:
    """Two of four, over the same time; but one alone is asked for alone."""
    assert asked(hole(GEAR, 0, 10), hole(RX, 1, 10)) == [(GEAR, 0, 10), (RX, 1, 10)]
    assert asked(hole(GEAR, 0, 10), hole(RX, 0, 10)) == [(ALL, 0, 10)]
    assert asked(hole(GEAR, 0, 10)) == [(GEAR, 0, 10)]


def test_a_silence_takes_in_the_holes_around_it() -> None:
    """What is left of a long one is asked for alone."""
    found = asked(hole(ALL, 100, 110), hole(GEAR, 99, 110), hole(HEALTH, 50, 111))
    widened_s = WIDEN_NS / SECOND
    assert found == [(HEALTH, 50, 100 - widened_s), (ALL, 100 - widened_s, 111)]


def test_robots_are_asked_for_apart() -> None:
    """As are keys of no robot."""
    found = asked(hole(GEAR, 0, 10), hole("fleet/cruiser-2/state", 0, 10), hole("other/key", 0, 10))
    assert [key for key, _, _ in found] == [GEAR, "fleet/cruiser-2/state", "other/key"]


def test_a_question_for_a_robot_covers_its_topics() -> None:
    """And those of no robot whose name begins the same."""
    question = BackfillQuestion(ALL, 0, 1)
    assert question.covers(GEAR)
    assert question.covers(ALL)
    assert not question.covers("fleet/cruiser-11/state")
    assert not BackfillQuestion(GEAR, 0, 1).covers(ALL)

"""What was so from when to when."""

from recorder.review.report.spans import MIXED, Span, Spans
from tests.support.messages import MS, SECOND


def test_a_value_holds_until_another_comes() -> None:
    """The span ends where the next begins, and the last one with the last sample."""
    spans = Spans(SECOND)
    for time_ns, value in ((0, "a"), (100, "a"), (200, "b"), (300, "b")):
        spans.add(time_ns, value)
    assert spans.spans() == [Span(0, 200, "a"), Span(200, 300, "b")]


def test_across_a_silence_nothing_is_known() -> None:
    """Not even where the value is the same behind it."""
    spans = Spans(SECOND)
    for time_ns in (0, SECOND // 2, 5 * SECOND, 5 * SECOND + 1):
        spans.add(time_ns, "a")
    assert spans.spans() == [Span(0, SECOND // 2, "a"), Span(5 * SECOND, 5 * SECOND + 1, "a")]


def test_nothing_is_no_span() -> None:
    """An empty value leaves a hole."""
    spans = Spans(SECOND)
    for time_ns, value in ((0, ""), (100, "a"), (200, ""), (300, "a"), (250, "late"), (400, "a")):
        spans.add(time_ns, value)
    assert spans.spans() == [Span(100, 200, "a"), Span(300, 400, "a")]


def test_what_changes_too_often_is_mixed_and_long_spans_stay() -> None:
    """The number of spans is bounded; what is long enough to be seen is seen."""
    spans = Spans(10**18, limit=50)
    time_ns = 0
    for number in range(10_000):
        time_ns += MS
        spans.add(time_ns, "ab"[number % 2])
    spans.add(time_ns + MS, "long")
    spans.add(time_ns + 100 * SECOND, "end")
    found = spans.spans()
    assert len(found) <= 52
    assert found[0].start_ns == MS
    assert MIXED in {span.value for span in found}
    assert any(span.value == "long" and span.end_ns - span.start_ns > 99 * SECOND for span in found)

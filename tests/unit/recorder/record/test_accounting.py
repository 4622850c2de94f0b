"""Losses of a key, and their reports."""

from typing import Any

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.samples import KeyCounters
from recorder.record.accounting import OTHER_KEYS, KeyReport, LossReport, report, since, total
from schemas.recording import GapReason, RecordGap

COUNTS = st.integers(0, 100)
REPORTS = st.builds(
    KeyReport,
    **{name: COUNTS for name in KeyReport.__struct_fields__ if name not in {"sent", "lost_bus"}},
    sent=st.none() | COUNTS,
    lost_bus=st.none() | COUNTS,
)


def fields(one: KeyReport) -> dict[str, Any]:
    return msgspec.structs.asdict(one)


def test_a_report_has_a_field_for_each_reason() -> None:
    counters = KeyCounters()
    counters.samples, counters.messages, counters.missed, counters.dropped = 20, 100, 7, 3
    counters.unwritten = 40
    for count, reason in enumerate(GapReason, start=1):
        counters.lose(reason, 10**count)
    found = report(counters, counts_sequence=True)
    lost = {reason: fields(found)[f"lost_{reason.value}"] for reason in GapReason}
    assert lost == counters.lost
    assert found.lost == sum(lost.values()) + found.lost_link
    assert (found.written, found.lost_source, found.lost_bus) == (60, 3, None)
    counters.unwritten = 1000
    assert report(counters, counts_sequence=True).written == 0


@given(REPORTS, REPORTS)
def test_the_change_since_a_report_is_what_came_on_top(before: KeyReport, more: KeyReport) -> None:
    change = since(total([before, more]), before)
    for name, value in fields(change).items():
        none_before = fields(before)[name] is None
        wanted = fields(more)[name]
        assert value == (wanted if wanted is not None or none_before else 0)
    assert all(value in (0, None) for value in fields(since(before, total([before, more]))).values())


def test_gaps_that_are_merged_are_the_newest() -> None:
    losses = LossReport(10)
    losses.add("t", RecordGap(20, 1, "k", GapReason.FULL, 10, 15, 3))
    losses.add("t", RecordGap(30, 2, "k", GapReason.FULL, 12, 25, 4))
    assert losses.take() == [("t", RecordGap(30, 2, "k", GapReason.FULL, 10, 25, 7))]


def test_ever_new_and_very_long_keys_cost_no_memory() -> None:
    losses = LossReport(3)
    for number in range(100):
        losses.lose("a", f"k/{number}", GapReason.QUEUE, 1, number, number)
    losses.lose("a", "k" * 1000, GapReason.QUEUE, 1, 100, 100)
    assert [(gap.key, gap.count, gap.first_ns, gap.last_ns) for _, gap in losses.take()] == [
        ("k/0", 1, 0, 0),
        ("k/1", 1, 1, 1),
        ("k/2", 1, 2, 2),
        (OTHER_KEYS, 98, 3, 100),
    ]
    losses.lose("a", "k/7", GapReason.QUEUE, 1, 0, 0)
    assert [gap.key for _, gap in losses.take()] == ["k/7"]

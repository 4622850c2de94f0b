"""What of a key was lost, and how that is reported."""

from typing import Any

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.samples import KeyCounters
from recorder.mcap.writer import log_time
from recorder.record.accounting import OTHER_KEYS, FileAccount, KeyReport, LossReport, report, since, total
from schemas import codec
from schemas.recording import GapReason, RecordGap
from schemas.subjects import BY_TYPE

LOSSES = st.lists(
    st.tuples(
        st.sampled_from(["a", "b"]),
        st.sampled_from(["k/1", "k/2"]),
        st.sampled_from(GapReason),
        st.integers(1, 100),
        st.integers(-(2**70), 2**70),
        st.integers(-(2**70), 2**70),
    ),
    max_size=30,
)

COUNTS = st.integers(0, 100)
REPORTS = st.builds(
    KeyReport,
    **{name: COUNTS for name in KeyReport.__struct_fields__ if name not in {"sent", "lost_bus"}},
    sent=st.none() | COUNTS,
    lost_bus=st.none() | COUNTS,
)


def fields(one: KeyReport) -> dict[str, Any]:
    return msgspec.structs.asdict(one)


@given(
    st.lists(st.sampled_from(["come", "come", "link", "queue", "size"]), max_size=40), st.integers(0, 2**32 - 1)
)
def test_what_was_sent_was_received_or_lost_on_the_way(fates: list[str], first: int) -> None:
    """Wherever in the sequence it was dropped: what the recorder dropped itself is no fault of the link."""
    counters = KeyCounters()
    for number, fate in enumerate(fates):
        if fate == "come":
            counters.count_sequence((first + number) % 2**32)
            counters.samples += 1
        elif fate != "link":
            counters.lose(GapReason(fate), 1)
    came = [number for number, fate in enumerate(fates) if fate == "come"]
    on_the_way = fates[came[0] : came[-1]].count("link") if came else 0
    found = report(counters, counts_sequence=True)
    assert found.received == len(fates) - fates.count("link")
    assert (found.lost_link, found.sent) == (on_the_way, found.received + on_the_way)
    assert report(counters, counts_sequence=False).sent is None


def test_a_report_has_a_field_for_each_reason() -> None:
    """No loss goes without saying; all together are ``lost``. What was left out for none is merely not written."""
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
    """Nothing is below 0, even where what one file missed came in the next."""
    change = since(total([before, more]), before)
    for name, value in fields(change).items():
        none_before = fields(before)[name] is None
        wanted = fields(more)[name]
        assert value == (wanted if wanted is not None or none_before else 0)
    assert all(value in (0, None) for value in fields(since(before, total([before, more]))).values())


@given(st.lists(REPORTS, max_size=5))
def test_a_topic_of_several_logs_is_counted_together(reports: list[KeyReport]) -> None:
    """What no log tells is not told."""
    for name, value in fields(total(reports)).items():
        told = [fields(one)[name] for one in reports if fields(one)[name] is not None]
        assert value == (sum(told) if told else getattr(KeyReport(), name))


@given(st.lists(st.tuples(st.integers(0, 9), st.booleans()), max_size=30))
def test_files_together_tell_all_that_came(steps: list[tuple[int, bool]]) -> None:
    """Whenever one ends."""
    account = FileAccount()
    received = told = 0
    for count, ends in [*steps, (0, True)]:
        received += count
        if ends:
            told += account.end_file({"k": KeyReport(received=received)})["k"].received
    assert told == received


@given(LOSSES, LOSSES)
def test_every_loss_is_reported_once_with_its_place(
    first: list[tuple[str, str, GapReason, int, int, int]], second: list[tuple[str, str, GapReason, int, int, int]]
) -> None:
    """One gap for each place, key and reason; it spans them all, and others can read it whatever the clock."""
    losses = LossReport(100)
    for lost in (first, second):
        wanted: dict[tuple[str, str, GapReason], list[tuple[int, int, int]]] = {}
        for place, key, reason, *loss in lost:
            losses.lose(place, key, reason, *loss)
            wanted.setdefault((place, key, reason), []).append((loss[0], loss[1], loss[2]))
        gaps = losses.take()
        assert [(place, gap.key, gap.reason) for place, gap in gaps] == list(wanted)
        for (_, gap), found in zip(gaps, wanted.values(), strict=True):
            assert gap.count == sum(count for count, _, _ in found)
            assert gap.first_ns <= min(log_time(first_ns) for _, first_ns, _ in found)
            assert gap.last_ns >= max(log_time(last_ns) for _, _, last_ns in found)
            assert codec.decode(BY_TYPE[RecordGap], codec.encode(gap)) == gap
    assert losses.take() == []


def test_gaps_that_are_merged_are_the_newest() -> None:
    """With all that the older ones have counted, from the first of them on."""
    losses = LossReport(10)
    losses.add("t", RecordGap(20, 1, "k", GapReason.FULL, 10, 15, 3))
    losses.add("t", RecordGap(30, 2, "k", GapReason.FULL, 12, 25, 4))
    assert losses.take() == [("t", RecordGap(30, 2, "k", GapReason.FULL, 10, 25, 7))]


def test_ever_new_and_very_long_keys_cost_no_memory() -> None:
    """What is lost of more of them is reported without its key, and counted all the same."""
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

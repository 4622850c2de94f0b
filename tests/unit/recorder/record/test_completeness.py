"""The account of a key."""

from typing import Any

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.key_counters import Tally
from recorder.record.completeness import Account, KeyReport, report, since, total
from schemas.recording import GapReason

COUNTS = st.integers(0, 100)
REPORTS = st.builds(
    KeyReport,
    **{name: COUNTS for name in KeyReport.__struct_fields__ if name not in {"sent", "lost_bus"}},
    sent=st.none() | COUNTS,
    lost_bus=st.none() | COUNTS,
)


def fields(one: KeyReport) -> dict[str, Any]:
    """The report by the names of its fields."""
    return msgspec.structs.asdict(one)


@given(
    st.lists(st.sampled_from(["come", "come", "link", "queue", "size"]), max_size=40), st.integers(0, 2**32 - 1)
)
def test_what_was_sent_was_received_or_lost_on_the_way(fates: list[str], first: int) -> None:
    """Wherever in the sequence it was dropped: what the recorder dropped itself is no fault of the link."""
    tally = Tally()
    for number, fate in enumerate(fates):
        if fate == "come":
            tally.count_sequence((first + number) % 2**32)
            tally.samples += 1
        elif fate != "link":
            tally.lose(GapReason(fate), 1)
    came = [number for number, fate in enumerate(fates) if fate == "come"]
    on_the_way = fates[came[0] : came[-1]].count("link") if came else 0
    found = report(tally, counts_sequence=True)
    assert found.received == len(fates) - fates.count("link")
    assert (found.lost_link, found.sent) == (on_the_way, found.received + on_the_way)
    assert report(tally, counts_sequence=False).sent is None


def test_a_report_has_a_field_for_each_reason() -> None:
    """No loss goes without saying; all together are ``lost``. What was left out for none is merely not written."""
    tally = Tally()
    tally.samples, tally.messages, tally.missed, tally.dropped = 20, 100, 7, 3
    tally.unwritten = 40
    for count, reason in enumerate(GapReason, start=1):
        tally.lose(reason, 10**count)
    found = report(tally, counts_sequence=True)
    lost = {reason: fields(found)[f"lost_{reason.value}"] for reason in GapReason}
    assert lost == tally.lost
    assert found.lost == sum(lost.values()) + found.lost_link
    assert (found.written, found.lost_source, found.lost_bus) == (60, 3, None)
    tally.unwritten = 1000
    assert report(tally, counts_sequence=True).written == 0


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


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 9), st.booleans()), max_size=30))
def test_files_together_tell_what_was_wanted(steps: list[tuple[bool, int, bool]]) -> None:
    """Whenever one ends; what came while it was left off is in none, what the disk lost then is not forgotten."""
    account = Account()
    received = written = lost = wanted = told_received = told_lost = 0
    for is_wanted, count, ends in steps:
        before = {"k": KeyReport(received=received, written=written, lost_disk=lost)}
        account.take_up(before) if is_wanted else account.leave_off(before)
        received, lost = received + count, lost + 1
        written, wanted = written + count * is_wanted, wanted + count * is_wanted
        if ends and is_wanted:
            told = account.of_file({"k": KeyReport(received=received, written=written, lost_disk=lost)})["k"]
            told_received, told_lost = told_received + told.received, told_lost + told.lost_disk
            assert told.received == told.written
    last = {"k": KeyReport(received=received, written=written, lost_disk=lost)}
    account.take_up(last)
    told = account.of_file(last)["k"]
    assert told_received + told.received == wanted
    assert told_lost + told.lost_disk == lost

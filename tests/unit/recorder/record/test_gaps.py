"""What is lost, told together."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.mcap.chunk import INT64_MAX
from recorder.record import gaps as gaps_module
from recorder.record.gaps import OTHER_KEYS, Gaps
from schemas import codec
from schemas.recording import GapReason, RecordGap
from schemas.subjects import BY_TYPE
from tests.support.recorder_fakes import WALL_NS

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


@given(LOSSES, LOSSES, st.integers(-(2**70), 2**70))
def test_every_loss_is_told_once_and_with_its_log(
    first: list[tuple[str, str, GapReason, int, int, int]],
    second: list[tuple[str, str, GapReason, int, int, int]],
    wall_ns: int,
) -> None:
    """One gap for each log, key and reason; it spans them all, and any clock makes a message that others read."""
    gaps = Gaps()
    told_before = 0
    for losses in (first, second):
        wanted: dict[tuple[str, str, GapReason], list[tuple[int, int, int]]] = {}
        for log, key, reason, *loss in losses:
            gaps.add(log, key, reason, *loss)
            wanted.setdefault((log, key, reason), []).append((loss[0], loss[1], loss[2]))
        told = gaps.tell(wall_ns)
        assert [(log, gap.key, gap.reason) for log, gap in told] == list(wanted)
        for (_, gap), found in zip(told, wanted.values(), strict=True):
            assert gap.count == sum(count for count, _, _ in found)
            assert gap.first_ns <= min(min(INT64_MAX, max(0, start_ns)) for _, start_ns, _ in found)
            assert gap.last_ns >= max(min(INT64_MAX, max(0, end_ns)) for _, _, end_ns in found)
            assert codec.decode(BY_TYPE[RecordGap], codec.encode(gap)) == gap
        assert [gap.sequence for _, gap in told] == list(range(told_before, told_before + len(told)))
        told_before += len(told)
    assert gaps.tell(WALL_NS) == []


def test_ever_new_keys_cost_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is lost of more of them is told without its key, and counted all the same."""
    monkeypatch.setattr(gaps_module, "KEYS_MAX", 3)
    gaps = Gaps()
    for number in range(100):
        gaps.add("a", f"k/{number}", GapReason.QUEUE, 1, number, number)
    assert [(gap.key, gap.count, gap.first_ns, gap.last_ns) for _, gap in gaps.tell(WALL_NS)] == [
        ("k/0", 1, 0, 0),
        ("k/1", 1, 1, 1),
        ("k/2", 1, 2, 2),
        (OTHER_KEYS, 97, 3, 99),
    ]
    gaps.add("a", "k/7", GapReason.QUEUE, 1, 0, 0)
    assert [gap.key for _, gap in gaps.tell(WALL_NS)] == ["k/7"]


def test_very_long_keys_are_told_together() -> None:
    """Ten thousand of them would take half a gigabyte."""
    gaps = Gaps()
    for number in range(10):
        gaps.add("a", f"{'k' * 1000}{number}", GapReason.QUEUE, 1, number, number)
    assert [(gap.key, gap.count) for _, gap in gaps.tell(WALL_NS)] == [(OTHER_KEYS, 10)]

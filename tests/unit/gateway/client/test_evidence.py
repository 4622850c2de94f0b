import pytest

from gateway.client.proof import CONFIRM_NS, Evidence

MS = 1_000_000


def read(evidence: Evidence, *times_ms: int) -> bool:
    """Samples that were read then."""
    for time_ms in times_ms:
        evidence.add(time_ms * MS)
    return evidence.is_enough


@pytest.mark.parametrize(
    ("times_ms", "is_enough"),
    [
        ((0, 75, 150), True),
        ((0, 75, 149), False),
        ((0, 150), False),
        ((0,) * 100, False),
        ((0, 0, 0, 0, 5000, 5000, 5000), True),
    ],
    ids=["enough", "too briefly", "too few", "at once", "two late batches"],
)
def test_three_samples_in_150_ms_are_believed(times_ms: tuple[int, ...], *, is_enough: bool) -> None:
    """Whether they are read one by one or in batches: what counts is that nothing else was read in between."""
    assert CONFIRM_NS == 150 * MS
    assert read(Evidence(), *times_ms) is is_enough


def test_what_was_contradicted_begins_anew() -> None:
    """Samples of before count no more."""
    evidence = Evidence()
    assert read(evidence, 0, 75, 150)
    evidence.clear()
    assert not read(evidence, 200, 210, 349)
    assert read(evidence, 350)


def test_samples_before_a_pause_prove_nothing_where_nothing_would_contradict() -> None:
    """One in a while never becomes enough."""
    evidence = Evidence(pause_max_ns=500 * MS)
    assert not read(evidence, 0, 501, 1002, 1503)
    assert read(evidence, 1600, 2100)

"""What is wrong with logs, gathered."""

from hypothesis import given
from hypothesis import strategies as st

from recorder.reading.logs import FAULTS_SHOWN, Faults


@given(st.lists(st.text()))
def test_all_are_counted_and_the_first_are_told(details: list[str]) -> None:
    """Memory does not grow with the damage."""
    faults = Faults()
    for detail in details:
        faults.add(detail)
    assert faults.count == len(dict.fromkeys(details))
    assert faults.told == list(dict.fromkeys(details))[:FAULTS_SHOWN]
    assert bool(faults) == bool(details)

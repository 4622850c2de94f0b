"""A row of the catalog, for logs with known contents."""

from pathlib import Path

import pytest

from recorder.record.incidents import INCIDENT_NAME
from recorder.review.catalog.directory import to_rows, to_table
from recorder.review.catalog.log_row import INCIDENT, NEVER_NS, CatalogRow, LoggedMoment, row_of
from tests.support.logs import gears, own_log, saved


def made(path: Path, data: bytes) -> CatalogRow:
    row = row_of(saved(path, data), path.name, 5)
    assert to_rows(to_table([row])) == [row]
    return row


@pytest.mark.parametrize(("at_ns", "time_ns"), [("1800000000000000123", 18 * 10**17 + 123), ("9" * 19, NEVER_NS)])
def test_an_incident_is_a_moment(tmp_path: Path, at_ns: str, time_ns: int) -> None:
    kept = {"at_ns": at_ns, "because": "it swerved", "file": "b.incident.mcap"}
    row = made(tmp_path / "a.mcap", own_log([gears(0, 2, 5)], metadata=[(INCIDENT_NAME, kept)]))
    about = ("cruiser-1", INCIDENT, "warning", "none", "", "")
    assert row.moments == [LoggedMoment(time_ns, time_ns, *about, count=1, is_stop=False, text="it swerved")]


@pytest.mark.parametrize("at_ns", ["", "soon", "-5", "1.5", "٣", "9" * 40])
def test_an_incident_without_a_time_is_none(tmp_path: Path, at_ns: str) -> None:
    row = made(tmp_path / "a.mcap", own_log([gears(0, 2, 5)], metadata=[(INCIDENT_NAME, {"at_ns": at_ns})]))
    assert not row.moments


def test_counts_beyond_a_column_are_cut(tmp_path: Path) -> None:
    account = {"fleet/x": f'{{"lost_link": {2**64 - 1}}}'}
    data = own_log([gears(0, 1, 2**64 - 5)], metadata=[("cruiser.completeness", account)])
    row = row_of(saved(tmp_path / "a.mcap", data), "a.mcap", 5)
    (kept,) = to_rows(to_table([row]))
    assert (kept.start_ns, kept.end_ns, kept.lost) == (NEVER_NS, NEVER_NS, NEVER_NS)

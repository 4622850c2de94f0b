"""What a log says besides its messages."""

from pathlib import Path

import pytest

from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.review.report import margins
from recorder.review.report.margins import of_robot, read_margins, versions_of
from recorder.review.report.versions import Versions
from schemas.messages import Variant
from tests.support.drives import drive_messages, write_messages
from tests.support.logs import Log
from tests.support.messages import gateway_info, sample_of


def test_metadata_tell_of_each_gateway_not_only_of_the_last(tmp_path: Path) -> None:
    """Though the answers themselves are not read."""
    log = Log()
    for number, text in ((0, "a = 1\n"), (50, "a = 2\n")):
        log.receive(
            sample_of(gateway_info(number, text, variant=Variant.UNKNOWN)), sample_of(gateway_info(number, text))
        )
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    (found,) = find_logs([path], Faults())
    versions: dict[str, Versions] = {}
    read = read_margins(found, versions)
    known = versions_of("fleet/cruiser-1", versions)
    assert known is not None
    assert [(one.variant, one.configuration_sha256) for one in known.in_force()] == [
        ("coarse", gateway_info(0, text).configuration_sha256) for text in ("a = 1\n", "a = 2\n")
    ]
    _, facts = of_robot("fleet/cruiser-1", [read])
    assert facts["configuration_sha256"] == gateway_info(0, "a = 2\n").configuration_sha256
    assert facts["recorder_version"] == "0.1.0"


def test_two_robots_of_one_name_in_one_log_are_told_apart(tmp_path: Path) -> None:
    """Their recorder calls only the second one by its root, and knew but the first one for a while."""
    log = Log()
    log.receive(sample_of(gateway_info(0), root="fleet"))
    for root in ("fleet", "depot"):
        log.receive(sample_of(gateway_info(50, f"root = '{root}'\n"), root=root))
    path = tmp_path / "a.mcap"
    path.write_bytes(log.close())
    versions: dict[str, Versions] = {}
    read = [read_margins(found, versions) for found in find_logs([path], Faults())]
    for root in ("fleet", "depot"):
        known = versions_of(f"{root}/cruiser-1", versions)
        assert known is not None
        hash_of_its_own = gateway_info(50, f"root = '{root}'\n").configuration_sha256
        hashes = [one.configuration_sha256 for one in known.in_force()]
        assert hashes == [*([gateway_info(0).configuration_sha256] if root == "fleet" else []), hash_of_its_own]
        assert f"{root}/cruiser-1" in versions
        assert of_robot(f"{root}/cruiser-1", read)[1]["configuration_sha256"] == hash_of_its_own


def test_the_accounts_of_files_add_up(tmp_path: Path) -> None:
    """Those of one robot alone."""
    paths = [write_messages(tmp_path / f"{name}.mcap", drive_messages(10), robots=["r-1", "r-2"]) for name in "ab"]
    read = [read_margins(log, {}) for log in find_logs(paths, Faults())]
    completeness, _ = of_robot("fleet/r-1", read)
    assert completeness["fleet/r-1/state"].written == 20
    assert all(topic.startswith("fleet/r-1/") for topic in completeness)


def test_robots_without_end_cost_no_memory_without_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names can be made up."""
    monkeypatch.setattr(margins, "ROBOTS_MAX", 2)
    versions: dict[str, Versions] = {}
    paths = [
        write_messages(tmp_path / f"{name}.mcap", drive_messages(1), robots=[f"{name}-{n}" for n in "123"])
        for name in "ab"
    ]
    for log in find_logs(paths, Faults()):
        assert len(read_margins(log, versions).facts) <= 2
    assert len(versions) == 2


def test_a_file_that_is_gone_says_nothing(tmp_path: Path) -> None:
    """Who reads the rows tells of it."""
    (log,) = find_logs([write_messages(tmp_path / "a.mcap", drive_messages(1))], Faults())
    log.path.unlink()
    read = read_margins(log, {})
    assert (read.facts, read.completeness) == ({}, {})

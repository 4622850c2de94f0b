"""The bill of materials has the vendored scripts of the desk's page."""

import runpy
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SBOM = runpy.run_path(str(ROOT / "deploy" / "sbom.py"))
VENDORED: Path = SBOM["VENDORED"]


def test_scripts_of_others_are_named_with_version_licence_and_files() -> None:
    """Each file belongs to one of them."""
    components = {one["name"]: one for one in SBOM["vendored"](VENDORED)}
    assert set(components) == {"uPlot", "@msgpack/msgpack"}
    assert {one["licenses"][0]["license"]["id"] for one in components.values()} == {"MIT", "ISC"}
    assert components["@msgpack/msgpack"]["purl"].startswith("pkg:npm/%40msgpack/msgpack@3.")
    files = {entry["value"] for one in components.values() for entry in one["properties"]}
    assert {ROOT / one for one in files} == set(VENDORED.iterdir()) - {VENDORED / SBOM["NOTICES"]}


def test_a_script_without_a_notice_is_an_error(tmp_path: Path) -> None:
    place = tmp_path / "vendor"
    shutil.copytree(VENDORED, place)
    (place / "new.min.js").write_text("")
    with pytest.raises(ValueError, match=r"new\.min\.js"):
        SBOM["vendored"](place)

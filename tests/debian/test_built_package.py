"""The Debian packages that ``make deb`` has just built have what their units run."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = sorted((ROOT / "build" / "deb").glob("*.deb"))

packages = pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)


def test_packages_were_built() -> None:
    """Without any, no other test here would say anything."""
    assert PACKAGES


@pytest.fixture
def listed() -> Callable[[Path], dict[str, list[str]]]:
    """The files of a package: mode, owner, and where a link leads."""

    def read(package: Path) -> dict[str, list[str]]:
        words = ["dpkg-deb", "--contents", str(package)]
        lines = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
        rows = [line.split(None, 5) for line in lines]
        return {row[5].partition(" -> ")[0].removeprefix("."): [*row[:2], row[5]] for row in rows}

    return read


@packages
def test_a_package_has_what_its_units_run(package: Path, listed: Callable[[Path], dict[str, list[str]]]) -> None:
    """Everything is root's, nobody else writes to it, and what an administrator edits is told to dpkg."""
    files = listed(package)
    for name, (mode, owner, _) in files.items():
        assert owner == "root/root", name
        assert mode[0] == "l" or (mode[5], mode[8]) == ("-", "-"), name
    for unit in (ROOT / "deploy").glob("*.service"):
        assert f"/usr/lib/systemd/system/{unit.name}" in files
    for name in (
        "/opt/cruiser/bin/cruiser",
        "/usr/lib/udev/rules.d/60-cruiser.rules",
        "/opt/cruiser/lib/early_stop.py",
        "/usr/share/bash-completion/completions/cruiser",
        "/usr/share/man/man1/cruiser.1.gz",
    ):
        assert name in files
    target = files["/opt/cruiser/lib/early_stop.py"][2].partition(" -> ")[2]
    assert f"/opt/cruiser/lib/{target}" in files
    for module in (
        "gateway/cli/desk_server.py",
        "starlette",
        "uvicorn",
        "websockets",
        "prometheus_client",
    ):
        assert [name for name in files if f"/site-packages/{module}" in name], module
    assert not [name for name in files if "/site-packages/bin/" in name or "hatchling" in name]
    words = ["dpkg-deb", "--info", str(package), "conffiles"]
    said = subprocess.run(words, capture_output=True, text=True, check=True)
    assert said.stdout.split() == sorted(name for name in files if name.startswith("/etc/") and name[-1] != "/")


@packages
def test_a_package_is_for_one_python(package: Path) -> None:
    """That of its release, which its name says."""
    words = ["dpkg-deb", "--field", str(package), "Depends", "Architecture", "Version"]
    said = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    python = {"deb12": 11, "deb13": 13, "ubuntu24.04": 12}[package.name.split("~")[1].rsplit("_", 1)[0]]
    assert f"python3 (>= 3.{python}), python3 (<< 3.{python + 1})" in said
    assert "iproute2" in said
    assert "procps" in said
    assert f"Architecture: {package.stem.rsplit('_', 1)[1]}\n" in said

"""The files that ``make release`` has just put into dist."""

import hashlib
import os
import re
import subprocess
import sys
import tomllib
import urllib.request
from pathlib import Path

import pytest

from tests.support.waiting import wait_until

ROOT = Path(__file__).parents[2]
DIST = ROOT / "dist"
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]


def test_it_is_complete_and_of_one_version() -> None:
    """Each file with its checksum."""
    lines = (DIST / "SHA256SUMS").read_text("ascii").splitlines()
    sums = {name: sum_ for sum_, name in (line.split("  ") for line in lines)}
    releases = [
        f"1~{name}_{machine}" for name in ("deb12", "deb13", "ubuntu24.04") for machine in ("amd64", "arm64")
    ]
    assert set(sums) == {
        f"cruiser_gateway-{VERSION}-py3-none-any.whl",
        f"cruiser_gateway-{VERSION}.tar.gz",
        *(f"cruiser-gateway_{VERSION}-{release}.deb" for release in releases),
        "sbom.json",
        "NOTES.md",
    }
    assert {name: hashlib.sha256((DIST / name).read_bytes()).hexdigest() for name in sums} == sums
    assert len((DIST / "NOTES.md").read_text("utf-8").split()) > 50


@pytest.mark.timeout(1200)
def test_the_wheel_runs_demo_review_and_desk_elsewhere(tmp_path: Path) -> None:
    """In an empty environment, outside of any checkout."""
    (wheel,) = DIST.glob("*.whl")
    subprocess.run([sys.executable, "-m", "venv", "env"], cwd=tmp_path, check=True)
    clean = {name: value for name, value in os.environ.items() if name not in {"PYTHONPATH", "VIRTUAL_ENV"}}
    environment = clean | {"HOME": str(tmp_path), "PATH": f"{tmp_path / 'env/bin'}:{os.environ['PATH']}"}

    def run(*words: str) -> str:
        done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode in {0, 1}, done.stderr
        return done.stdout

    run("python", "-m", "pip", "install", "--quiet", f"{wheel}[desk,review]")
    assert VERSION in run("cruiser", "--version")
    run("cruiser", "demo", "--seconds", "20", "--out", "log")
    assert "stop" in run("cruiser", "review", "why", "log")
    run("cruiser", "review", "report", "log", "-o", "report.html")
    assert (tmp_path / "report.html").stat().st_size > 50_000
    with subprocess.Popen(
        [tmp_path / "env/bin/cruiser", "desk", "--logs", "log", "--logs-only", "--listen", "127.0.0.1:0"],
        cwd=tmp_path,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
    ) as desk:
        try:
            assert desk.stderr is not None
            address = re.search(r"http://[0-9.]+:[0-9]+/", desk.stderr.readline())
            assert address
            with urllib.request.urlopen(f"{address[0]}logs.html") as page:  # noqa: S310 - our own
                assert b"<html" in page.read()
        finally:
            desk.terminate()
            wait_until(lambda: desk.poll() is not None)

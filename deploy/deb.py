"""``make deb``: build the Debian packages into build/deb, one for each release and architecture.

Each has its own Python environment under /opt/cruiser with what constraints-run.txt pins, and runs in the
release's Python. Nothing is compiled, so any machine builds packages of any architecture, without root.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from man import manual

ROOT: Final = Path(__file__).parents[1]
DEPLOY: Final = ROOT / "deploy"
BUILD: Final = ROOT / "build" / "deb"

PACKAGE: Final = "cruiser-gateway"
REVISION: Final = 1
MAINTAINER: Final = "Cruiser Gateway <root@localhost>"
PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


EXTRAS: Final = "desk,metrics,upload"  # extras of the services in the package; constraints-run.txt pins them


class Release(NamedTuple):
    """A release of a distribution; ``python`` is its version, major and minor."""

    suffix: str
    python: str


RELEASES: Final = {
    "bookworm": Release("deb12", "3.11"),
    "trixie": Release("deb13", "3.13"),
    "noble": Release("ubuntu24.04", "3.12"),
}

# Architectures as wheels name them; all three releases have a newer C library than these tags need.
MACHINES: Final = {"amd64": "x86_64", "arm64": "aarch64"}
TAGS: Final = (
    "manylinux_2_34",
    "manylinux_2_28",
    "manylinux_2_24",
    "manylinux_2_17",
    "manylinux2014",
    "manylinux_2_12",
    "manylinux1",
)

# Besides Python: ip(8) for setup and doctor, kill(1) for a reload, users, directories and rules.
DEPENDS: Final = ("iproute2", "libc6", "libgcc-s1", "procps", "systemd (>= 252)", "udev")
RECOMMENDS: Final = ("can-utils", "chrony | time-daemon")

# Destinations of files of deploy/; those under deploy/etc are the administrator's.
PLACES: Final = {
    "*.service": "usr/lib/systemd/system/{name}",
    "sysusers.conf": "usr/lib/sysusers.d/cruiser.conf",
    "tmpfiles.conf": "usr/lib/tmpfiles.d/cruiser.conf",
    "60-cruiser.rules": "usr/lib/udev/rules.d/{name}",
    "completion.bash": "usr/share/bash-completion/completions/cruiser",
    "zenohd.conf": f"usr/share/doc/{PACKAGE}/examples/{{name}}",
    "bench/*": f"usr/share/doc/{PACKAGE}/examples/{{name}}",
}
COMMAND: Final = """\
#!/opt/cruiser/bin/python
import sys

from gateway.cli.main import main

sys.exit(main())
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--release", action="append", choices=RELEASES)
    parser.add_argument("--architecture", action="append", choices=MACHINES)
    arguments = parser.parse_args()
    BUILD.mkdir(parents=True, exist_ok=True)
    wheels = BUILD / "project"
    shutil.rmtree(wheels, ignore_errors=True)
    pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", wheels, ROOT)
    for release in arguments.release or RELEASES:
        for architecture in arguments.architecture or MACHINES:
            package = build(release, architecture, wheels)
            print(f"{package.relative_to(ROOT)}  {package.stat().st_size / 1e6:.1f} MB")


def build(release: str, architecture: str, project: Path) -> Path:
    suffix, python = RELEASES[release]
    stage = BUILD / f"{release}-{architecture}"
    shutil.rmtree(stage, ignore_errors=True)
    install_environment(stage, python, architecture, project)
    for source, place in placed():
        target = stage / place
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    shutil.copyfile(ROOT / "LICENSE", stage / f"usr/share/doc/{PACKAGE}/copyright")
    pages = stage / "usr/share/man/man1"
    pages.mkdir(parents=True)
    (pages / "cruiser.1.gz").write_bytes(gzip.compress(manual(PROJECT["version"]).encode(), mtime=0))
    (stage / "usr/bin").mkdir(parents=True)
    (stage / "usr/bin/cruiser").symlink_to("/opt/cruiser/bin/cruiser")
    version = f"{PROJECT['version']}-{REVISION}~{suffix}"
    write_control(stage, version, python, architecture)
    check(stage)
    package = BUILD / f"{PACKAGE}_{version}_{architecture}.deb"
    git = ["git", "-C", str(ROOT), "log", "-1", "--format=%ct"]
    committed_s = subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip()
    # The same tree makes the same package.
    environment = os.environ | ({"SOURCE_DATE_EPOCH": committed_s} if committed_s else {})
    words = ["dpkg-deb", "--root-owner-group", "-Zzstd", "-z9", "--build", str(stage), str(package)]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, env=environment)
    return package


def install_environment(stage: Path, python: str, architecture: str, project: Path) -> None:
    """Install the wheels, and the three files that make them an environment."""
    machine = MACHINES[architecture]
    wheels = BUILD / f"wheels-{python}-{machine}"
    target: list[str | Path] = ["--only-binary", ":all:", "--implementation", "cp", "--python-version", python]
    target += [word for tag in TAGS for word in ("--platform", f"{tag}_{machine}")]
    # First everything that is pinned, checked by its hash; then of that what the product needs.
    pinned: list[str | Path] = ["--no-deps", "--require-hashes", "--requirement", ROOT / "constraints-run.txt"]
    pip("download", *target, *pinned, "--dest", wheels)
    opt = stage / "opt/cruiser"
    packages = opt / f"lib/python{python}/site-packages"
    found: list[str | Path] = [
        "--no-index",
        "--find-links",
        wheels,
        "--find-links",
        project,
        "--no-compile",
        "--target",
        packages,
    ]
    pip("install", *target, *found, f"{PROJECT['name']}[{EXTRAS}]")
    # Programs of the dependencies, which name this machine's Python; the product calls none of them.
    shutil.rmtree(packages / "bin", ignore_errors=True)
    (opt / "bin").mkdir()
    (opt / "bin/python").symlink_to("/usr/bin/python3")
    (opt / "bin/cruiser").write_text(COMMAND, "utf-8")
    (opt / "bin/cruiser").chmod(0o755)
    (opt / "pyvenv.cfg").write_text(
        f"home = /usr/bin\ninclude-system-site-packages = false\nversion = {python}\n", "utf-8"
    )
    (opt / "lib/early_stop.py").symlink_to(f"python{python}/site-packages/gateway/chassis/cruiser/early_stop.py")
    interpreter = shutil.which(f"python{python}") or ""
    # A version manager puts names there that start nothing.
    if interpreter and subprocess.run([interpreter, "-c", ""], capture_output=True, check=False).returncode == 0:
        words = [interpreter, "-m", "compileall", "-q", "-s", str(stage), "-p", "/"]
        subprocess.run([*words, "--invalidation-mode", "unchecked-hash", str(packages)], check=True)
        (opt / "lib/compiled").touch()


def placed() -> Iterator[tuple[Path, str]]:
    """Each file of deploy/ that a package has, and its place."""
    for pattern, place in PLACES.items():
        for source in sorted(DEPLOY.glob(pattern)):
            yield source, place.format(name=source.name)
    for source in sorted((DEPLOY / "etc").rglob("*")):
        if source.is_file():
            yield source, str(source.relative_to(DEPLOY))


def write_control(stage: Path, version: str, python: str, architecture: str) -> None:
    """Write dpkg's metadata and scripts."""
    files = sorted(path for path in stage.rglob("*") if path.is_file() and not path.is_symlink())
    major, minor = python.split(".")
    control = {
        "Package": PACKAGE,
        "Version": version,
        "Architecture": architecture,
        "Maintainer": MAINTAINER,
        "Installed-Size": str(sum(path.stat().st_size for path in files) // 1024),
        "Depends": ", ".join((f"python3 (>= {python})", f"python3 (<< {major}.{int(minor) + 1})", *DEPENDS)),
        "Recommends": ", ".join(RECOMMENDS),
        "Section": "misc",
        "Priority": "optional",
        "Description": f"{PROJECT['description'].rstrip('.')}\n With its own Python environment, and services.",
    }
    debian = stage / "DEBIAN"
    debian.mkdir()
    (debian / "control").write_text("".join(f"{key}: {value}\n" for key, value in control.items()), "utf-8")
    conffiles = [path for path in files if path.relative_to(stage).parts[0] == "etc"]
    (debian / "conffiles").write_text("".join(f"/{path.relative_to(stage)}\n" for path in conffiles), "utf-8")
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(stage)}\n" for path in files]  # noqa: S324 - the format's
    (debian / "md5sums").write_text("".join(sums), "utf-8")
    for script in ("postinst", "postrm", "prerm"):
        shutil.copyfile(DEPLOY / "debian" / script, debian / script)
        (debian / script).chmod(0o755)


def check(stage: Path) -> None:
    """Reject paths of this machine and world-writable files."""
    here = [place.encode() for place in {str(ROOT), sys.prefix} if place.count("/") > 1]
    for path in stage.rglob("*"):
        mode = path.lstat().st_mode
        if not path.is_symlink():
            path.chmod((mode | 0o644 | (0o111 if path.is_dir() else 0)) & ~0o022)
        if path.is_file() and not path.is_symlink():
            content = path.read_bytes()
            found = [place for place in here if place in content]
            if found:
                raise SystemExit(f"{path} names {found[0].decode()}")


def pip(*words: str | Path) -> None:
    subprocess.run([sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *words], check=True)


if __name__ == "__main__":
    main()

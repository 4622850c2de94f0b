"""The box's disk: a release with systemd, the package's dependencies, and the tests' own files of ``guest``."""

import hashlib
import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[2]
BUILD: Final = ROOT / "build" / "robot"
HERE: Final = Path(__file__).parent

RELEASE: Final = os.environ.get("ROBOT_RELEASE", "bookworm")
DEBIANS: Final = ("bookworm", "trixie")
UBUNTU_KEYS: Final = "/usr/share/keyrings/ubuntu-archive-keyring.gpg"
UBUNTU_SCRIPT: Final = "/usr/share/debootstrap/scripts/gutsy"
"""Which all its releases have; that of Debian 12 knows no newer names."""

PACKAGES: Final = "systemd,systemd-sysv,dbus,iproute2,kmod,udev,procps,python3,libgcc-s1"
"""Of the base system, and what the package depends on: it is installed without a network."""

SIZE: Final = "1500M"
KERNEL_MODULES: Final = Path("/usr/lib/uml/modules")
MODULES: Final = ("net/can", "drivers/net/can", "net/packet")
PROGRAMS: Final = ("bridge.py", "fleet_inside.py", "operator_inside.py")
PLACE: Final = "usr/local/lib/box"
WANTED: Final = {
    "box.service": "multi-user",
    "box-bus.service": "sysinit",
    "systemd-networkd.service": "multi-user",
}
MASKED: Final = (
    "systemd-networkd-wait-online.service",
    "systemd-logind.service",
    "getty.target",
    "getty@.service",
    "e2scrub_reap.service",
    "e2scrub_all.timer",
    "fstrim.timer",
    "apt-daily.timer",
    "apt-daily-upgrade.timer",
    "dpkg-db-backup.timer",
    "dev-hugepages.mount",
    "proc-sys-fs-binfmt_misc.automount",
    "modprobe@dm_mod.service",
    "modprobe@loop.service",
    "modprobe@drm.service",
    "modprobe@fuse.service",
)
"""What a robot has no need of either, and what takes seconds of this slow processor."""


def base_root() -> Path:
    """Return the unpacked system, from apt's mirror, cached for each list of packages."""
    key = hashlib.sha256(f"{RELEASE} {PACKAGES} {MODULES}".encode()).hexdigest()[:12]
    root = BUILD / f"root-{key}"
    if root.exists():
        return root
    new = BUILD / "root.new"
    shutil.rmtree(new, ignore_errors=True)
    BUILD.mkdir(parents=True, exist_ok=True)
    debootstrap = ("debootstrap", "--variant=minbase", f"--include={PACKAGES}")
    if RELEASE in DEBIANS:
        call(*debootstrap, RELEASE, new, mirror())
    else:
        # From Ubuntu's own archive, which its script names.
        keys = os.environ.get("ROBOT_KEYRING", UBUNTU_KEYS)
        call(*debootstrap, f"--keyring={keys}", RELEASE, new, "", UBUNTU_SCRIPT)
    # The mirror is this machine's affair.
    (new / "etc/apt/sources.list").write_text("", "ascii")
    for leftover in ("var/lib/apt/lists", "var/cache/apt/archives", "var/log", "debootstrap"):
        shutil.rmtree(new / leftover, ignore_errors=True)
    (new / "var/log/journal").mkdir(parents=True)
    (new / "etc/machine-id").write_text("", "ascii")
    (version,) = [path.name for path in KERNEL_MODULES.iterdir()]
    for part in MODULES:
        if (KERNEL_MODULES / version / "kernel" / part).exists():
            shutil.copytree(
                KERNEL_MODULES / version / "kernel" / part, new / "lib/modules" / version / "kernel" / part
            )
    call("depmod", "-b", new, version)
    new.rename(root)
    return root


def mirror() -> str:
    """Return Debian's address in apt's configuration, the same for each release. Raises LookupError."""
    lines = call("apt-get", "indextargets", "--format", "$(REPO_URI) $(RELEASE) $(COMPONENT)").splitlines()
    releases = {words[1]: words[0] for line in lines if (words := line.split())[2:] == ["main"]}
    for release in (RELEASE, *DEBIANS):
        if release in releases:
            return releases[release]
    raise LookupError("apt knows no mirror of Debian")


def make_base_image(image: Path, clock: Path, ns_per_tick: str) -> None:
    """Make a bootable disk without the package; ``clock`` is the compiled tests/socketcan/clock.c."""
    tree = image.with_suffix(".root")
    shutil.rmtree(tree, ignore_errors=True)
    # Links instead of copies: what is replaced below is unlinked first.
    call("cp", "-al", base_root(), tree)
    call("cp", "-r", "--no-preserve=ownership,mode", "--remove-destination", "-T", HERE / "guest", tree)
    for program in PROGRAMS:
        shutil.copyfile(HERE / program, tree / PLACE / program)
    shutil.copyfile(clock, tree / PLACE / "clock.so")
    (tree / "etc/box.env").write_text(f"LD_PRELOAD=/{PLACE}/clock.so\nNS_PER_TICK={ns_per_tick}\n", "ascii")
    units = tree / "etc/systemd/system"
    for unit, target in WANTED.items():
        (units / f"{target}.target.wants").mkdir(exist_ok=True)
        place = "/etc/systemd/system" if unit.startswith("box") else "/lib/systemd/system"
        link(units / f"{target}.target.wants" / unit, f"{place}/{unit}")
    for unit in MASKED:
        link(units / unit, "/dev/null")
    link(units / "default.target", "/lib/systemd/system/multi-user.target")
    image.unlink(missing_ok=True)
    call("mkfs.ext4", "-q", "-d", tree, image, SIZE)
    shutil.rmtree(tree)


def link(path: Path, target: str) -> None:
    path.unlink(missing_ok=True)
    path.symlink_to(target)


def copy_image(source: Path, target: Path) -> None:
    call("cp", "--sparse=always", source, target)


def call(*words: object) -> str:
    environment = {**os.environ, "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"}
    done = subprocess.run(
        [str(word) for word in words], check=False, capture_output=True, text=True, env=environment, timeout=600
    )
    if done.returncode:
        raise RuntimeError(f"{words[0]}: {done.stdout[-1000:]}{done.stderr[-1000:]}")
    return done.stdout

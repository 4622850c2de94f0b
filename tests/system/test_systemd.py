"""systemd accepts the units without a warning, and rates none as exposed; users and directories are created."""

import shutil
import subprocess
from pathlib import Path

import pytest

DEPLOY = Path(__file__).parents[2] / "deploy"
UNITS = sorted(path.name.replace("@.", "@can0.") for path in DEPLOY.glob("*.service"))
EXPOSURE_MAX = 20  # of systemd-analyze's hundred
# Where the kernel schedules real-time by group, one unit with one of these takes it from all.
BY_GROUP = ("CPUWeight", "CPUQuota", "StartupCPUWeight")
pytestmark = pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="systemd-analyze is not here (Debian: systemd)"
)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tree with systemd's units, ours, and each program that they start."""
    root = tmp_path_factory.mktemp("root")
    shutil.copytree("/usr/lib/systemd/system", root / "usr/lib/systemd/system", symlinks=True)
    for unit in DEPLOY.glob("*.service"):
        shutil.copy(unit, root / "usr/lib/systemd/system")
    shutil.copytree(DEPLOY / "etc", root / "etc")
    for program in ("opt/cruiser/bin/cruiser", "usr/bin/python3", "bin/kill"):
        path = root / program
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch(mode=0o755)
    return root


def analyze(root: Path, *words: str) -> subprocess.CompletedProcess[str]:
    program = shutil.which("systemd-analyze") or ""
    return subprocess.run([program, *words, f"--root={root}", *UNITS], capture_output=True, text=True, check=False)


def test_systemd_understands_every_line(root: Path) -> None:
    """It ends with 0 even for an unknown key, so it must print nothing."""
    done = analyze(root, "verify", "--man=no")
    assert (done.returncode, done.stderr) == (0, "")


def test_no_unit_is_exposed(root: Path) -> None:
    """Each below 2.0 in systemd's rating."""
    done = analyze(root, "security", "--offline=true", f"--threshold={EXPOSURE_MAX}", "--no-pager")
    assert done.returncode == 0, done.stdout
    assert done.stdout.count("Overall exposure level") == len(UNITS)


@pytest.mark.parametrize("unit", sorted(DEPLOY.glob("*.service")), ids=lambda path: path.name)
def test_no_unit_wants_room_on_the_disk_to_start(unit: Path) -> None:
    """For PrivateDevices= systemd 252 makes a directory in /tmp: on a full disk neither gateway nor early stop."""
    lines = unit.read_text(encoding="utf-8").splitlines()
    assert "DevicePolicy=closed" in lines
    assert not [line for line in lines if line.startswith("PrivateDevices")]


@pytest.mark.parametrize("unit", sorted(DEPLOY.glob("*.service")), ids=lambda path: path.name)
def test_no_unit_turns_group_scheduling_on(unit: Path) -> None:
    """And each has its own user, but for the early stop, which writes the gateway's note."""
    lines = unit.read_text(encoding="utf-8").splitlines()
    assert not [line for line in lines if line.startswith(BY_GROUP)]
    name = unit.name.partition(".")[0].replace("cruiser-early-stop@", "cruiser-gateway")
    assert f"User={name}" in lines


def test_zenohs_own_router_runs_by_the_same_unit(root: Path) -> None:
    """With the drop-in in place of our command, from the same file."""
    unit = "etc/systemd/system/cruiser-router.service.d/zenohd.conf"
    zenohd = root / "usr/local/bin/zenohd"
    for path in (root / unit, zenohd):
        path.parent.mkdir(parents=True)
    shutil.copy(DEPLOY / "zenohd.conf", root / unit)
    try:
        assert "zenohd is not executable" in analyze(root, "verify", "--man=no").stderr
        zenohd.touch(mode=0o755)
        done = analyze(root, "verify", "--man=no")
        assert (done.returncode, done.stderr) == (0, "")
    finally:
        (root / unit).unlink()
    lines = (DEPLOY / "zenohd.conf").read_text(encoding="utf-8").splitlines()
    first, second = (line.removeprefix("ExecStart=") for line in lines if line.startswith("ExecStart="))
    assert (first, second.split()[1:]) == ("", ["-c", "/etc/cruiser/router/router.json5"])


def test_the_gateway_starts_with_the_computer(root: Path) -> None:
    """Also without its interface: it waits."""
    program = shutil.which("systemctl")
    assert program is not None
    subprocess.run([program, f"--root={root}", "enable", "cruiser-gateway"], check=True, capture_output=True)
    wanted = [path.parent.name for path in (root / "etc/systemd/system").glob("*.wants/*")]
    assert wanted == ["multi-user.target.wants"]


def test_each_service_has_a_user_and_a_directory_for_its_keys(tmp_path: Path) -> None:
    """Only its owner can read that."""
    (tmp_path / "etc").mkdir()
    for name in ("passwd", "group"):
        shutil.copy(f"/etc/{name}", tmp_path / "etc")
    for program, file in (("systemd-sysusers", "sysusers.conf"), ("systemd-tmpfiles", "tmpfiles.conf")):
        words = [program, f"--root={tmp_path}", *(["--create"] if program == "systemd-tmpfiles" else []), "-"]
        text = (DEPLOY / file).read_text(encoding="utf-8")
        done = subprocess.run(words, input=text, text=True, capture_output=True, check=False)
        if "Failed to" in done.stderr and "permit" in done.stderr:
            pytest.skip("only root gives files away")
        assert done.returncode == 0, done.stderr
    users = {line.split(":")[0] for line in (tmp_path / "etc/passwd").read_text(encoding="utf-8").splitlines()}
    for service in ("gateway", "recorder", "router", "desk", "metrics"):
        assert f"cruiser-{service}" in users
        assert (tmp_path / "etc/cruiser" / service).stat().st_mode & 0o777 == 0o700
    # The upload reads logs, and may write beside them nothing but its note.
    note = tmp_path / "var/lib/cruiser/logs/.uploaded.jsonl"
    groups = [line.split(":") for line in (tmp_path / "etc/group").read_text(encoding="utf-8").splitlines()]
    assert [line[2] for line in groups if line[0] == "cruiser-upload"] == [str(note.stat().st_gid)]
    assert (note.stat().st_mode & 0o777, note.parent.stat().st_mode & 0o777) == (0o660, 0o755)
    assert note.stat().st_uid == note.parent.stat().st_uid


@pytest.mark.parametrize("name", ["gateway", "router", "recorder", "desk", "metrics"])
def test_each_service_may_report_its_status(name: str) -> None:
    """Only these get systemd's socket; with an expired certificate they wait and report it."""
    lines = (DEPLOY / f"cruiser-{name}.service").read_text(encoding="utf-8").splitlines()
    assert {"NotifyAccess=main", "Type=notify"} & set(lines)

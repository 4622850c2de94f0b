import os
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ("msgspec", "zenoh", "can", "cantools", "rich", "mcap", "google.protobuf", "msgpack")


def cruiser(*words: str) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process; its imported modules are the last line of output."""
    program = (
        "import sys\n"
        "from gateway.cli.main import main\n"
        "code = main(sys.argv[1:])\n"
        "print()\n"
        "print(' '.join(sys.modules))\n"
        "sys.exit(code)\n"
    )
    return subprocess.run(
        [sys.executable, "-c", program, *words], capture_output=True, text=True, check=False, timeout=60
    )


@pytest.mark.parametrize("words", [["--help"], ["-h"], ["help"], [], ["--version"], ["wach"]])
def test_help_and_mistakes_are_answered_without_what_only_commands_need(words: list[str]) -> None:
    done = cruiser(*words)
    modules = done.stdout.splitlines()[-1].split()
    assert not set(HEAVY) & set(modules)
    # The table of what is gone answers a mistake.
    ours = {module for module in modules if module.startswith(("schemas", "recorder"))}
    assert ours <= {"schemas", "schemas.command_line"}


@pytest.mark.parametrize("words", [["drive"], ["review", "why"]])
def test_help_before_a_command_is_that_of_the_command(words: list[str]) -> None:
    asked, flagged = (cruiser(*one).stdout for one in (["help", *words], [*words, "--help"]))
    assert asked == flagged
    assert f"usage: cruiser {' '.join(words)}" in asked


@pytest.mark.parametrize(
    ("redirection", "code", "says"),
    [(">&-", 0, ""), ("2>&-", 0, ""), (">/dev/full", 1, "No space left on device"), ("| true", 0, "")],
)
@pytest.mark.parametrize("words", ["--help", "decode"])
def test_an_output_that_takes_nothing_is_no_traceback(words: str, redirection: str, code: int, says: str) -> None:
    line = "'(1.0) can0 18C4D1EF#0104000000000005'"
    command = f"echo {line} | {sys.executable} -m gateway {words} {redirection}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=60)  # noqa: S607
    assert done.returncode == code
    complaints = [said for said in done.stderr.splitlines() if "no variant given" not in said]
    assert len(complaints) <= 1
    assert says in "".join(complaints)


def test_ctrl_c_before_a_command_has_begun_is_no_traceback() -> None:
    program = (
        "import os\n"
        "from gateway.cli import main\n"
        "main._answer = lambda words: os.kill(os.getpid(), 2)\n"
        "main.main([])\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (-2, "")


def test_a_settings_file_that_was_not_named_is_one_line_with_the_command(tmp_path: Path) -> None:
    (tmp_path / "operator.toml").write_text("")
    environment = {**os.environ, "HOME": str(tmp_path)}
    for names, warnings in (([], 1), (["--config", "operator.toml"], 0)):
        done = subprocess.run(
            [sys.executable, "-m", "gateway", "list", "--timeout", "0.1", *names],
            capture_output=True,
            text=True,
            check=False,
            cwd=tmp_path,
            env=environment,
        )
        said = [line for line in done.stderr.splitlines() if "warning" in line]
        assert len(said) == warnings, done.stderr
        assert all("open mode" in one for one in said)
        assert all("cruiser list --timeout 0.1 --config operator.toml" in one for one in said)


@pytest.mark.parametrize("is_ignored", [False, True])
def test_a_terminal_that_is_closed_ends_a_command_in_order(*, is_ignored: bool) -> None:
    """SIGHUP comes twice, from the kernel and from the shell. nohup holds."""
    program = (
        "import os, signal, sys\n"
        "from gateway.cli import main\n"
        f"signal.signal(signal.SIGHUP, signal.{'SIG_IGN' if is_ignored else 'SIG_DFL'})\n"
        "stopped = main._stop_on_signals()\n"
        "os.kill(os.getpid(), signal.SIGHUP)\n"
        "os.kill(os.getpid(), signal.SIGHUP)\n"
        "print(stopped())\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (0, f"{not is_ignored}\n")

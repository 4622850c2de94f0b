"""``cruiser review rerun``."""

import json
import re
from functools import partial
from pathlib import Path

import pytest

from schemas.command_line import CommandError, ExitCode
from schemas.journal import rules_notice
from schemas.messages import Variant
from tests.support.commands import review
from tests.support.rigs.day import RUN, Day, under_rules_1
from tests.support.rigs.gateway import Operator


@pytest.fixture(scope="module")
def day() -> Day:
    day = Day(1, Variant.COARSE, ticks=0)
    day.rig.run(0.6)
    operator = Operator(day.rig)
    operator.engage()
    operator.drive(1.0, 0.0, 1.0)
    day.rig.run(0.2)
    operator.drive(1.0, 0.0, 3.0)
    day.rig.run(4)
    return day


@pytest.fixture(scope="module")
def log(day: Day, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(day.rig.log())
    return path


run = partial(review, "rerun")
OTHERWISE = (
    "with command.speed_limit_mps 0.4 instead of 1.5",
    " on: drive of first accepted, limited by ",
)

RECORDED = "recorded: 4.03 m in 5.10 s, at most 1.00 m/s, 1 stops"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), ("cruiser-1, run ", "equal byte for byte", "different: 0")),
        (
            ("--set", "command.speed_limit_mps=0.4"),
            (
                *OTHERWISE,
                "200 of 204 decisions",
                "1.67 m in 4.60 s, at most 0.40 m/s",
                RECORDED,
                "stops: the same",
            ),
        ),
        (("--set", "command.deadman_s=0.5"), ("0 of 204 decisions", "4.29 m", "stops: 1 moved, the first at ")),
        # By the pause that the recorded run bore.
        (
            ("--set", "command.deadman_s=0.1"),
            (
                "150 of 204",
                "drive of first refused",
                RECORDED,
                "stops: 1 avoided, the first at ",
                "; 1 added, the",
            ),
        ),
        (("--set", "command.speed_limit_mps=1.5"), ("with the same settings: 0 of ", "stops: the same")),
    ],
)
def test_a_run_and_what_it_would_have_been_is_some_lines(
    log: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: tuple[str, ...]
) -> None:
    assert run(log, *words) == ExitCode.OK
    out = capsys.readouterr().out
    assert [one for one in said if one not in out] == []
    assert len(out.splitlines()) == (4 if words else 3)


def test_of_several_logs_it_says_how_many_decide_otherwise(
    day: Day, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "cruiser-2-20260102T030405Z.mcap"
    other.write_bytes(day.rig.log(robot="cruiser-2", journal=under_rules_1))
    for words, first in (((), other), (("--set", "command.speed_limit_mps=0.4", "--processes", "2"), log)):
        assert run(log, other, *words) == ExitCode.FAILURE
        last = capsys.readouterr().out.splitlines()[-1]
        assert last.startswith(f"1 of 2 logs decide otherwise, the first: {first}, ")


def test_a_whole_configuration_can_be_tried(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "other.toml"
    file.write_text("[command]\nspeed_limit_mps = 0.6\n")
    assert run(log.parent, "--with", file, "--set", "command.lease_s=1.0", "--json") == ExitCode.OK
    [line] = capsys.readouterr().out.splitlines()
    tried = {"speed_limit_mps": [1.5, 0.6], "lease_s": [1.5, 1.0], "deadman_s": [0.25, 0.3]}
    assert (
        json.loads(line)["settings"].items() >= {f"command.{name}": both for name, both in tried.items()}.items()
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "command.speed_limit_mps"], "SETTING=VALUE"),
        (["--set", "command.speed_limit=1"], "no such setting"),
        (["--set", "command.speed_limit_mps=fast"], "speed_limit_mps"),
        (["--with", "/does/not/exist.toml"], r"cannot read /does/not/exist\.toml: No such file or directory$"),
        (["--with", "/bin/sh"], "cannot read /bin/sh: it is no UTF-8 text$"),
        *(
            ([f"--processes={count}"], f"{count!r} is not a whole number from 1 to")
            for count in ("0", "-1", "two", "1.5")
        ),
    ],
)
def test_a_wrong_setting_is_one_clear_error(
    log: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises((CommandError, SystemExit)) as raised:
        run(log, *words)
    assert getattr(raised.value, "code", None) == ExitCode.USAGE
    assert re.search(
        message, str(raised.value) if isinstance(raised.value, CommandError) else capsys.readouterr().err
    )


def test_a_run_under_other_rules_says_so_first_and_is_exit_code_1(
    day: Day, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cruiser-1-20260102T030405Z.mcap"
    path.write_bytes(day.rig.log(journal=under_rules_1))
    assert run(path) == ExitCode.FAILURE
    notice, head, *rest = capsys.readouterr().out.splitlines()
    assert notice == f"cruiser-1, run {RUN}: {rules_notice(0)}"
    assert head.startswith(f"cruiser-1, run {RUN}: ")
    assert any(line.startswith("  different: ") and not line.endswith(" 0") for line in rest)
    assert run(path, "--set", "command.speed_limit_mps=0.4") == ExitCode.FAILURE
    assert capsys.readouterr().out.startswith(notice)
    assert run(path, "--json") == ExitCode.FAILURE
    assert json.loads(capsys.readouterr().out)["rules"] == 0

"""Every question, with logs that are truncated, foreign, unfinished, or made to keep a reader busy."""

import fcntl
import random
import shutil
import tracemalloc
from contextlib import suppress
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap import records

from recorder.cli import asking
from recorder.cli.review import QUESTIONS
from recorder.mcap.framing import BROKEN, MAGIC, RECORD_MAX, UNPACKED_MAX, encode
from recorder.mcap.pieces import NO_RECORD, content_of
from recorder.mcap.reader import DamagedError
from schemas.command_line import CommandError, ExitCode
from tests.support.commands import review
from tests.support.logs import gear_message, gears, own_log, saved
from tests.support.rigs import scenarios as log_scenarios

OTHERS = {"evidence", "find", "query", "recover", "replay", "rerun"}
"""What these do with such logs, their own tests say."""

READERS = [question for question in QUESTIONS if question not in OTHERS]
WRITE = {
    "export": ("-o", "out"),
    "cut": ("-o", "out.mcap", "--from", "0"),
    "report": ("-o", "out.html"),
}


def bomb(chunks: int, size: int) -> bytes:
    chunk = records.Chunk(
        compression="zstd",
        data=zstandard.compress(bytes(size)),
        message_start_time=1,
        message_end_time=2,
        uncompressed_crc=0,
        uncompressed_size=size,
    )
    return MAGIC + encode(records.Header(profile="", library="x")) + chunks * encode(chunk)


def answered(capsys: pytest.CaptureFixture[str], question: str, path: Path) -> tuple[int, str]:
    try:
        code, ending = review(question, path, *WRITE.get(question, ())), ""
    except CommandError as error:
        code, ending = error.code, str(error)
    shown = capsys.readouterr()
    return code, shown.out + shown.err + ending


@pytest.mark.parametrize("question", READERS)
def test_what_is_no_log_is_a_clear_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, question: str) -> None:
    monkeypatch.chdir(tmp_path)
    for content, said in ((b"", "is empty"), (b"hello, hello", "is no MCAP file")):
        path = saved(tmp_path / "log.mcap", content)
        with pytest.raises(CommandError, match=said) as caught:
            review(question, path, *WRITE.get(question, ()))
        assert caught.value.code == ExitCode.FAILURE
        assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("question", [one for one in READERS if one != "cut"])
def test_of_several_files_the_readable_are_answered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    monkeypatch.chdir(tmp_path)
    good = saved(tmp_path / "a.mcap", log_scenarios.recorded(log_scenarios.front_bumper))
    bad = saved(tmp_path / "b.mcap", b"hello, hello")
    assert review(question, good, bad, tmp_path / "none.mcap", *WRITE.get(question, ())) == ExitCode.PARTIAL
    shown = capsys.readouterr()
    assert shown.out
    assert "b.mcap is no MCAP file" in shown.err
    assert "none.mcap: No such file" in shown.err


@pytest.mark.parametrize("question", [*READERS, "query"])
def test_times_beyond_63_bits_are_said_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    monkeypatch.chdir(tmp_path)
    late = [(1, number, 2**63 + number, gear_message(number, 1)[3]) for number in range(3, 6)]
    path = saved(tmp_path / "late.mcap", own_log([gears(0, 3, 1000), late[:1], late[1:]]))
    words = (*WRITE.get(question, ()), path) if question != "query" else ("SELECT 1", path)
    with suppress(CommandError):
        review(question, *words)
    assert capsys.readouterr().err.count("after 2262-04-11") == 1


@pytest.mark.parametrize("question", READERS)
def test_a_bomb_of_zeros_is_answered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = saved(tmp_path / "bomb.mcap", bomb(3, 1 << 24))
    assert path.stat().st_size < 20_000
    code, said = answered(capsys, question, path)
    assert code != ExitCode.OK
    assert NO_RECORD in said


@pytest.mark.parametrize("promised", [0, 100, (1 << 26) - 1, (1 << 26) + 1])
def test_a_chunk_of_lz4_is_unpacked_to_the_size_that_it_promises_and_no_further(promised: int) -> None:
    """Else a few megabytes could fill the reader's memory."""
    packed = lz4.frame.compress(bytes(1 << 26), store_size=False)
    chunk = records.Chunk("lz4", packed, 2, 1, 0, promised)
    tracemalloc.start()
    try:
        with pytest.raises(DamagedError, match="sizes differ"):
            content_of(chunk)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2 * promised + 1_000_000


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_packed_chunk_that_promises_a_gigabyte_is_left_packed(compression: str) -> None:
    """Its tiny messages would take ten times that in memory."""
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}[compression](bytes(UNPACKED_MAX + 1))
    for promised in (UNPACKED_MAX + 1, RECORD_MAX):
        tracemalloc.start()
        try:
            with pytest.raises(DamagedError, match="too large"):
                content_of(records.Chunk(compression, packed, 2, 1, 7, promised))
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert peak < 4 * len(packed) + 100_000


def test_a_chunk_of_lz4_that_is_cut_off_or_junk_is_damaged() -> None:
    packed = lz4.frame.compress(b"whole" * 100)
    assert content_of(records.Chunk("lz4", packed, 2, 1, 0, 500)) == b"whole" * 100
    for data in (b"", packed[:-4], packed[:20], b"junk" + packed):
        with pytest.raises(BROKEN):
            content_of(records.Chunk("lz4", data, 2, 1, 0, 500))


@pytest.mark.parametrize("question", [one for one in READERS if one != "layouts"])
def test_what_takes_too_long_is_given_up(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    monkeypatch.setattr(asking, "BUDGET_S", -1.0)
    data = own_log([gears(0, 3, 10), gears(3, 3, 100)])
    path = saved(tmp_path / "slow.mcap", data[:-20])
    monkeypatch.chdir(tmp_path)
    code, said = answered(capsys, question, path)
    assert code == ExitCode.PARTIAL
    assert "given up after" in said


@pytest.mark.parametrize("question", [one for one in READERS if one != "verify"])
def test_a_log_that_is_being_written_is_no_fault(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    data = log_scenarios.recorded(log_scenarios.front_bumper)
    path = saved(tmp_path / "a.mcap.part", data[: len(data) * 9 // 10])
    monkeypatch.chdir(tmp_path)
    with path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        code, said = answered(capsys, question, path)
        assert code == ExitCode.OK, said
        assert "NOT WHOLE" not in said
        assert "cut off" not in said
    for name in ("out.mcap", "out.html", "out"):
        shutil.rmtree(name, ignore_errors=True)
        Path(name).unlink(missing_ok=True)
    code, said = answered(capsys, question, path)
    assert code != ExitCode.OK
    assert "being written" not in said


@pytest.mark.parametrize("question", READERS)
def test_damage_anywhere_is_an_answer_or_one_clear_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    data = log_scenarios.recorded(log_scenarios.front_bumper)
    chance = random.Random(5)  # noqa: S311 - the same damage each time
    codes = []
    for number in range(20):
        # The first is whole.
        damaged = bytearray(data[: chance.randrange(len(data) // 2, 2 * len(data)) if number else None])
        for _ in range(chance.choice((0, 1, 3, 50)) if number else 0):
            damaged[chance.randrange(8, len(damaged))] = chance.randrange(256)
        path = saved(tmp_path / str(number) / "log.mcap", bytes(damaged))
        monkeypatch.chdir(path.parent)
        codes.append(answered(capsys, question, path)[0])
    assert set(codes) <= {ExitCode.OK, ExitCode.PARTIAL, ExitCode.FAILURE, ExitCode.USAGE}
    assert codes.count(ExitCode.OK) + codes.count(ExitCode.PARTIAL) > (0 if question == "check" else 5), codes

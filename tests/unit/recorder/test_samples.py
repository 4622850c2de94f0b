"""What a log holds, as the samples that it was made from."""

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.encoding.protobuf import LOGGED, compile_encoder
from recorder.reading.logs import Faults
from recorder.reading.rows import Row
from recorder.reading.survey import survey
from recorder.replay import (
    ENCODING_BYTES_MAX,
    By,
    KeyMap,
    ReplayRun,
    ReplaySample,
    Samples,
    batch,
    may_hold,
    overlap,
    root_of_token,
    roots_of,
    runs,
    shifted,
)
from schemas import codec, keys
from schemas.can_word import ERROR, EXTENDED, REMOTE
from schemas.messages import CanFrames, Gear, RawSample
from schemas.subjects import ALL_SUBJECTS, BY_TYPE, RECORDER_SUBJECTS, Subject
from tests.support.drives import drive_samples, write_samples
from tests.support.messages import MS, ROBOT, WALL_NS, FakeSample, can_frame, gear, key_of, sample_of
from tests.support.reading import logs_of, raw_row, rows_of, topic
from tests.support.strategies import message_of


def every_key(_key: str) -> bool:
    """Wants all."""
    return True


def replayed(path: Path, root: str = "replay") -> tuple[list[ReplaySample], Samples]:
    """All samples of a log."""
    found = Samples(KeyMap(root, roots_of(survey(logs_of(path), Faults()).topics.values())), every_key, Faults())
    return list(found.of(runs(rows_of(path), By.LOG))), found


def test_the_payloads_are_those_that_were_recorded(tmp_path: Path) -> None:
    """Byte by byte, in their order, with their encoding and attachment, under the other root."""
    samples = drive_samples()
    found, _ = replayed(write_samples(tmp_path / "log.mcap", samples))
    assert [one.key for one in found] == ["replay" + one.key.removeprefix("fleet") for one in samples]
    assert [one.encoding for one in found] == [one.encoding for one in samples]
    assert [one.attachment for one in found] == [one.attachment for one in samples]
    batches = BY_TYPE[CanFrames].encoding
    for one, sample in zip(found, samples, strict=True):
        if sample.encoding != batches:
            assert one.payload() == sample.payload
            continue
        # Of a batch the log does not keep its own time, which is that of its last frame at the earliest.
        was, now = codec.decode(BY_TYPE[CanFrames], sample.payload), one.message
        assert isinstance(was, CanFrames)
        assert isinstance(now, CanFrames)
        assert now == shifted_to(was, max(was.frame_time_ns))


def shifted_to(one: CanFrames, time_ns: int) -> CanFrames:
    """With another time of its own, and the frames' as they were."""
    return CanFrames(
        time_ns, one.sequence, one.bus, 0, one.frame_time_ns, one.can_id, one.fd_flags, one.length, one.data
    )


PLAIN_SUBJECTS = [subject for subject in ALL_SUBJECTS if subject.type is not CanFrames]


@pytest.mark.parametrize("subject", PLAIN_SUBJECTS, ids=lambda subject: subject.schema_name)
@given(data=st.data())
def test_every_message_comes_back_as_it_was(subject: Subject, data: st.DataObject) -> None:
    """Of every subject, whatever its fields hold: record, typed message, payload."""
    message = data.draw(message_of(subject.type))
    is_own = subject in RECORDER_SUBJECTS
    key = keys.of_recorder("fleet", "bench", subject.name) if is_own else keys.build("fleet", ROBOT, subject)
    of = topic(key, subject.type)
    row = Row(of, message.sequence, WALL_NS, WALL_NS, compile_encoder(subject.type)(message))
    faults = Faults()
    (found,) = Samples(KeyMap("replay", ["fleet"]), every_key, faults).of([ReplayRun(WALL_NS, of, [row])])
    assert found.encoding == subject.encoding
    assert codec.decode(subject, found.payload()) == message
    assert not faults


def test_frames_become_the_words_that_they_were() -> None:
    """Identifier and kind in one."""
    found = batch(
        [
            can_frame(0x123, WALL_NS + 5, b"", is_extended=False, is_remote=True),
            can_frame(0x18C4D1EF, WALL_NS),
            can_frame(4, WALL_NS + 2, is_extended=False, is_error=True),
        ],
        9,
    )
    assert found.can_id == [0x123 | REMOTE, 0x18C4D1EF | EXTENDED, 4 | ERROR]
    assert (found.sequence, found.time_ns, found.dropped) == (9, WALL_NS + 5, 0)


def test_a_command_is_never_published() -> None:
    """Whatever the log holds, and whoever asks for it."""
    new_key = KeyMap("replay", ["fleet"])
    of = topic("fleet/cruiser-1/@cmd/operator-1/stop", RawSample)
    samples = Samples(new_key, every_key, Faults())
    commands = [
        "fleet/cruiser-1/@cmd/operator-1/stop",
        "@cmd",
        "@cmd/x",
        "a/@cmd",
        "fleet/@recorder/bench/@cmd/operator-1/stop",
    ]
    rows = [raw_row(of, RawSample(0, key, "", b"", b"", "")) for key in commands]
    assert list(samples.of(ReplayRun(WALL_NS, of, [row]) for row in rows)) == []
    assert samples.withheld == len(commands)


def test_an_encoding_that_is_too_long_for_zenoh_is_withheld() -> None:
    """In bytes, not in characters."""
    of = topic("fleet/thing/@raw", RawSample)
    samples = Samples(KeyMap("replay", ["fleet"]), every_key, Faults())
    longest = "x" * ENCODING_BYTES_MAX
    said = [RawSample(0, "fleet/thing", one, b"", b"", "") for one in (longest, f"{longest}x", f"{longest[1:]}é")]
    assert [one.encoding for one in samples.of(ReplayRun(WALL_NS, of, [raw_row(of, raw)]) for raw in said)] == [
        longest
    ]
    assert samples.withheld == 2


@pytest.mark.parametrize(
    ("roots", "key", "new_key"),
    [
        # A key that names several things, or none, is never published.
        *(
            ("fleet", key, None)
            for key in ("**", "fleet/*/state", "fleet/$*/x", "", "/x", "x/", "x//y", "x?y", "x#y")
        ),
        # A root of several chunks is one root; others, and what only begins like it, are put behind the new one.
        ("site/fleet", "site/fleet/cruiser-1/state", "replay/cruiser-1/state"),
        ("site/fleet", "site/fleets/x", "replay/site/fleets/x"),
        ("site/fleet", "x/y", "replay/x/y"),
        # Where a log has several roots, each is kept: two robots of one name stay two.
        ("fleet other", "fleet/cruiser-1/state", "replay/fleet/cruiser-1/state"),
        ("fleet other", "other/cruiser-1/state", "replay/other/cruiser-1/state"),
    ],
)
def test_a_key_is_put_under_the_new_root(roots: str, key: str, new_key: str | None) -> None:
    """A log may hold anything."""
    assert KeyMap("replay", roots.split())(key) == new_key


@given(st.text(max_size=40))
def test_whatever_a_log_says_stays_under_the_root(key: str) -> None:
    """And is no command, and reaches one key alone."""
    found = KeyMap("replay", ["fleet"])(key)
    if found is not None:
        assert found.startswith("replay/")
        assert "@cmd" not in found.split("/")
        assert not set("*$?#") & set(found)


@pytest.mark.parametrize(
    ("one", "other", "is_one"),
    [
        ("fleet", "fleet", True),
        ("fleet", "fleet/old", True),
        ("a/b", "a", True),
        ("fleet", "fleets", False),
        ("replay", "fleet", False),
    ],
)
def test_roots_overlap_by_chunks(one: str, other: str, is_one: bool) -> None:  # noqa: FBT001 - a column of the table
    """What is under fleet/old is recorded by whoever records fleet."""
    assert overlap(one, other) is is_one
    assert overlap(other, one) is is_one


def test_the_root_of_a_gateway_is_all_before_its_robot() -> None:
    """As its token has it."""
    assert root_of_token(keys.liveliness("site/fleet", "cruiser-1")) == "site/fleet"


def test_what_never_was_a_sample_is_passed_over() -> None:
    """Lines for viewers, other makers' messages, and a schema of ours under a key of another."""
    assert not may_hold(topic("fleet/cruiser-1/safety/event/log", Gear), every_key)
    assert not may_hold(topic("fleet/cruiser-1/state", Gear), every_key)
    assert may_hold(topic(key_of(Gear), Gear), every_key)
    samples = Samples(KeyMap("replay", []), every_key, Faults())
    wrong = topic("fleet/cruiser-1/state", Gear)
    assert list(samples.of([ReplayRun(WALL_NS, wrong, [Row(wrong, 0, WALL_NS, WALL_NS, b"")])])) == []


def test_broken_samples_are_published_as_they_were(tmp_path: Path) -> None:
    """Under the key that they had, and those that say that a key is gone say so again."""
    broken = FakeSample(key_of(Gear), BY_TYPE[Gear].encoding, b"\xc1broken")
    gone = FakeSample("fleet/elsewhere", "zenoh/bytes", b"", deleted=True)
    found, _ = replayed(write_samples(tmp_path / "log.mcap", [sample_of(gear(0)), broken, gone]))
    assert [(one.key, one.payload(), one.is_delete) for one in found[1:]] == [
        ("replay/cruiser-1/chassis/gear", broken.payload, False),
        ("replay/elsewhere", b"", True),
    ]


def test_only_wanted_keys_are_published() -> None:
    """Of a channel that samples of several keys share, too: each tells its own."""

    def wants(key: str) -> bool:
        return key == "wanted/x"

    shared = topic("@more", RawSample)
    assert may_hold(shared, wants)
    assert not may_hold(topic("other/@raw", RawSample), wants)
    assert may_hold(topic("wanted/x/@raw", RawSample), wants)
    samples = Samples(KeyMap("replay", []), wants, Faults())
    rows = [raw_row(shared, RawSample(0, key, "", b"", b"", "")) for key in ("wanted/x", "other")]
    assert [one.key for one in samples.of(ReplayRun(WALL_NS, shared, [row]) for row in rows)] == [
        "replay/wanted/x"
    ]
    assert samples.withheld == 0


def test_all_receive_times_move_together() -> None:
    """Of the message and of the frames in it; nothing else moves, and no time leaves its bounds."""
    one = batch([can_frame(time_ns=WALL_NS), can_frame(time_ns=WALL_NS + MS)], 3)
    later = shifted(one, 5 * MS)
    assert isinstance(later, CanFrames)
    assert later.frame_time_ns == [WALL_NS + 5 * MS, WALL_NS + 6 * MS]
    assert (later.time_ns, later.sequence, later.data) == (WALL_NS + 6 * MS, 3, one.data)
    assert shifted(gear(1), -(2**63)).time_ns == 0
    assert shifted(gear(1), 2**63).time_ns == 2**63 - 1
    sample = ReplaySample(WALL_NS, "replay/x", "", raw=b"as it was")
    assert sample.payload(MS) == b"as it was"


@given(st.sampled_from(LOGGED), st.binary(max_size=60))
def test_bytes_that_are_no_message_are_a_fault(kind: type[msgspec.Struct], data: bytes) -> None:
    """Told and passed over; what can be read all the same is a sample."""
    name = "fleet/elsewhere" if kind is RawSample else "fleet/cruiser-1/can/can0/rx"
    subject = next((one for one in ALL_SUBJECTS if one.type is kind), None)
    if subject is not None and subject.type is not CanFrames:
        name = f"fleet/cruiser-1/{subject.name}"
    of = topic(name, kind)
    faults = Faults()
    row = Row(of, 0, WALL_NS, WALL_NS, data)
    found = list(Samples(KeyMap("replay", ["fleet"]), every_key, faults).of([ReplayRun(WALL_NS, of, [row])]))
    assert len(found) + faults.count <= 1
    for one in found:
        one.payload()

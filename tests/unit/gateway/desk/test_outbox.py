"""What waits for a browser: a slow one gets the newest, and is cut off only where it reads nothing."""

import msgspec

from gateway.desk.words import (
    SAMPLES_WAITING,
    WAITING,
    BrowserOutbox,
    DeskRefused,
    DeskRows,
    DeskSample,
    RobotRow,
    ToBrowser,
)

ROW = RobotRow(0, "ready", "", "", 0.0, 1.0, None, 0, "", 0)


def sample(number: int) -> DeskSample:
    """A sample of the robot that is shown closely."""
    return DeskSample("state", "fleet/cruiser-1/state", "", bytes([number % 256]), b"")


def rows_of(messages: list[ToBrowser]) -> DeskRows:
    """The rows among what is sent."""
    (rows,) = (one for one in messages if isinstance(one, DeskRows))
    return rows


def test_rows_that_wait_are_merged() -> None:
    """The newest of each robot is sent, once; then nothing more."""
    outbox = BrowserOutbox()
    newer = msgspec.structs.replace(ROW, word="driving")
    outbox.add_rows({"a": ROW, "b": ROW}, [], linked=False)
    outbox.add_rows({"a": newer, "c": None}, None, linked=True)
    rows = rows_of(outbox.take())
    assert rows.rows == {"a": newer, "b": ROW, "c": None}
    assert (rows.linked, rows.recorders) == (True, [])
    assert outbox.take() == []


def test_samples_that_wait_too_long_go() -> None:
    """The oldest first; those of a robot that is not looked at any more go at once."""
    outbox = BrowserOutbox()
    outbox.look("cruiser-1")
    for number in range(SAMPLES_WAITING + 3):
        outbox.add(sample(number))
    taken = [one.payload[0] for one in outbox.take() if isinstance(one, DeskSample)]
    assert taken == list(range(3, SAMPLES_WAITING + 3))
    outbox.add(sample(0))
    outbox.look("cruiser-2")
    assert outbox.take() == []


def test_who_reads_nothing_is_cut_off() -> None:
    """After some hundred replies; memory does not grow."""
    outbox = BrowserOutbox()
    for _ in range(WAITING):
        outbox.add(DeskRefused("no"))
    assert not outbox.is_full
    for _ in range(10):
        outbox.add(DeskRefused("no"))
    assert outbox.is_full
    assert len(outbox.take()) == WAITING

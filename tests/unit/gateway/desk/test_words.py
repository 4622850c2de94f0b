"""Messages of a browser, and the queue for one: a slow browser gets the newest."""

from typing import Any

import msgspec
import pytest

from gateway.desk import words
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

ASK = {
    "is": "ask",
    "number": 1,
    "robot": "cruiser-1",
    "operator": "ann",
    "verb": "acquire",
    "payload": b"\x80",
    "attachment": b"",
}


def said(message: object) -> words.FromBrowser:
    return words.decode(msgspec.msgpack.encode(message))


@pytest.mark.parametrize(
    "change",
    [
        {"robot": "*"},
        {"robot": "**"},
        {"robot": "a/b"},
        {"robot": "cruiser-1\n"},
        {"robot": "c$*"},
        {"operator": ""},
        {"operator": "ann/../bob"},
        {"operator": "a" * 65},
        {"operator": "*"},
        {"number": -1},
        {"number": 2**32},
        {"payload": bytes(1025)},
        {"attachment": bytes(129)},
        {"payload": "text"},
        {"more": 1},
        {"is": "_said"},
        {"is": ""},
    ],
)
def test_what_is_not_of_its_form_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        said({**ASK, **change})


ROW = RobotRow(0, "ready", "", "", 0.0, 1.0, None, 0, "")


def sample(number: int) -> DeskSample:
    return DeskSample("state", "fleet/cruiser-1/state", "", bytes([number % 256]), b"")


def rows_of(messages: list[ToBrowser]) -> DeskRows:
    (rows,) = (one for one in messages if isinstance(one, DeskRows))
    return rows


def test_rows_that_wait_are_merged() -> None:
    outbox = BrowserOutbox()
    newer = msgspec.structs.replace(ROW, word="driving")
    outbox.add_rows({"a": ROW, "b": ROW}, [], linked=False)
    outbox.add_rows({"a": newer, "c": None}, None, linked=True)
    rows = rows_of(outbox.take())
    assert rows.rows == {"a": newer, "b": ROW, "c": None}
    assert (rows.linked, rows.recorders) == (True, [])
    assert outbox.take() == []


def test_samples_that_wait_too_long_go() -> None:
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
    outbox = BrowserOutbox()
    for _ in range(WAITING):
        outbox.add(DeskRefused("no"))
    assert not outbox.is_full
    for _ in range(10):
        outbox.add(DeskRefused("no"))
    assert outbox.is_full
    assert len(outbox.take()) == WAITING

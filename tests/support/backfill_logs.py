"""Logs of chosen messages, with chosen faults, and what is in a log."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from io import BytesIO
from pathlib import Path

import msgspec
from mcap.reader import make_reader

from recorder.backfill.excerpt import Excerpt, LogCopy
from recorder.backfill.holes import HoleFinder
from recorder.encoding.protobuf_schema import descriptor_set, message_class, schema_name
from recorder.mcap.channel import LogChannel
from recorder.mcap.log_map import LogMap
from schemas.messages import CanFrame, GatewayHealth, GatewayInfo, Gear, RawSample
from schemas.recording import Backfill, BackfillPiece, RecordGap
from tests.support.logs import mcap_log

ROBOT = "fleet/cruiser-1"
GEAR, RX, HEALTH = f"{ROBOT}/chassis/gear", f"{ROBOT}/can/can0/rx", f"{ROBOT}/gateway/health"
CAMERA = f"{ROBOT}/camera"
INFO = f"{ROBOT}/gateway/info"
GAP = "fleet/@recorder/depot/gap"
START_NS = 1_800_000_000_000_000_000
MS = 1_000_000
SECOND = 1_000_000_000

_KINDS: dict[str, type[msgspec.Struct]] = {
    GEAR: Gear,
    RX: CanFrame,
    HEALTH: GatewayHealth,
    CAMERA: RawSample,
    INFO: GatewayInfo,
    GAP: RecordGap,
}


class Row(msgspec.Struct, frozen=True, order=True):
    """A message in a log."""

    publish_ns: int
    topic: str
    sequence: int
    log_ns: int
    data: bytes


def row(sequence: int, at_ms: float, topic: str = GEAR, data: bytes = b"", lag_ms: float = 5) -> Row:
    """A message that was published so long after the start, and received a little later."""
    publish_ns = START_NS + round(at_ms * MS)
    return Row(publish_ns, topic, sequence, publish_ns + round(lag_ms * MS), data)


def gear_rows(count: int, period_ms: float = 100, first: int = 0, at_ms: float = 0) -> list[Row]:
    """A topic without a loss."""
    return [row(first + number, at_ms + number * period_ms) for number in range(count)]


def gap_row(key: str, first_ns: int, last_ns: int, count: int, at_ms: float = 0) -> Row:
    """What a recorder writes of messages that it dropped."""
    message = message_class(RecordGap)(key=key, first_ns=first_ns, last_ns=last_ns, count=count)
    return row(0, at_ms, GAP, message.SerializeToString())


def channel_of(topic: str, number: int, schema_data: bytes | None = None) -> LogChannel:
    """The channel of a topic."""
    kind = _KINDS.get(topic, Gear)
    return LogChannel(number, topic, schema_name(kind), schema_data or descriptor_set(kind))


def log_of(
    rows: Iterable[Row],
    chunk_messages: int = 10,
    *,
    is_finished: bool = True,
    schema_data: bytes | None = None,
) -> bytes:
    """A log in the order in which the messages are given."""
    found = list(rows)
    numbers = {topic: number for number, topic in enumerate(dict.fromkeys(one.topic for one in found), start=1)}
    messages = [(numbers[one.topic], one.sequence, one.log_ns, one.publish_ns, one.data) for one in found]
    return mcap_log(
        [channel_of(topic, number, schema_data) for topic, number in numbers.items()],
        [messages[at : at + chunk_messages] for at in range(0, len(messages), chunk_messages)],
        is_finished=is_finished,
    )


def rows_in(data: bytes) -> list[Row]:
    """The messages of a whole file, as the mcap package reads them with all checksums."""
    reader = make_reader(BytesIO(data), validate_crcs=True)
    return [
        Row(one.publish_time, channel.topic, one.sequence, one.log_time, one.data)
        for _, channel, one in reader.iter_messages(log_time_order=False)
    ]


def rows_of(pieces: Iterable[BackfillPiece]) -> list[Row]:
    """The messages of pieces, in their order."""
    return [one for piece in pieces if piece.mcap for one in rows_in(piece.mcap)]


def map_of(data: bytes) -> LogMap:
    """The map of a log."""
    chart = LogMap()
    chart.read_on(BytesIO(data), len(data))
    return chart


def copies(*logs: bytes) -> list[LogCopy]:
    """Logs to read from, in memory."""
    return [LogCopy(f"log-{number}", _opener(data), map_of(data)) for number, data in enumerate(logs)]


def _opener(data: bytes) -> Callable[[], BytesIO]:
    return lambda: BytesIO(data)


def excerpt(
    logs: Sequence[bytes],
    from_ms: float = 0,
    to_ms: float = 1e9,
    max_bytes: int = 16_000_000,
    is_wanted: Callable[[str], bool] = lambda _: True,
) -> list[BackfillPiece]:
    """What logs answer."""
    request = Backfill("**", START_NS + round(from_ms * MS), START_NS + round(to_ms * MS), max_bytes)
    return list(Excerpt(copies(*logs), is_wanted, request, lambda: False).pieces())


def found_in(*logs: bytes) -> HoleFinder:
    """What finds the holes of logs."""
    finder = HoleFinder()
    for data in logs:
        chart = map_of(data)
        finder.add(chart.channels, chart.messages(BytesIO(data)))
    return finder


class Recorder:
    """Another recorder, without Zenoh: answers out of its logs, and loses pieces on demand."""

    def __init__(self, *logs: bytes, lost: Iterable[int] = ()) -> None:
        self.requests: list[Backfill] = []
        self._copies = copies(*logs)
        self._lost = set(lost)
        self._sent = 0

    def ask(self, request: Backfill) -> Iterator[BackfillPiece]:
        """The pieces that arrive."""
        self.requests.append(request)
        for piece in Excerpt(self._copies, lambda topic: matches(request.key, topic), request, bool).pieces():
            self._sent += 1
            if self._sent not in self._lost:
                yield piece


def matches(expression: str, topic: str) -> bool:
    """As Zenoh matches, as far as tests need it."""
    return topic == expression or (expression.endswith("/**") and topic.startswith(expression[:-2]))


def write(path: Path, data: bytes) -> Path:
    """A log on the disk, last written when its messages were, or later."""
    path.write_bytes(data)
    os.utime(path, ns=(0, START_NS + 86_400 * SECOND))
    return path

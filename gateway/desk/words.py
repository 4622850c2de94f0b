"""Messages between browsers and the desk, and the queue of each browser. Pure.

Messages are MessagePack maps over a WebSocket; ``is`` is their type. A queue merges rows and drops old samples.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from schemas.keys import KEY_MAX_LENGTH, OPERATOR_PATTERN, ROBOT_PATTERN

FROM_BROWSER_BYTES: Final = (
    24_576  # the largest message of a browser: a statement of the authority, and its envelope
)

# Names of any length that a key allows, so that every robot on show can be stopped.
_Robot = Annotated[str, Meta(pattern=rf"\A{ROBOT_PATTERN}\Z", max_length=KEY_MAX_LENGTH)]
_RobotOrNone = Annotated[str, Meta(pattern=rf"\A({ROBOT_PATTERN})?\Z", max_length=KEY_MAX_LENGTH)]
_Operator = Annotated[str, Meta(pattern=rf"\A{OPERATOR_PATTERN}\Z", max_length=64)]
_Number = Annotated[int, Meta(ge=0, lt=2**32)]
_Payload = Annotated[bytes, Meta(max_length=1024)]
_Attachment = Annotated[bytes, Meta(max_length=128)]
_Statement = Annotated[bytes, Meta(max_length=16_384)]


def _tag(name: str) -> str:
    return name.removeprefix("Browser").removeprefix("Desk").lower()


class _Said(msgspec.Struct, frozen=True, tag_field="is", tag=_tag, forbid_unknown_fields=True):
    """A message of a browser. Unknown fields are refused."""


class BrowserLook(_Said, frozen=True):
    """Show this robot in detail from now on; none if empty."""

    robot: _RobotOrNone


class BrowserAsk(_Said, frozen=True):
    """Send a verb to a robot as a query. The bytes are passed on unchanged, so signatures stay valid."""

    number: _Number  # comes back with the replies
    robot: _Robot
    operator: _Operator
    verb: Annotated[str, Meta(max_length=32)]
    payload: _Payload  # the request's MessagePack
    attachment: _Attachment  # its proof; empty in open mode


class BrowserDrive(_Said, frozen=True):
    """A drive command, passed on unchanged."""

    robot: _Robot
    operator: _Operator
    payload: _Payload
    attachment: _Attachment


class BrowserShow(_Said, frozen=True):
    """Send a robot a statement of the authority."""

    number: _Number  # comes back with the replies
    robot: _Robot
    statement: _Statement  # text
    question: _Attachment  # random bytes, which the robot's reply is signed over


class BrowserStop(_Said, frozen=True):
    """Stop a robot remotely, or all robots if empty. Needs no proof."""

    robot: _RobotOrNone
    operator: _Operator  # who stops


class BrowserAcknowledge(_Said, frozen=True):
    """Say who handles a robot's alarm."""

    robot: _Robot
    word: Annotated[str, Meta(max_length=32)]  # what it suffers, as its row says
    operator: _Operator  # who sees to it


FromBrowser = BrowserLook | BrowserAsk | BrowserDrive | BrowserShow | BrowserStop | BrowserAcknowledge


class _Told(msgspec.Struct, frozen=True, tag_field="is", tag=_tag):
    """A message of the desk."""


class DeskHello(_Told, frozen=True):
    """The first message.

    Attributes:
        requests: encodings of request and reply, by verb.
        reasons: meaning and cure, in English; ROBOT in a cure stands for the robot's name.
        statement_reply: encoding of the reply to a statement.
        period_s: of the points of a history.
    """

    root: str
    requests: dict[str, tuple[str, str]]
    reasons: dict[str, tuple[str, str]]
    statement_reply: str
    period_s: float
    has_logs: bool


class DeskRows(_Told, frozen=True):
    """Changed rows of the overview; null: gone."""

    rows: dict[str, RobotRow | None]
    linked: bool  # the desk is connected to Zenoh
    recorders: list[RecorderRow] | None = None  # all recorders, if they changed
    full: bool = False  # there are more robots, or recorders, than the desk shows


class RobotRow(msgspec.Struct, frozen=True):
    """A robot in the overview."""

    level: int  # 0 nothing is wrong, 1 somebody should look, 2 it needs a person
    word: str  # what it does or suffers, one of the words of ``robot_word.WORDS``.
    text: str  # the same with figures, in English
    driver: str  # the lease holder; empty if none
    speed_mps: float | None  # speed_mps, limit_mps: measured, and the limit in force; null if not known
    limit_mps: float | None
    link_age_s: float | None  # age of the drive commands; null without any
    lost: int | None  # feedback frames that were lost since its gateway's start; null if not known
    event: str  # the last warning or error, in English
    acknowledged: str = ""  # who handles its alarm; empty if none
    reasons: list[str] = []  # why it has this word, for pages in other languages; empty where nothing is wrong


class RecorderRow(msgspec.Struct, frozen=True):
    """A recorder in the overview."""

    name: str
    state: str
    robots: int
    lost: int
    disk_free_bytes: int | None


class DeskSample(_Told, frozen=True):
    """A sample of the robot on show, unchanged, so that its signature can be verified."""

    subject: str
    key: str
    encoding: str
    payload: bytes
    attachment: bytes


class DeskWhy(_Told, frozen=True):
    """Why the robot on show does not move, in the words of ``cruiser why``."""

    robot: str
    reasons: list[tuple[str, str, str]]  # each with its meaning and its cure
    notes: list[str]  # what else should be seen to
    since_s: float  # time with this word, as the desk has seen it


class DeskHistory(_Told, frozen=True):
    """The last minutes of the robot on show, a point per ``period_s``; null: unknown."""

    robot: str
    age_s: float  # of the newest point
    values: dict[str, list[float | None]]  # of each field of ``history.FIELDS``, the oldest first.


class DeskPose(_Told, frozen=True):
    """The pose of the robot on show, in the axes of its history."""

    robot: str
    x_m: float
    y_m: float
    heading_rad: float


class DeskReply(_Told, frozen=True):
    """A reply to ``BrowserAsk`` or ``BrowserShow``, unchanged; ``last`` ends the replies, and carries none."""

    number: int
    last: bool
    key: str = ""
    encoding: str = ""
    payload: bytes = b""
    attachment: bytes = b""


class DeskStopped(_Told, frozen=True):
    """The outcome of a remote stop.

    Attributes:
        robot: empty for all.
        standing: robots that replied, and are seen to stand with the stop latched.
        refused, unconfirmed: other robots that replied, and why they cannot or may not stand.
        silent: connected robots without a reply.
        counted: all connected robots are known.
    """

    robot: str
    standing: list[str]
    refused: dict[str, str]
    unconfirmed: dict[str, str]
    silent: list[str]
    counted: bool


class DeskRefused(_Told, frozen=True):
    """Why a browser's message was not carried out.

    Attributes:
        stop: the robot of a stop with unknown outcome, empty for all; null if it was no stop.
    """

    fault: str
    stop: str | None = None


ToBrowser = (
    DeskHello | DeskRows | DeskSample | DeskWhy | DeskHistory | DeskPose | DeskReply | DeskStopped | DeskRefused
)

decode: Final[Callable[[bytes], FromBrowser]] = msgspec.msgpack.Decoder(FromBrowser).decode
"""Decode a browser's message. Raises only ``msgspec.DecodeError`` or ``msgspec.ValidationError``."""

encode: Final = msgspec.msgpack.Encoder().encode


SAMPLES_WAITING: Final = 64  # samples of the robot on show, a second of them; beyond it the oldest go
WAITING: Final = 512  # replies and all else that may wait; a browser that reads fewer is cut off


class BrowserOutbox:
    """Messages that wait for one browser.

    Attributes:
        robot: the one on show; empty if none.
        is_full: the browser does not read, and should be disconnected.
    """

    def __init__(self) -> None:
        self.robot = ""
        self.is_full = False
        self._messages: deque[ToBrowser] = deque()
        self._samples: deque[DeskSample] = deque(maxlen=SAMPLES_WAITING)
        self._rows: dict[str, RobotRow | None] = {}
        self._recorders: list[RecorderRow] | None = None
        self._linked: bool | None = None
        self._full = False

    def look(self, robot: str) -> None:
        """Show another robot, and drop samples of the former one."""
        self.robot = robot
        self._samples.clear()

    def add(self, message: ToBrowser) -> None:
        """Add a message that must not be dropped."""
        if isinstance(message, DeskSample):
            self._samples.append(message)
        elif len(self._messages) < WAITING:
            self._messages.append(message)
        else:
            self.is_full = True

    def add_rows(
        self,
        rows: dict[str, RobotRow | None],
        recorders: list[RecorderRow] | None,
        *,
        linked: bool,
        full: bool = False,
    ) -> None:
        """Add changed rows; they replace waiting ones."""
        self._rows |= rows
        self._recorders = self._recorders if recorders is None else recorders
        self._linked, self._full = linked, full

    def take(self) -> list[ToBrowser]:
        """Remove and return all messages."""
        taken: list[ToBrowser] = [*self._messages]
        self._messages.clear()
        if self._linked is not None:
            taken.append(DeskRows(self._rows, self._linked, self._recorders, self._full))
            self._rows, self._recorders, self._linked = {}, None, None
        taken += self._samples
        self._samples.clear()
        return taken

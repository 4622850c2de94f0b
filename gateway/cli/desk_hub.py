"""Between Zenoh and the browsers: one listener for all of them, and one session for what they ask.

All of it runs on one thread. What robots publish waits in Zenoh's rings until the hub looks for it.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from importlib.metadata import version
from typing import Final

import msgspec

from gateway.client.remote_stop import StopReport, stop_from_here
from gateway.desk import history, words
from gateway.desk.fleet_view import FleetView
from gateway.desk.outbox import BrowserOutbox
from gateway.desk.overview import reasons_in_words
from gateway.telemetry.received import Received
from gateway.zenoh.client import DeskListener, PendingQuery
from gateway.zenoh.operator import CommandPort
from schemas import keys
from schemas.command_line import CommandError
from schemas.cruiser import WHEELBASE_M
from schemas.settings import Settings
from schemas.subjects import BY_VERB, STATEMENT_REPLY_ENCODING, STOP_VERB

log = logging.getLogger(__name__)

POLL_S: Final = 0.01
"""The period in which arrivals are taken from Zenoh, and sent on to who looks at their robot."""

ROWS_S: Final = 0.2
"""The period of the overview, sent also where nothing has changed: a page that receives nothing has no contact."""

LATE_NS: Final = 1_000_000_000
"""After a pause of so long the states that have waited are old, and passed over: newer ones come at once."""

AGEING: Final = ("/state", "/gateway/health")

ASK_S: Final = 3.0
"""The longest wait for the replies to a question."""

STOP_S: Final = 5.0

QUESTIONS_MAX: Final = 32
"""Questions of one browser that may be under way."""

REPLIES_MAX: Final = 64
"""Replies to one question that are passed on: nobody answers so often but who floods."""

STOPS_MAX: Final = 4
"""Stops of one browser whose outcomes are looked for at a time; another is sent, and its outcome not known."""

STOP_THREADS: Final = 16

LOOK_NS: Final = 500_000_000
"""The last minutes of a robot are sent to one browser at most so often: making them takes milliseconds."""

SAMPLE_MAX_BYTES: Final = 65_536
"""A larger sample or reply is of no gateway, and is passed over. Their own have a few kilobytes."""

EVENT: Final = "safety/event"

CLOSE: Final = ("state", "safety/state", EVENT, "gateway/health")
"""The subjects of a robot that is shown closely."""

REQUESTS: Final = {verb: (command.encoding, command.reply_encoding) for verb, command in sorted(BY_VERB.items())}

Stopper = Callable[[Settings, str, str, float], StopReport]


class Browser:
    """One browser that is connected.

    Attributes:
        outbox: what waits to be sent to it.
        ready: set when something does.
        questions: those under way, by the browser's own numbers.
        replies: how many came to each of them.
        stops: robots that it has stopped, as long as the outcome is looked for.
        is_new_look: it has not got the last minutes of the robot that it looks at.
        looked_ns: when it got some last.
    """

    def __init__(self) -> None:
        self.outbox = BrowserOutbox()
        self.ready = asyncio.Event()
        self.questions: dict[int, PendingQuery] = {}
        self.replies: Counter[int] = Counter()
        self.stops: set[str] = set()
        self.is_new_look = False
        self.looked_ns: int | None = None

    def tell(self, message: words.ToBrowser) -> None:
        """Send a message, as soon as the browser reads it."""
        self.outbox.add(message)
        self.ready.set()


class Hub:
    """Carries samples to browsers, and what they ask to robots."""

    def __init__(
        self,
        settings: Settings,
        listener: DeskListener,
        port: CommandPort,
        stopper: Stopper = stop_from_here,
        sites: Sequence[tuple[str, str]] = (),
        *,
        has_logs: bool = False,
    ) -> None:
        """Use a listener to all robots, and a session that nothing but commands is on."""
        self._settings = settings
        self._root = settings.robot.root
        self._listener = listener
        self._port = port
        self._stopper = stopper
        self._has_logs = has_logs
        # A thread for each stop that is under way: one that waits for a silent robot holds up no other.
        self._threads: Executor = ThreadPoolExecutor(STOP_THREADS, thread_name_prefix="stop")
        self._stopping: dict[str, set[Browser]] = {}
        self._view = FleetView(self._root, sites)
        self._browsers: set[Browser] = set()
        self._now_ns = self._rows_ns = 0

    def join(self) -> Browser:
        """Let a browser in. It is told what the desk is, and all rows."""
        browser = Browser()
        browser.tell(
            words.DeskHello(
                root=self._root,
                version=version("cruiser-gateway"),
                requests=REQUESTS,
                reasons=reasons_in_words(),
                statement_reply=STATEMENT_REPLY_ENCODING,
                period_s=history.PERIOD_NS / 1e9,
                wheelbase_m=WHEELBASE_M,
                has_logs=self._has_logs,
            )
        )
        rows, recorders = self._view.all_rows()
        browser.outbox.add_rows(rows, recorders, linked=self._listener.connected(), full=self._view.is_full)
        self._browsers.add(browser)
        return browser

    def leave(self, browser: Browser) -> None:
        """A browser has gone."""
        self._browsers.discard(browser)

    async def run(self, ends: Callable[[], bool]) -> None:
        """Carry until the end."""
        while not ends():
            self.step(time.monotonic_ns())
            await asyncio.sleep(POLL_S)

    def step(self, now_ns: int) -> None:
        """Take what has arrived, and give each browser what it looks at."""
        is_late = 0 < self._now_ns < now_ns - LATE_NS
        self._now_ns = now_ns
        self._carry_arrivals(is_late=is_late)
        for browser in self._browsers:
            self._carry_replies(browser)
            self._show_history(browser)
        if now_ns - self._rows_ns < ROWS_S * 1e9:
            return
        self._rows_ns = now_ns
        linked = self._listener.connected()
        self._view.update(now_ns, linked=linked)
        rows, recorders = self._view.changed_rows(now_ns)
        for browser in self._browsers:
            browser.outbox.add_rows(rows, recorders, linked=linked, full=self._view.is_full)
            browser.ready.set()
            if browser.outbox.robot and (why := self._view.why(browser.outbox.robot, now_ns)) is not None:
                browser.tell(why)

    def receive(self, browser: Browser, data: bytes) -> None:
        """Do what a browser says. Whatever cannot be read, or done, is answered in words."""
        try:
            self._obey(browser, words.decode(data))
        except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
            browser.tell(words.DeskRefused(f"the desk cannot read this: {error}"))
        except (CommandError, ValueError) as error:
            browser.tell(words.DeskRefused(str(error)))

    def _obey(self, browser: Browser, said: words.FromBrowser) -> None:
        match said:
            case words.BrowserLook(robot=robot):
                browser.outbox.look(robot)
                browser.is_new_look = bool(robot)
                self._show_history(browser)
            case words.BrowserDrive():
                key = keys.command(self._root, said.robot, said.operator, "drive")
                self._port.put_signed(key, "drive", said.payload, said.attachment)
            case words.BrowserStop():
                self._stop(browser, said)
            case words.BrowserAsk():
                if said.verb not in REQUESTS:
                    raise ValueError(f"there is no verb {said.verb!a}")
                key = keys.command(self._root, said.robot, said.operator, said.verb)
                self._ask(browser, said.number, key, BY_VERB[said.verb].encoding, said.payload, said.attachment)
            case words.BrowserAcknowledge():
                if not self._view.shows(said.robot):
                    raise ValueError(f"no robot {said.robot} is heard")
                self._view.acknowledge(said.robot, said.word, said.operator)
            case words.BrowserShow():
                key = keys.authority(self._root, said.robot)
                self._ask(browser, said.number, key, "text/plain", said.statement, said.question)

    def _show_history(self, browser: Browser) -> None:
        """Give a browser the last minutes of the robot that it looks at, once, as soon as it may have them."""
        is_early = browser.looked_ns is not None and self._now_ns - browser.looked_ns < LOOK_NS
        if not browser.is_new_look or is_early:
            return
        browser.is_new_look, browser.looked_ns = False, self._now_ns
        robot = browser.outbox.robot
        browser.tell(self._view.histories.of(robot, time.monotonic_ns()))
        for event in self._view.events(robot):
            browser.tell(_sample(EVENT, event))

    def _ask(
        self, browser: Browser, number: int, key: str, encoding: str, payload: bytes, attachment: bytes
    ) -> None:
        if len(browser.questions) >= QUESTIONS_MAX or number in browser.questions:
            raise ValueError("too many questions are under way: wait for their replies")
        question = PendingQuery()
        browser.questions[number] = question
        self._port.query(key, question, payload, encoding, attachment, ASK_S)

    def _stop(self, browser: Browser, said: words.BrowserStop) -> None:
        """Say it at once on the session that is open; what came of it is looked for on sessions of its own.

        Who stops a robot that is being stopped learns the same: it is of the end, when both were said.
        """
        robot = said.robot or keys.ALL
        self._port.put_signed(keys.command(self._root, robot, said.operator, STOP_VERB), STOP_VERB, b"", b"")
        if len(browser.stops | {robot}) > STOPS_MAX:
            fault = "the stop was sent; what comes of it is not looked for, since too many are under way"
            browser.tell(words.DeskRefused(fault, stop=said.robot))
            return
        browser.stops.add(robot)
        if robot in self._stopping:
            self._stopping[robot].add(browser)
            return
        self._stopping[robot] = {browser}
        log.warning("%s stops %s", said.operator, said.robot or "all robots")
        loop = asyncio.get_running_loop()
        future = loop.run_in_executor(self._threads, self._stopper, self._settings, robot, said.operator, STOP_S)
        future.add_done_callback(lambda done: self._tell_stopped(robot, said.robot, done))

    def _tell_stopped(self, robot: str, named: str, done: asyncio.Future[StopReport]) -> None:
        """Say what came of a stop to all who stopped this robot meanwhile."""
        outcome: words.DeskRefused | words.DeskStopped
        error = done.exception()
        if error is not None:
            outcome = words.DeskRefused(f"it is not known what came of the stop: {error}", stop=named)
        else:
            report = done.result()
            outcome = words.DeskStopped(
                named,
                report.stopped,
                report.refused,
                report.unconfirmed,
                report.silent,
                report.counted and report.linked,
            )
        for browser in self._stopping.pop(robot):
            browser.stops.discard(robot)
            browser.tell(outcome)

    def _carry_arrivals(self, *, is_late: bool) -> None:
        looked_at: dict[str, list[Browser]] = {}
        for browser in self._browsers:
            if browser.outbox.robot:
                looked_at.setdefault(browser.outbox.robot, []).append(browser)
        subjects = {f"{self._root}/{robot}/{name}": (robot, name) for robot in looked_at for name in CLOSE}
        for arrival in self._listener.drain():
            if isinstance(arrival, Received) and _size(arrival) > SAMPLE_MAX_BYTES:
                continue
            if is_late and isinstance(arrival, Received) and arrival.key.endswith(AGEING):
                continue
            self._view.receive(arrival)
            if not isinstance(arrival, Received) or arrival.key not in subjects:
                continue
            robot, name = subjects[arrival.key]
            sample = _sample(name, arrival)
            for browser in looked_at[robot]:
                browser.tell(sample)

    def _carry_replies(self, browser: Browser) -> None:
        for number, question in list(browser.questions.items()):
            for received in question.poll():
                browser.replies[number] += 1
                if browser.replies[number] > REPLIES_MAX or _size(received) > SAMPLE_MAX_BYTES:
                    continue
                browser.tell(
                    words.DeskReply(
                        number,
                        last=False,
                        key=received.key,
                        encoding=received.encoding,
                        payload=received.payload,
                        attachment=received.attachment,
                    )
                )
            if question.is_over:
                del browser.questions[number]
                del browser.replies[number]
                browser.tell(words.DeskReply(number, last=True))


def _size(received: Received) -> int:
    return len(received.key) + len(received.encoding) + len(received.payload) + len(received.attachment)


def _sample(subject: str, received: Received) -> words.DeskSample:
    return words.DeskSample(subject, received.key, received.encoding, received.payload, received.attachment)

"""``cruiser shadow``: a robot's arbiter with other settings, live, beside the one that drives."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib.metadata import version
from typing import Final

import msgspec

from recorder.cli.review.regress import describe_sum
from recorder.cli.review.rerun import add_tried_settings, describe, tried_settings
from recorder.cli.show import show
from recorder.encoding.received_sample import ReceivedSample
from recorder.reading.configurations import settings_from
from recorder.reading.times import in_words
from recorder.reading.topics import UNREADABLE
from recorder.review.rerun.counterfactual import changed_settings
from recorder.review.rerun.minutes import PairRunner
from recorder.review.rerun.player import RerunResult, installed
from recorder.review.rerun.regress import MINUTE_NS, RegressSummary
from recorder.review.rerun.tried_settings import TriedSettings
from recorder.shadow.journal_feed import RESTARTED, JournalFeed
from recorder.shadow.shadow import Shadow, ShadowDifference
from recorder.zenoh.session import said_of
from recorder.zenoh.source import ZenohSource
from schemas import codec, keys
from schemas.arguments import add_zenoh_arguments, ending_after, robot_name, seconds
from schemas.command_rules import COMMAND_RULES, rules_notice
from schemas.decisions import Journal
from schemas.exit_codes import CommandError, ExitCode
from schemas.messages import GatewayInfo
from schemas.printable import plain
from schemas.settings import Settings
from schemas.subjects import BY_NAME, BY_TYPE, KEPT_FIRST

EXAMPLE: Final = """\
  cruiser shadow cruiser-1 --set command.travel_delay_m=0.5
  cruiser shadow cruiser-1 --with other.toml --from-start --json"""
DESCRIPTION: Final = (
    "Runs a second arbiter with other settings on the live journal of a robot, and prints each thing that it "
    "would have decided differently, both ways with their reasons: once a minute for each kind. Begins at the "
    "robot's next checkpoint, which comes within a minute, and so again behind a gap. Ctrl-C ends it with a "
    "summary. Nothing is sent to the robot but the subscription and a question for its configuration. Exit code 1 "
    "if some minute decides otherwise, 3 if something was missing, 4 if the robot does not answer."
)

TIMEOUT_S: Final = 5.0

ASK_AGAIN_S: Final = 1.0
"""A robot that has not said who it is is asked again after this time."""

IDLE_S: Final = 0.02
"""Pause when nothing has come in: the journal comes every 50 ms."""

SILENT_S: Final = 2.0
"""A robot whose journal has not come for so long is silent."""

NO_CHECKPOINT_S: Final = 75.0
"""A checkpoint of this version would have come within this time: there is one a minute."""

SMALL: Final = 0.1
"""Minutes of waiting that are not told."""

QUEUE_SAMPLES: Final = 2000
"""Journals that wait while the loop is held up, a minute and a half's; beyond it the oldest go."""

TICK_SAMPLES: Final = 200
"""Journals that are taken at a time."""

_JOURNAL: Final = BY_TYPE[Journal]
_INFO: Final = BY_NAME["gateway/info"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.description = DESCRIPTION
    parser.add_argument("robot", type=robot_name, metavar="ROBOT", help="the robot")
    add_tried_settings(parser)
    parser.add_argument(
        "--from-start",
        action="store_true",
        help="ask the robot for the journal that it keeps, ten minutes at most, and begin there",
    )
    parser.add_argument("--json", action="store_true", help="print a JSON object a line")
    parser.add_argument(
        "--timeout",
        type=seconds,
        default=TIMEOUT_S,
        metavar="S",
        help=f"how long to wait for the robot ({TIMEOUT_S:g})",
    )
    parser.add_argument("--seconds", type=seconds, metavar="N", help="end after this time")
    add_zenoh_arguments(parser)


def run(arguments: argparse.Namespace, settings: Settings, stopped: Callable[[], bool]) -> int:
    """Shadow the robot until it is stopped.

    Raises:
        CommandError: a setting is wrong, the robot does not answer, or it has no arbiter.
    """
    tried = tried_settings(arguments)
    if tried.is_own:
        raise CommandError("say what to try: --set SETTING=VALUE, or --with FILE", ExitCode.USAGE)
    # A wrong value is told before the robot is asked.
    tried("")
    robot, root = arguments.robot, settings.robot.root
    place = ", ".join(map(plain, said_of(settings.zenoh).connect))
    ends = ending_after(stopped, arguments.seconds, time.monotonic)
    with closing(ZenohSource(settings.zenoh, [keys.build(root, robot, _JOURNAL)], QUEUE_SAMPLES)) as source:
        shadowing = _Shadowing(source, root, arguments, tried, ends)
        shadowing.begin(place)
        return shadowing.run()


class _Shadowing:
    """The parts of a robot's journal, one after the other, through both arbiters."""

    def __init__(
        self,
        source: ZenohSource,
        root: str,
        arguments: argparse.Namespace,
        tried: TriedSettings,
        ends: Callable[[], bool],
    ) -> None:
        self._source = source
        self._robot = arguments.robot
        self._journal_key = keys.build(root, self._robot, _JOURNAL)
        self._info_key = keys.build(root, self._robot, _INFO)
        self._timeout_s = arguments.timeout
        self._as_json = arguments.json
        self._tried = tried
        self._ends = ends
        self._feed = JournalFeed(from_start=arguments.from_start)
        self._info: GatewayInfo | None = None
        self._last: Journal | None = None
        """The journal that both arbiters were given last."""
        self._shadow = Shadow(self._robot)
        self._first = self._inputs = 0
        self._received_s = time.monotonic()
        self._is_silent = False
        self._waits_s = time.monotonic()
        self._waits_for = "before the first checkpoint"
        self._is_late_told = False
        self._sum = RegressSummary(0, 0, 0, {})
        self._not_run: dict[str, float] = {}
        self._is_broken = False

    def begin(self, place: str) -> None:
        """Learn the robot's configuration.

        Raises:
            CommandError: it does not answer, or has no arbiter.
        """
        if not self._ask_who_it_is() and not self._ends():
            who = f"{self._robot} does not answer" if self._source.is_connected else "no Zenoh node answers"
            cure = "; 'cruiser list' says who is there" if self._source.is_connected else ""
            raise CommandError(f"{who} within {self._timeout_s:g} s at {place}{cure}", ExitCode.UNREACHABLE)
        if self._info is not None and self._info.listen_only:
            raise CommandError(f"{self._robot} listens only: it decides nothing, and has no journal")

    def run(self) -> int:
        """Run both arbiters until the end. Returns the exit code."""
        run_pair: PairRunner = installed("run_pair")
        while not self._ends() and self._info is not None:
            self._run_part(run_pair, self._info)
            if self._ends():
                break
            is_restarted = self._feed.ended == RESTARTED
            cure = "it begins again" if is_restarted else "it begins again at the next checkpoint"
            self._tell(f"{self._feed.ended}; {cure}")
            self._is_broken = self._is_broken or not is_restarted
            self._waits_for = "behind a restart" if is_restarted else "behind a gap, before the next checkpoint"
            self._waits_s = time.monotonic()
            self._feed.begin_part()
            self._last = None
            if is_restarted:
                # It may have other settings now.
                while not self._ask_who_it_is() and not self._ends():
                    pass
        self._note_wait()
        summary = msgspec.structs.replace(self._sum, not_run=dict(self._not_run))
        show(summary, describe_sum(summary), as_json=self._as_json)
        if summary.otherwise:
            return int(ExitCode.FAILURE)
        return int(ExitCode.PARTIAL if self._is_broken or not summary.run else ExitCode.OK)

    def _run_part(self, run_pair: PairRunner, info: GatewayInfo) -> None:
        settings, other = settings_from(info.configuration), self._tried(info.configuration)
        changed = changed_settings(settings, other)
        self._tell(", ".join(f"{name} is {was}, tried {tried}" for name, (was, tried) in changed.items()) or SAME)
        self._shadow = shadow = Shadow(self._robot)
        self._first = self._inputs = 0
        is_over = False
        while not is_over:
            is_over = True
            try:
                for _ in run_pair(settings, other, self._journals(), shadow):
                    self._report()
                    if shadow.has_strayed:
                        # From the robot's own state again: the last journal holds it.
                        is_over = False
                        break
            except UNREADABLE as error:
                self._feed.ended = f"the inputs that follow cannot be run: {error!r}"[:300]
        if shadow.start_ns:
            rules = COMMAND_RULES if self._last is None else self._last.rules
            result = RerunResult(
                robot=self._robot,
                run=self._feed.run or 0,
                first=self._first,
                inputs=self._inputs,
                detail="",
                start_ns=shadow.start_ns,
                end_ns=shadow.end_ns,
                same={},
                unrecorded={},
                difference_count=0,
                differences=[],
                given_up=0,
                rules=rules,
            )
            compared = shadow.compared.result(result, changed)
            show(compared, describe(compared), as_json=self._as_json)
            sys.stdout.flush()
            self._sum = msgspec.structs.replace(
                self._sum,
                run=self._sum.run + shadow.minutes,
                otherwise=self._sum.otherwise + shadow.otherwise,
                other_rules=self._sum.other_rules + (shadow.otherwise if rules != COMMAND_RULES else 0),
            )

    def _report(self) -> None:
        if self._waits_for and self._shadow.start_ns:
            self._note_wait()
            where = "the start of its run, or at rest" if self._shadow.is_clear else "a checkpoint"
            sure = "" if self._shadow.is_certain else "; what requests have changed until then stays as it is"
            self._tell(f"begins at {in_words(self._shadow.start_ns)}, at {where}{sure}")
        is_any = False
        for difference in self._shadow.differences():
            is_any = True
            show(difference, _describe(difference), as_json=self._as_json)
        if is_any:
            sys.stdout.flush()

    def _note_wait(self) -> None:
        if self._waits_for:
            waited = (time.monotonic() - self._waits_s) * 1e9 / MINUTE_NS
            if waited > SMALL:
                self._not_run[self._waits_for] = round(self._not_run.get(self._waits_for, 0.0) + waited, 1)
            self._waits_for = ""

    def _journals(self) -> Iterator[Journal]:
        """The journals of the part, as they come; the last one again, if there is one."""
        if self._last is not None:
            yield self._last
        while not self._ends():
            self._receive()
            while (journal := self._feed.next()) is not None:
                if self._last is None:
                    self._first = journal.first
                    if notice := rules_notice(journal.rules):
                        self._tell(notice)
                self._last = journal
                self._inputs += journal.count
                yield journal
                if self._ends():
                    return
            if self._feed.ended:
                return
            sequence = self._feed.query(time.monotonic_ns())
            if sequence is not None:
                self._source.ask(self._journal_key, f"{KEPT_FIRST}={sequence}")
            time.sleep(IDLE_S)

    def _receive(self) -> None:
        """Take what has come in."""
        now_s = time.monotonic()
        for sample in self._source.drain(TICK_SAMPLES):
            if sample.key == self._journal_key and not sample.deleted:
                self._take_journal(sample)
                self._received_s = now_s
            elif sample.key == self._info_key and sample.is_reply:
                read = codec.understand(GatewayInfo, sample.payload)
                if isinstance(read, codec.Understood):
                    self._info = read.message
        is_silent = now_s - self._received_s > SILENT_S
        if is_silent is not self._is_silent:
            self._is_silent = is_silent
            self._tell(
                f"nothing comes from {self._robot}{self._cure()}" if is_silent else f"{self._robot} is back"
            )
        if self._waits_for and not self._is_late_told and now_s - self._waits_s > NO_CHECKPOINT_S:
            self._is_late_told = True
            self._tell(f"still no checkpoint that this version can begin at{self._versions()}")

    def _take_journal(self, sample: ReceivedSample) -> None:
        journal = codec.decode(_JOURNAL, sample.payload)
        if isinstance(journal, Journal):
            self._feed.receive(journal, is_reply=sample.is_reply)

    def _cure(self) -> str:
        """Words about profiles of thin links, which leave the journal out, where none has come yet."""
        if self._info is None or self._feed.run is not None:
            return ""
        profiles = settings_from(self._info.configuration).zenoh.profiles
        return f"; over this link its journal may be left out: zenoh.profiles is {profiles}" if profiles else ""

    def _versions(self) -> str:
        theirs = "" if self._info is None else self._info.versions.get("cruiser-gateway", "")
        return f": the robot's is {theirs}, this is {version('cruiser-gateway')}" if theirs else ""

    def _ask_who_it_is(self) -> bool:
        """Ask for the robot's configuration, for a while. False if it did not answer."""
        self._info = None
        end_s = time.monotonic() + self._timeout_s
        asked_s: float | None = None
        while self._info is None and not self._ends() and (now_s := time.monotonic()) < end_s:
            if asked_s is None or now_s - asked_s > ASK_AGAIN_S:
                asked_s = now_s
                self._source.ask(self._info_key)
            self._receive()
            time.sleep(IDLE_S)
        return self._info is not None

    def _tell(self, text: str) -> None:
        sys.stderr.write(f"shadow: {plain(text)}\n")
        sys.stderr.flush()


SAME: Final = "the settings tried are those of the robot"


def _describe(difference: ShadowDifference) -> Iterator[str]:
    yield f"{in_words(difference.time_ns)} {difference.what}"
    yield f"  as recorded: {difference.recorded}"
    yield f"  as it would have been: {difference.other}"

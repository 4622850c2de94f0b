"""Logs as scripts: what is done to a robot and to its gateways, a step after the other, ``; `` between them.

The first step is the name of a scenario, ``ready`` (a robot that stands) or ``driving [M/S]``. Then:

- ``drive M/S SECONDS``, ``engage``, ``take``, ``reset``: by the operator, whom ``operator NAME`` changes;
  ``ask VERB``; ``says VERB [REASON]`` where the reply is known; ``begin VERB`` waits for any reply.
- ``run SECONDS``, ``rest``, ``until STATE``, ``fault WORDS``, ``stop`` (by the desk), ``deaf`` (the chassis
  hears no frame), ``shutdown``, ``clock SECONDS`` (for all).
- ``another SECONDS``: another gateway begins so long behind this one; ``followed SECONDS`` if it and its guard
  were killed; ``hang SECONDS``; ``note`` and ``ended``: what it finds, and hears later, of a guard.
- ``starve [TICKS]``: frames are not read for 120 ms, or so many ticks late before; ``behind``: too many come.
- ``gone MS``: a recorder says so much later that the gateway died; ``late MS``: decisions are told so much later;
  ``mute SECONDS``: of the gateway's first seconds the log has no state; ``unnamed``: nor who it is;
  ``without SUBJECT, SUBJECT``; ``alone``: the log of the first gateway is the only one.

Moments count from the end, from ``mark``, or from the first event for a reason: ``from REASON``.
"""

from functools import cache
from typing import Final

import msgspec

from gateway.chassis.frame import Frame
from schemas.codec import Sample
from schemas.decisions import ArbiterState, Severity
from schemas.reasons import Reason
from schemas.recording import RecorderEvent, RecorderEventKind
from tests.support.messages import MS, ROBOT, SECOND
from tests.support.rigs.gateway import GUARDED, Operator
from tests.support.rigs.recorded import RecordedRig
from tests.support.rigs.scenarios import SCENARIOS, acted

ENDED: Final = "the robot stands; 180 frames sent"
NOTE: Final = (
    "2026-11-22T06:00:00.000+00:00 guard: the gateway is gone, last heartbeat 51 ms ago: stopping the robot"
)
GONE: Final = "the gateway died, or the link to it: its token is gone, and it was engaged, and told 0.60 m/s"


class Script:
    """Acts out a script.

    Attributes:
        zero_ns: the time from which moments count.
    """

    def __init__(self, words: str) -> None:
        self._logs: list[bytes] = []
        first, *steps = words.split("; ")
        scenario = next((one for one in SCENARIOS if one.__name__ == first), None)
        if scenario is not None:
            self._begin(acted(scenario))
        elif first == "ready":
            self._begin(RecordedRig.ready()[0])
        else:
            self._begin(*RecordedRig.driving(*map(float, first.split()[1:])))
        self.zero_ns = 0
        for step in steps:
            self._step(*step.split(maxsplit=1))
        if scenario is not None:
            self._step("from", SCENARIOS[scenario][0].value)
        self.zero_ns = self.zero_ns or self._rig.at_ns

    @property
    def logs(self) -> list[bytes]:
        """The logs, one for each gateway."""
        return self._logs if self._is_alone else [*self._logs, self._log()]

    def _begin(self, rig: RecordedRig, operator: Operator | None = None) -> None:
        self._rig, self._operator = rig, operator or Operator(rig, "operator-1")
        self._begun_ns, self._late_ns = rig.at_ns, 0
        self._without, self._told = tuple[str, ...](), list[RecorderEvent]()
        self._is_named, self._is_alone = True, False

    def _log(self) -> bytes:
        """The log of the gateway so far."""
        rig, kept = self._rig, self._rig.recorded
        rig.recorded = [(at_ns, self._later(sample)) for at_ns, sample in kept]
        try:
            return rig.log(with_info=self._is_named, without=self._without, recorder_says=self._told)
        finally:
            rig.recorded = kept

    def _later(self, sample: Sample) -> Sample:
        if not self._late_ns or sample.subject != "safety/decision":
            return sample
        fields = msgspec.msgpack.decode(sample.payload)
        late = {**fields, "time_ns": fields["time_ns"] + self._late_ns}
        return msgspec.structs.replace(sample, payload=msgspec.msgpack.encode(late))

    def _step(self, verb: str, rest: str = "") -> None:  # noqa: C901, PLR0912, PLR0915 - a verb a line
        rig, operator, words = self._rig, self._operator, rest.split()
        match verb:
            case "drive":
                operator.drive(float(words[0]), 0.0, float(words[1]))
            case "engage":
                operator.engage()
            case "take":
                operator.take_lease()
            case "reset":
                assert operator.reset() is Reason.NONE
            case "ask":
                operator.ask(rest)
            case "says":
                assert operator.reason(words[0]) is Reason(*(words[1:] or ["none"]))
            case "begin":
                handle = operator.ask(rest)
                rig.until(lambda: handle in rig.replies)
            case "operator":
                self._operator = Operator(rig, rest)
            case "run":
                rig.run(float(rest))
            case "rest":
                rig.rest()
            case "until":
                rig.until(lambda: rig.says.state is ArbiterState(rest), 5)
            case "fault":
                rig.fault(rest)
            case "stop":
                rig.put("desk", "stop", b"")
                rig.tick()
            case "deaf":
                rig.chassis_hears = False
            case "shutdown":
                rig.core.shut_down(rig.now_ns)
            case "clock":
                rig.wall_ns += _ns(rest)
                rig.recorder_ns += _ns(rest)
            case "hang":
                rig.hang(float(rest))
            case "another" | "followed":
                then = rig.followed(float(rest)) if verb == "followed" else None
                self._logs.append(self._log())
                self._begin(then or rig.replaced(float(rest)))
            case "note":
                rig.core.latch_guard_stop(NOTE, rig.now_ns)
            case "ended":
                rig.links = msgspec.structs.replace(rig.links, guard_says=ENDED)
            case "starve":
                _starve(rig, int(rest or 0))
            case "behind":
                _fall_behind(rig)
            case "gone":
                at_ns = rig.at_ns + int(rest) * MS
                kind = RecorderEventKind.GATEWAY
                self._told.append(RecorderEvent(at_ns, 0, Severity.ERROR, kind, ROBOT, "", "", GONE))
            case "late":
                self._late_ns = int(rest) * MS
            case "mute":
                until_ns = self._begun_ns + _ns(rest)
                is_state = {
                    id(one) for one in rig.recorded if one[1].subject == "safety/state" and one[0] <= until_ns
                }
                rig.recorded = [one for one in rig.recorded if id(one) not in is_state]
            case "unnamed":
                self._is_named = False
            case "without":
                self._without = tuple(rest.split(", "))
            case "alone":
                self._is_alone = True
            case "mark":
                self.zero_ns = rig.at_ns
            case "from":
                self.zero_ns = next(one.time_ns for one in rig.events if one.reason is Reason(rest))
            case _:
                raise AssertionError(verb)


def _ns(seconds: str) -> int:
    return round(float(seconds) * SECOND)


def _starve(rig: RecordedRig, early_ticks: int) -> None:
    unread: list[tuple[int, Frame]] = []
    rig.corrupt = lambda frame: unread.append((rig.now_ns, frame))

    def read(until_ns: int) -> None:
        while unread and unread[0][0] <= until_ns:
            rig.core.receive_frame(unread.pop(0)[1], rig.now_ns)

    for _ in range(4 if early_ticks else 0):
        rig.tick()
        read(rig.now_ns - early_ticks * 10 * MS)
    rig.tick(12)
    rig.corrupt = lambda frame: frame
    read(rig.now_ns)


def _fall_behind(rig: RecordedRig) -> None:
    unread: list[Frame] = []
    rig.corrupt = unread.append
    rig.links = msgspec.structs.replace(GUARDED, is_behind=True)
    rig.tick()
    rig.corrupt = lambda frame: frame
    rig.links = GUARDED
    for frame in unread:
        rig.core.receive_frame(frame, rig.now_ns)


@cache
def logs_of(words: str) -> tuple[list[bytes], int]:
    """The logs of a script, and the time from which moments count."""
    script = Script(words)
    return script.logs, script.zero_ns

"""Scripts: what is done to a robot and to its gateways, a step after the other, ``; `` between them.

The first is the name of a scenario, ``ready`` (it stands) or ``driving [M/S] [SETTING:VALUE ...]``. Then:

- ``drive M/S SECONDS``, ``engage [DEADMAN_S]``, ``take``, ``reset``: by the operator; ``operator NAME``: another;
  ``on M/S [DEG]``: it drives for as long as it may; ``ask VERB``; ``says VERB [REASON]`` where the reply is known;
  ``begin VERB`` waits for any reply; ``stale COUNT`` and ``repeat COUNT``: commands with an old challenge, or with
  one sequence; ``taken NAME``: a supervisor takes its lease.
- ``run SECONDS``, ``rest``, ``until STATE``, ``fault WORDS``, ``stop`` (by the desk), ``deaf`` (the chassis
  hears no frame), ``blind`` (no frame comes), ``shutdown``, ``clock SECONDS`` (for all, or the ``robot`` alone).
- ``links FIELD:VALUE ...``: what the loop sees of bus and guard; ``takes [COUNT]``: frames that the bus takes of a
  burst; ``tick_late MS``.
- ``another SECONDS``: another gateway begins so long behind this one; ``followed SECONDS`` if it and its guard
  were killed; ``hang SECONDS``; ``note`` and ``ended``: what it finds, and hears later, of a guard.
- ``starve [TICKS]``: frames are not read for 120 ms, or so many ticks late before; ``behind``: too many come.
- ``gone MS``: a recorder says so much later that the gateway died;
  ``mute SECONDS``: of the gateway's first seconds the log has no state; ``unnamed``: nor who it is;
  ``without SUBJECT, SUBJECT``.

Moments count from the end, from ``mark``, or from the first event for a reason: ``from REASON``.
"""

import re
from collections.abc import Iterator
from functools import cache
from typing import Any, Final

import msgspec

from gateway.chassis.frame import Frame
from schemas.decisions import ArbiterState, Severity
from schemas.reasons import Reason
from schemas.recording import RecorderEvent, RecorderEventKind
from schemas.settings import CommandSettings
from tests.support.messages import MS, ROBOT, SECOND
from tests.support.rigs.gateway import GUARDED, Operator, copied
from tests.support.rigs.recorded import RecordedRig

ENDED: Final = "the robot stands; 180 frames sent"
NOTE: Final = (
    "2026-11-22T06:00:00.000+00:00 guard: the gateway is gone, last heartbeat 51 ms ago: stopping the robot"
)
GONE: Final = "the gateway or the link to it died: its token is gone; last state engaged at 0.60 m/s"


class Scenario(msgspec.Struct, frozen=True):
    """Something that stops a robot, as a script with a name."""

    name: str
    script: str

    def __str__(self) -> str:
        return self.name

    def __call__(self) -> RecordedRig:
        return Script(self.script).rig


ROWS: Final = """\
front_bumper front_bumper: driving; fault bumper front on for 700ms; drive 0.6 0.3; rest
    0x18C4D9EF Auto_MileageAndBodyFeedback, 01 39 30 00 01 | FrontBumper = 1 | read 0
rear_bumper rear_bumper: driving; fault bumper rear on for 700ms; drive 0.6 0.3; rest
    01 39 30 00 10 | RearBumper = 1
longer_deadman deadman: ready; engage 0.8; drive 0.6 1.5; run 1.5; rest
    810 ms before | the limit is 800 ms (requested by engage)
deadman deadman: driving; run 1; rest
    from operator-1 | 310 ms before | the limit is 300 ms | No drive command followed
stale_commands deadman: driving; stale 80; rest
    15 drive requests | 1290 ms, at most 1000 ms | seq 134, 1290 ms old
repeated_sequence deadman: driving; repeat 20; rest
    15 drive requests | did not increase, or increased by too much; 6 after 69
lease_expired lease_expired: driving lease_s:0.5 deadman_s:0.5; run 1; rest
    drive from operator-1, 500 ms before the stop | a lease lasts 500 ms
lease_taken lease_taken: driving; taken operator-2; rest
    take from operator-2
lease_released lease_released: driving; says release; rest
    release from operator-1
disengaged disengaged: driving; says disengage; rest
    disengage from operator-1
remote_stop remote_stop: driving; stop; rest
    stop from desk
hand_transmitter hand_transmitter: driving; fault transmitter remote for 9s; drive 0.6 0.3; run 1
    Mode = remote | the last one before it, 20.0 ms
one_silent_frame feedback_missing: driving; fault silence Auto_GearFeedBack for 500ms; drive 0.6 0.4; rest
    last valid Auto_GearFeedBack was received 110 ms before the stop | the limit is 100 ms (its period is 10 ms)
slow_silent_frame feedback_missing: driving; fault silence Auto_WheelSpdFeedback for 900ms; drive 0.6 0.8; rest
    last valid Auto_WheelSpdFeedback was received 510 ms | the limit is 500 ms
checksums feedback_faulty: driving; fault checksum Auto_DriveFeedBack for 5 frames; drive 0.6 0.3; rest
    last valid Auto_DriveFeedBack | 5 of | had a wrong checksum | which should end with
stuck_counter feedback_faulty: driving; fault stuck Auto_SteeringFeedBack for 8 frames; drive 0.6 0.3; rest
    last valid Auto_SteeringFeedBack | the last alive counters:
wrong_scale implausible_speed: driving; fault scale wrong for 800ms; drive 0.6 0.5; rest
    Auto_DriveFeedBack read Speed = 21 | beyond the limit 3
other_commander other_commander: driving; fault foreign 18C4D3D0 every 10ms for 200ms; drive 0.6 0.3; rest
    1 command frame that this gateway did not send | 0x18C4D3D0
bus_lost bus_down: driving; links bus_up:0 bus_losses:1; blind; drive 0.6 1.2
    last frame was received 10.0 ms before the stop | bus can0, bus up no
guard_lost unguarded: driving; links guarded:0; drive 0.6 0.3; links; rest
guard_acts guard: driving; links guard_sends:1 guard_stops:1; drive 0.6 0.3
late_loop loop_late: driving; tick_late 150; drive 0.6 0.1; rest
    tick lateness max ms 150
flooded feedback_late: driving; links is_behind:1; drive 0.6 0.1; links; rest
    frames per s 630
full_bus send_failed: driving; takes 2; drive 0.6 0.2; takes; rest
    5 such ticks in a row | 2 to 2 of five frames were sent
not_confirmed not_confirmed: ready; deaf; take; ask engage; drive 0 1.2; rest
    engage from operator-1 | 1.00 s before the stop | Mode = stop
found_moving found_moving: driving; links bus_up:0 bus_losses:1; run 0.1; links bus_losses:1; run 0.3; rest
    there is no CAN bus | read 0.60 m/s
shut_down shutdown: driving; shutdown; drive 0.6 0.1; rest
rolling rolling: ready; fault slope 8; engage; drive 0.5 1.3; fault motor 0; on 0.5; rest
    rear wheels read -0. | commanded 0.50 m/s
not_moving not_moving: ready; engage; drive 0.5 1.3; fault motor 0; on 0.5; rest
    drive feedback 0.00 m/s, commanded 0.50 m/s
frozen_mileage feedback_frozen: ready; engage; drive .6 1.3; fault freeze Auto_MileageAndBodyFeedback; on 0.6; rest
    mileage read 12.345 km, and did not change over 3 m
stuck_steering steering: ready; engage; drive 0.6 1.3; fault freeze Auto_SteeringFeedBack; on 0.6 15; rest
    read 0.0 deg, commanded 1 | to 15.0 deg; a deviation over 5 deg
"""
"""Of each scenario its name, the reason to be named, and its script; below that what the evidence has to say."""


def _read_rows() -> Iterator[tuple[Scenario, tuple[Reason, tuple[str, ...]]]]:
    for row in re.split(r"\n(?! )", ROWS.strip()):
        head, _, evidence = row.partition("\n    ")
        names, _, script = head.partition(": ")
        name, reason = names.split()
        yield Scenario(name, script), (Reason(reason), tuple(evidence.split(" | ") if evidence else ()))


SCENARIOS: Final = dict(_read_rows())

BY_NAME: Final = {one.name: one for one in SCENARIOS}
front_bumper, deadman, remote_stop = BY_NAME["front_bumper"], BY_NAME["deadman"], BY_NAME["remote_stop"]
stale_commands, repeated_sequence = BY_NAME["stale_commands"], BY_NAME["repeated_sequence"]
guard_acts, hand_transmitter = BY_NAME["guard_acts"], BY_NAME["hand_transmitter"]
one_silent_frame, found_moving = BY_NAME["one_silent_frame"], BY_NAME["found_moving"]


class Script:
    """Acts out a script; moments count from ``zero_ns``."""

    def __init__(self, words: str) -> None:
        self._logs: list[bytes] = []
        first, *steps = words.split("; ")
        scenario = BY_NAME.get(first)
        if scenario is not None:
            self._begin(*copied(acted(scenario), Operator(acted(scenario), "operator-1")))
        elif first == "ready":
            self._begin(*RecordedRig.ready())
        else:
            given = [word.split(":") for word in first.split()[1:]]
            command = CommandSettings(**{one[0]: float(one[1]) for one in given if len(one) > 1})
            speed_mps = next((float(one[0]) for one in given if len(one) == 1), 0.6)
            named = any(len(one) > 1 for one in given)
            self._begin(*RecordedRig.driving(speed_mps, command=command if named else None))
        self.zero_ns = 0
        for step in steps:
            self._step(*step.split(maxsplit=1))
        if scenario is not None:
            self._step("from", SCENARIOS[scenario][0].value)
        self.zero_ns = self.zero_ns or self._rig.at_ns

    @property
    def rig(self) -> RecordedRig:
        return self._rig

    @property
    def logs(self) -> list[bytes]:
        return [*self._logs, self._log()]

    def _begin(self, rig: RecordedRig, operator: Operator | None = None) -> None:
        self._rig, self._operator = rig, operator or Operator(rig, "operator-1")
        self._begun_ns = rig.at_ns
        self._without, self._told = tuple[str, ...](), list[RecorderEvent]()
        self._is_named = True

    def _log(self) -> bytes:
        return self._rig.log(with_info=self._is_named, without=self._without, recorder_says=self._told)

    def _step(self, verb: str, rest: str = "") -> None:  # noqa: C901, PLR0912, PLR0915 - a verb a line
        rig, operator, words = self._rig, self._operator, rest.split()
        match verb:
            case "drive":
                operator.drive(float(words[0]), 0.0, float(words[1]))
            case "on":
                angle_deg = float(words[1]) if words[1:] else 0.0
                for _ in range(70):
                    if rig.says.engaged:
                        operator.drive(float(words[0]), angle_deg, 0.1)
            case "stale" | "repeat":
                challenge = rig.says.challenge
                for _ in range(int(rest)):
                    operator.sequence = 5 if verb == "repeat" else operator.sequence
                    of: dict[str, Any] = {"challenge": challenge} if verb == "stale" else {}
                    rig.put(operator.name, "drive", operator.drive_payload(0.6, **of))
                    rig.tick(2)
            case "taken":
                Operator(rig, rest).take_lease("take", role="supervisor", override=True)
            case "engage":
                operator.engage(**({"deadman_s": float(rest)} if rest else {}))
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
            case "blind":
                rig.corrupt = lambda _: None
            case "links":
                seen = {name: int(value) for name, value in (word.split(":") for word in words)}
                seen |= {
                    name: bool(value) for name, value in seen.items() if isinstance(getattr(GUARDED, name), bool)
                }
                rig.links = msgspec.structs.replace(GUARDED, **seen)
            case "takes":
                rig.takes = int(rest) if rest else None
            case "tick_late":
                rig.late_ns = int(rest) * MS
                rig.tick()
                rig.late_ns = 0
            case "shutdown":
                rig.core.shut_down(rig.now_ns)
            case "clock":
                rig.wall_ns += _ns(words[0])
                rig.recorder_ns += 0 if "robot" in words else _ns(words[0])
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
def acted(scenario: Scenario) -> RecordedRig:
    """A scenario, acted out once for all tests."""
    return scenario()


@cache
def recorded(scenario: Scenario, *without: str) -> bytes:
    return acted(scenario).log(without=without)


def stepped_clock(*, steps_recorder: bool) -> RecordedRig:
    """In mid-drive the robot's wall clock jumps an hour ahead, and the recorder's, if it is the same."""
    clock = f"clock 3600{'' if steps_recorder else ' robot'}"
    return Script(f"driving; drive 0.6 2; {clock}; drive 0.6 2").rig


@cache
def logs_of(words: str) -> tuple[list[bytes], int]:
    """The logs of a script, and the time from which moments count."""
    script = Script(words)
    return script.logs, script.zero_ns

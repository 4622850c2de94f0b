"""Logs of a whole gateway with a simulated chassis: what happens in the rig is recorded as a recorder would."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from gateway.chassis.frame import Frame
from gateway.core import Core, TickEffects
from gateway.telemetry.sample import Sample
from recorder.reading.faults import Faults
from recorder.reading.logs import find_logs
from recorder.reading.survey import survey
from recorder.review.reasoning.chain import Step
from recorder.review.why import Explanation, explain
from schemas import keys
from schemas.configuration import to_toml
from schemas.decisions import ArbiterState
from schemas.messages import GatewayInfo, Variant
from schemas.recording import RecorderEvent
from schemas.settings import CommandSettings, Settings
from schemas.subjects import BY_NAME
from tests.support.loop_rig import WALL_NS, LoopRig, Operator
from tests.support.recorder_fakes import MS, FakeSample, Log, info, sample_of

ROBOT = "cruiser-1"
RECEIVED_NS = 2 * MS
"""A recorder receives what is said so much later."""


class _Keeping(Core):
    """A core that keeps what it returns, each with the recorder's time."""

    def __init__(self, settings: Settings, rig: "RecordedRig", run: int) -> None:
        super().__init__(settings, "1.2.3", rig.now_ns, run)
        self.kept: list[tuple[int, Sample]] = []
        self._rig = rig

    def receive_frame(self, frame: Frame, now_ns: int) -> Sample | None:
        sample = super().receive_frame(frame, now_ns)
        self.kept += [] if sample is None else [(self._rig.at_ns, sample)]
        return sample

    def tick(self, now_ns: int, wall_ns: int, late_ns: int, challenge: bytes) -> TickEffects:
        due = super().tick(now_ns, wall_ns, late_ns, challenge)
        self.kept += [(self._rig.at_ns, sample) for sample in due.samples]
        return due

    def sent(self, count: int, now_ns: int, wall_ns: int) -> list[Sample]:
        samples = super().sent(count, now_ns, wall_ns)
        self.kept += [(self._rig.at_ns, sample) for sample in samples]
        return samples


class RecordedRig(LoopRig):
    """A rig whose samples are kept.

    Attributes:
        robot_ahead_ns: so far the robot's clock is ahead of the recorder's, in its log.
        recorder_ns: the recorder's time when the rig's is 0.
    """

    def __init__(
        self,
        variant: Variant = Variant.COARSE,
        command: CommandSettings | None = None,
        *,
        configured: str = "auto",
        run: int = 7,
        now_ns: int = 0,
    ) -> None:
        super().__init__(variant, command, configured=configured, run=run, now_ns=now_ns)
        self.core = self.keeping = _Keeping(self.settings, self, run)
        self.robot_ahead_ns = 0
        self.recorder_ns = WALL_NS - now_ns

    @property
    def at_ns(self) -> int:
        """The time now, as a recorder's clock tells it, which nobody sets."""
        return self.recorder_ns + self.now_ns

    @classmethod
    def beginning(cls, at_ns: int, run: int) -> "RecordedRig":
        """A robot whose gateway begins at this time of the recorder's."""
        rig = cls(run=run)
        later_ns = at_ns - rig.at_ns
        rig.wall_ns += later_ns
        rig.recorder_ns += later_ns
        return rig

    @classmethod
    def ready(
        cls, variant: Variant = Variant.COARSE, command: CommandSettings | None = None, *, run: int = 7
    ) -> tuple["RecordedRig", Operator]:
        """A robot that stands and that anybody may engage."""
        rig = cls(variant, command, run=run)
        rig.run(0.6)
        return rig, Operator(rig, "operator-1")

    @classmethod
    def driving(
        cls, speed_mps: float = 0.6, *, command: CommandSettings | None = None, run: int = 7
    ) -> tuple["RecordedRig", Operator]:
        """A robot that is being driven at this speed."""
        rig, operator = cls.ready(command=command, run=run)
        operator.engage()
        operator.drive(speed_mps, 0.0, 0.6 + abs(speed_mps) / 0.8)
        return rig, operator

    def rest(self) -> None:
        """Time passes until the robot is told nothing any more."""
        self.until(lambda: self.says.state is ArbiterState.STANDBY, 9)
        self.run(0.2)

    def rest_after(self, seconds: float) -> None:
        """Nobody says anything for a time; then as in ``rest``."""
        self.run(seconds)
        self.rest()

    def log(
        self,
        *,
        with_info: bool = True,
        without: tuple[str, ...] = (),
        robot: str = ROBOT,
        recorder_says: Sequence[RecorderEvent] = (),
    ) -> bytes:
        """The log of all that was said, but for some subjects, and of what the recorder said at the end."""
        log = Log()
        root = self.settings.robot.root
        answer = msgspec.structs.replace(info(), configuration=to_toml(self.settings))
        assert isinstance(answer, GatewayInfo)
        for number, (at_ns, sample) in enumerate(self.keeping.kept):
            log_ns = at_ns - self.robot_ahead_ns + RECEIVED_NS
            if number == 0 and with_info:
                log.receive(sample_of(answer, robot), wall_ns=log_ns)
            if sample.subject in without:
                continue
            subject = BY_NAME[sample.subject]
            key = keys.build(root, robot, subject, "can0" if "{bus}" in subject.name else "")
            log.receive(FakeSample(key, subject.encoding, sample.payload), wall_ns=log_ns)
        for said in recorder_says:
            log.add_own(keys.of_recorder(root, "bench", "event"), said, 0)
        return log.close()


def ask(path: Path, data: bytes, at_ns: int | None = None, robot: str = ROBOT) -> Explanation:
    """Why, of a log with this content."""
    path.write_bytes(data)
    return ask_of([path], at_ns, robot)


def ask_of(paths: Sequence[Path], at_ns: int | None = None, robot: str = ROBOT) -> Explanation:
    """Why, of the logs there."""
    faults = Faults()
    logs = find_logs(paths, faults)
    explanation = explain(robot, logs, survey(logs, faults), at_ns, faults)
    assert not faults, faults.told
    return explanation


def texts(explanation: Explanation, step: Step) -> str:
    """The sentences of a step, one a line."""
    return "\n".join(link.text for link in explanation.chain if link.step is step)

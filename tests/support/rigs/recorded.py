"""Logs of a whole gateway with a simulated chassis, recorded as a recorder would."""

from collections.abc import Callable, Sequence
from functools import cache, reduce
from operator import xor
from pathlib import Path

import msgspec

from gateway.chassis.frame import Frame
from recorder.reading.logs import Faults, find_logs
from recorder.reading.survey import survey
from recorder.review.why import Explainer, Explanation
from recorder.review.window import Step
from schemas import codec, keys
from schemas.configuration import to_toml
from schemas.decisions import ArbiterState, Journal
from schemas.messages import Variant
from schemas.recording import RecorderEvent
from schemas.settings import CommandSettings
from schemas.subjects import BY_NAME
from tests.support.logs import Log
from tests.support.messages import MS, ROBOT, SECOND, FakeSample, info, sample_of
from tests.support.rigs.gateway import DRIVE_CAN_ID, GatewayRig, Operator, copied

RECEIVED_NS = 2 * MS  # from publication to receipt by the recorder


class RecordedRig(GatewayRig):
    @classmethod
    def beginning(cls, at_ns: int, run: int) -> "RecordedRig":
        """A robot whose gateway begins at this time of the recorder's clock."""
        rig = cls(run=run)
        later_ns = at_ns - rig.at_ns
        rig.wall_ns += later_ns
        rig.recorder_ns += later_ns
        return rig

    @classmethod
    def ready(
        cls, variant: Variant = Variant.COARSE, command: CommandSettings | None = None, *, run: int = 7
    ) -> tuple["RecordedRig", Operator]:
        rig = cls(variant, command, run=run)
        rig.run(0.6)
        return rig, Operator(rig, "operator-1")

    @classmethod
    def driving(
        cls, speed_mps: float = 0.6, *, command: CommandSettings | None = None, run: int = 7
    ) -> tuple["RecordedRig", Operator]:
        return copied(*_driving(speed_mps, command, run))

    def replaced(self, seconds: float) -> "RecordedRig":
        """Another run of the gateway, which begins so long after this one's last sample."""
        return RecordedRig.beginning(self.at_ns + round(seconds * SECOND), self._run + 1)

    def rest(self) -> None:
        self.until(lambda: self.says.state is ArbiterState.STANDBY, 9)
        self.run(0.2)

    def rest_after(self, seconds: float) -> None:
        """Let time pass without commands, then rest."""
        self.run(seconds)
        self.rest()

    def hang(self, seconds: float) -> list[Frame]:
        """Hang; after 80 ms the guard stops the robot; then all is read at once. Returns the guard's frames."""
        unread: list[Frame] = []
        sent: list[Frame] = []
        for tick in range(round(seconds * 100)):
            self.now_ns += 10 * MS
            self.wall_ns += 10 * MS
            unread += self.chassis.advance(self.now_ns, self.wall_ns)
            for frame in self.out[-5:] if tick >= 8 else ():
                data = bytearray(frame.data)
                if frame.can_id == DRIVE_CAN_ID:
                    data[1:3] = bytes(2)
                data[6] = (data[6] + 16 * (tick - 7)) % 256
                data[7] = reduce(xor, data[:7])
                mine = msgspec.structs.replace(frame, data=bytes(data), wall_ns=self.wall_ns)
                self.chassis.receive(mine, self.now_ns)
                sent.append(mine)
        for frame in sorted([*unread, *sent], key=lambda one: one.wall_ns):
            sample = self.core.receive_frame(frame, self.now_ns)
            if sample is not None:
                self.recorded.append((self.at_ns, sample))
        self.links = msgspec.structs.replace(self.links, guard_sends=True, guard_stops=1)
        self.tick()
        return sent

    def followed(self, seconds: float) -> "RecordedRig":
        """Another run after this one and its guard died; the chassis follows its last command meanwhile."""
        rig = RecordedRig(run=self._run + 1, now_ns=self.now_ns + round(seconds * SECOND))
        rig.recorder_ns, rig.wall_ns = self.recorder_ns, self.wall_ns + round(seconds * SECOND)
        rig.chassis = self.chassis
        for _ in range(round(seconds * 100)):
            self.now_ns += 10 * MS
            self.wall_ns += 10 * MS
            self.chassis.advance(self.now_ns, self.wall_ns)
        return rig

    def log(
        self,
        *,
        with_info: bool = True,
        without: tuple[str, ...] = (),
        robot: str = ROBOT,
        recorder_says: Sequence[RecorderEvent] = (),
        lag_ns: int = RECEIVED_NS,
        journal: Callable[[Journal], Journal] = lambda one: one,
        ticks: bool = False,
    ) -> bytes:
        """The log, received ``lag_ns`` after publication; ``journal`` changes each journal message first.

        With ``ticks`` of the recorder it has transforms and outlines for viewers, too.
        """
        log = Log()
        began_ns = self.recorded[0][0] if self.recorded else 0
        keys_of = {name: self._key(robot, name) for name in {sample.subject for _, sample in self.recorded}}
        answer = msgspec.structs.replace(info(), configuration=to_toml(self.settings))
        for number, (at_ns, sample) in enumerate(self.recorded):
            log_ns = at_ns + lag_ns
            if number == 0 and with_info:
                log.receive(sample_of(answer, robot), wall_ns=log_ns)
            if sample.subject in without:
                continue
            subject = BY_NAME[sample.subject]
            payload = sample.payload
            if sample.subject == "journal":
                message = codec.decode(subject, payload)
                assert isinstance(message, Journal)
                payload = codec.encode(journal(message))
            one = FakeSample(keys_of[sample.subject], subject.encoding, payload)
            log.receive(one, now_ns=at_ns - began_ns, wall_ns=log_ns)
            if ticks:
                log.tick(at_ns - began_ns)
        for said in recorder_says:
            log.add_own(keys.of_recorder(self.settings.robot.root, "bench", "event"), said, 0)
        return log.close()

    def _key(self, robot: str, subject: str) -> str:
        return keys.build(self.settings.robot.root, robot, BY_NAME[subject], "can0" if "{bus}" in subject else "")


@cache
def _driving(speed_mps: float, command: CommandSettings | None, run: int) -> tuple[RecordedRig, Operator]:
    rig, operator = RecordedRig.ready(command=command, run=run)
    operator.engage()
    operator.drive(speed_mps, 0.0, 0.6 + abs(speed_mps) / 0.8)
    return rig, operator


def ask(path: Path, data: bytes, at_ns: int | None = None, robot: str = ROBOT) -> Explanation:
    path.write_bytes(data)
    return ask_of([path], at_ns, robot)


def ask_of(paths: Sequence[Path], at_ns: int | None = None, robot: str = ROBOT) -> Explanation:
    faults = Faults()
    logs = find_logs(paths, faults)
    explainer = Explainer(robot, logs, survey(logs, faults), faults)
    explanation = explainer.last() if at_ns is None else explainer.at(at_ns)
    assert not faults, faults.told
    return explanation


def texts(explanation: Explanation, step: Step) -> str:
    """The sentences of a step, one a line."""
    return "\n".join(link.text for link in explanation.chain if link.step is step)

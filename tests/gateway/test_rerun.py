"""A recorded minute, run again from its log."""

from collections.abc import Callable, Iterator
from io import BytesIO
from random import Random
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from gateway.chassis.frame import Frame
from gateway.core import Core, Due
from gateway.journal import JournalGapError, read
from gateway.rerun import run_again
from gateway.telemetry.health import Links
from gateway.telemetry.sample import Sample
from recorder.transcode import compile_encoder
from schemas import codec, keys
from schemas.can_word import EXTENDED
from schemas.configuration import TomlSource, merge, to_toml
from schemas.decisions import Decision, Journal, SafetyEvent, SafetyState
from schemas.messages import GatewayInfo, Message, Variant
from schemas.reasons import Reason
from schemas.settings import CommandSettings, Settings
from schemas.subjects import BY_NAME
from tests.gateway.command.loop_rig import GUARDED, LoopRig, Operator
from tests.recorder.fakes import FakeSample, Log, info, sample_of

MINUTE_TICKS = 6000
RUN = 2**53 - 1
STARTED_NS = 123_456_789_012_345
COMMAND = CommandSettings(speed_limit_mps=1.5, deadman_s=0.25, lease_s=1.5)
"""Not the start values: whoever runs the log again without its configuration gets something else."""

SAFETY: dict[str, type[Message]] = {
    "safety/decision": Decision,
    "safety/event": SafetyEvent,
    "safety/state": SafetyState,
}

FAULTS = (
    "silence Auto_GearFeedBack for 300ms",
    "silence all for 500ms",
    "checksum Auto_DriveFeedBack for 3 frames",
    "stuck Auto_SteeringFeedBack for 8 frames",
    "skip Auto_MileageAndBodyFeedback by 5 for 2 frames",
    "drop Auto_WheelSpdFeedback next 3",
    "foreign 18C4D2EF 0000000000000000 every 20ms for 200ms",
    "foreign 18C4D3D0 every 10ms for 100ms",
    "bumper front on for 700ms",
    "bumper both on for 300ms",
    "transmitter remote for 900ms",
    "scale wrong for 800ms",
    "sticks 0.5 5",
)


class Kept(Core):
    """A core that keeps what it returns."""

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, "1.2.3", STARTED_NS, RUN)
        self.samples: list[Sample] = []
        self.offered: list[list[Frame]] = []

    def receive_frame(self, frame: Frame, now_ns: int) -> Sample | None:
        sample = super().receive_frame(frame, now_ns)
        self.samples += [] if sample is None else [sample]
        return sample

    def tick(self, now_ns: int, wall_ns: int, late_ns: int) -> Due:
        due = super().tick(now_ns, wall_ns, late_ns)
        self.samples += due.samples
        self.offered.append(due.frames)
        return due

    def sent(self, count: int, now_ns: int, wall_ns: int) -> list[Sample]:
        samples = super().sent(count, now_ns, wall_ns)
        self.samples += samples
        return samples


class Day:
    """A minute in which everything happens: two operators at work, and what fails around them."""

    def __init__(self, seed: int, variant: Variant) -> None:
        self.rig = LoopRig(variant, COMMAND, now_ns=STARTED_NS, run=RUN)
        self.core = self.rig.core = Kept(self.rig.settings)
        self._random = Random(seed)  # noqa: S311 - the same minute each time
        self._operators = [Operator(self.rig, "first"), Operator(self.rig, "berta")]

    def live(self) -> None:
        """A minute; its last second is quiet, and the gateway ends in it."""
        actions: list[Callable[[], None]] = [
            *[self._drive] * 14,
            self._stop,
            self._garbage,
            self._lights,
            self._fault,
            self._fault,
            self._links,
            self._bad_bus,
            self._late,
            self._clock_steps,
            self._hand_over,
        ]
        ends_ns = STARTED_NS + MINUTE_TICKS * 10_000_000
        self.rig.run(0.6)
        while self.rig.now_ns < ends_ns - 8_000_000_000:
            self._random.choice(actions)()
        self._heal()
        self.rig.run(1)
        self._drive()
        self.core.shut_down(self.rig.now_ns)
        self.rig.until(lambda: self.core.is_at_rest, 10)
        self.rig.run(1)

    def _drive(self) -> None:
        """Whatever it takes to be engaged, and then a random drive."""
        operator = self._random.choice(self._operators[:1] * 3 + self._operators)
        if self.core.lease_holder != operator.name:
            operator.take_lease("take", override=True)
        if not self.rig.says.engaged:
            self.rig.run(2.5)
            operator.take_lease("take", override=True)
            operator.reason("reset")
            operator.ask("engage")
            self.rig.run(0.2)
            operator.drive(0.0)
            operator.ask("unpark")
        uniform = self._random.uniform
        operator.drive(uniform(-2.0, 2.0), uniform(-30, 30), uniform(0.3, 1.5))

    def _stop(self) -> None:
        self.rig.put("passer-by", "stop", self._random.randbytes(5))
        self.rig.tick()

    def _garbage(self) -> None:
        for verb in ("drive", "engage", "no-such-verb", "acquire", ""):
            self.rig.query("stranger", verb, self._random.randbytes(self._random.randrange(40)))
            self.rig.put("", verb, self._random.randbytes(3))
        self.rig.tick()

    def _lights(self) -> None:
        operator = self._operators[0]
        operator.ask("light", headlamp=True, left=True)
        operator.ask("horn", on=True)
        operator.ask("clear_odometer")
        self.rig.tick(3)

    def _fault(self) -> None:
        self.rig.fault(self._random.choice(FAULTS))

    def _links(self) -> None:
        lost = self.rig.links.bus_losses + 1
        self.rig.links = self._random.choice(
            [
                Links(bus_up=False, bus_losses=lost),
                Links(bus_up=True, bus_losses=lost - 1, guarded=False),
                Links(bus_up=True, bus_losses=lost - 1, guarded=True, guard_sends=True),
            ]
        )
        self.rig.run(self._random.uniform(0.05, 0.4))
        self.rig.links = msgspec.structs.replace(GUARDED, bus_losses=self.rig.links.bus_losses)

    def _bad_bus(self) -> None:
        for _ in range(self._random.randrange(1, 8)):
            self.rig.takes = self._random.randrange(6)
            self.rig.tick()
        self.rig.takes = None

    def _late(self) -> None:
        self.rig.late_ns = self._random.randrange(200) * 1_000_000
        self.rig.tick()
        self.rig.late_ns = 0

    def _clock_steps(self) -> None:
        self.rig.wall_ns += self._random.choice([-1, 1]) * 3_600_000_000_000

    def _hand_over(self) -> None:
        self._operators[1].take_lease("take", role="supervisor", override=True)
        self._operators[1].ask("release")
        self.rig.tick()

    def _heal(self) -> None:
        self.rig.fault("clear")
        self.rig.run(3)


def recorded(day: Day) -> bytes:
    """The log of a day, as the recorder writes it."""
    log = Log()
    robot = day.rig.settings.robot
    answer = msgspec.structs.replace(info(), configuration=to_toml(day.rig.settings))
    for number, sample in enumerate(day.core.samples):
        subject = BY_NAME[sample.subject]
        key = keys.build(robot.root, robot.name, subject, "can0" if "{bus}" in subject.name else "")
        log.receive(FakeSample(key, subject.encoding, sample.payload))
        if number == 0:
            assert isinstance(answer, GatewayInfo)
            log.receive(sample_of(answer))
    return log.close()


class ReadBack:
    """What a log alone says."""

    def __init__(self, data: bytes) -> None:
        reader = make_reader(BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
        (configuration,) = (
            attachment.data
            for attachment in reader.iter_attachments()
            if attachment.name.endswith("configuration.toml")
        )
        self.settings = merge(TomlSource("configuration.toml", configuration.decode()), {}, {})
        self.journals: list[Journal] = []
        self.records: dict[str, list[bytes]] = {}
        self.sent: list[tuple[int, int, bytes]] = []
        prefix = f"{self.settings.robot.root}/{self.settings.robot.name}/"
        for _, channel, message, content in reader.iter_decoded_messages(log_time_order=False):
            name = channel.topic.removeprefix(prefix)
            self.records.setdefault(name, []).append(message.data)
            if name == "journal":
                fields = {field: getattr(content, field) for field in Journal.__struct_fields__}
                self.journals.append(Journal(**fields))
            elif name == "can/can0/tx":
                self.sent.append((content.time_ns, content.identifier, content.data))

    def run_again(self) -> Iterator[tuple[list[Frame], list[Sample]]]:
        """The core, run again."""
        inputs = list(read(self.journals))
        core = Core(self.settings, "", inputs[0][1], self.journals[0].run)
        return run_again(core, inputs)


def frames_of(samples: list[Sample]) -> list[tuple[int, int, bytes]]:
    """Time, identifier and data of the frames that were published as sent."""
    frames: list[tuple[int, int, bytes]] = []
    for sample in samples:
        if sample.subject == "can/{bus}/tx":
            batch: Any = codec.decode(BY_NAME[sample.subject], sample.payload)
            words = [word & ~EXTENDED for word in batch.can_id]
            frames += zip(batch.frame_time_ns, words, batch.data, strict=True)
    return frames


@pytest.mark.parametrize(("seed", "variant"), [(1, Variant.COARSE), (2, Variant.FINE)])
def test_a_recorded_minute_run_again_comes_out_the_same(seed: int, variant: Variant) -> None:
    """From the log alone: every decision, event and state byte for byte, and every frame offered and sent."""
    day = Day(seed, variant)
    day.live()
    log = ReadBack(recorded(day))
    offered: list[list[Frame]] = []
    samples: list[Sample] = []
    for frames, published in log.run_again():
        offered.append(frames)
        samples += published
    for name, kind in SAFETY.items():
        encode = compile_encoder(kind)
        again = [
            encode(codec.decode(BY_NAME[name], sample.payload)) for sample in samples if sample.subject == name
        ]
        lived = log.records[name]
        # The last batch of the journal, and so the last ticks of the quiet end, is not in the log.
        assert 0 <= len(lived) - len(again) <= (2 if name == "safety/state" else 0)
        assert again == lived[: len(again)], name
    assert frames_of(samples) == log.sent
    bursts = [frames for frames in offered if frames]
    assert bursts == [frames for frames in day.core.offered if frames]
    chassis = [sample for sample in samples if sample.subject.startswith("chassis/")]
    assert chassis == [s for s in day.core.samples if s.subject.startswith("chassis/")][: len(chassis)]


def test_the_minute_is_worth_running_again() -> None:
    """In it the robot drives, is refused, stopped and latched, loses bus and guard, and comes to rest."""
    day = Day(1, Variant.COARSE)
    day.live()
    rig = day.rig
    assert rig.now_ns - STARTED_NS >= 60_000_000_000
    assert len(rig.bursts) > 1500
    speeds_mps = {round(state["Auto_DriveCmd"]["TargetVelocity"], 1) for _, state in rig.bursts}  # type: ignore[arg-type]
    assert len(speeds_mps) > 10
    verdicts = {decision.reason for decision in rig.decided}
    assert {Reason.NONE, Reason.MALFORMED, Reason.UNKNOWN_VERB, Reason.STOPPING} <= verdicts
    stops = {event.reason for event in rig.events}
    assert len(stops) >= 10, stops
    assert {Reason.REMOTE_STOP, Reason.SHUTDOWN, Reason.LEASE_TAKEN, Reason.DEADMAN} <= stops


def test_a_log_that_misses_a_batch_is_refused() -> None:
    """Nothing that looks like a run comes out of it."""
    day = Day(3, Variant.COARSE)
    day.rig.run(2)
    log = ReadBack(recorded(day))
    del log.journals[20]
    with pytest.raises(JournalGapError):
        list(log.run_again())


def test_another_run_number_gives_other_leases() -> None:
    """The comparison can fail: the run number is part of the log for a reason."""
    day = Day(3, Variant.COARSE)
    day.rig.run(1)
    Operator(day.rig).take_lease()
    day.rig.run(1)
    log = ReadBack(recorded(day))
    log.journals = [msgspec.structs.replace(journal, run=1) for journal in log.journals]
    again = [s.payload for _, samples in log.run_again() for s in samples if s.subject == "safety/decision"]
    assert again
    assert again != [s.payload for s in day.core.samples if s.subject == "safety/decision"]

"""The command flow at its seams: what is offered, and what was sent. Its rules are scenes: see ``test_faults``."""

import msgspec

from gateway.choice import CHASSIS
from gateway.command.flow import CommandFlow
from gateway.command.rulings import RawRequest
from schemas.decisions import Decision, Reply
from schemas.settings import Settings
from tests.support.fakes.robot import message_of
from tests.support.frames import CHALLENGE, WALL_NS
from tests.support.rigs.arbiter import MS, STANDING
from tests.support.rigs.gateway import driving


def test_a_tick_makes_replies_and_messages() -> None:
    """Events before the state that they explain; decisions come once it is known what was sent."""
    made = CommandFlow(CHASSIS, Settings(), 7)
    request = RawRequest(5, "acquire", "first", b"\x80", 1)
    due = made.tick(STANDING, [request], 10 * MS, WALL_NS, 0, CHALLENGE)
    assert due.frames == []
    [reply] = due.replies
    assert (reply.handle, reply.verb) == (5, "acquire")
    assert msgspec.msgpack.decode(reply.payload, type=Reply).ok
    assert [sample.subject for sample in due.samples] == ["safety/event", "safety/state"]
    assert [message_of(due.samples[0])] == due.events
    [decision] = map(message_of, made.sent(0, 10 * MS, WALL_NS))
    assert isinstance(decision, Decision)
    assert (decision.request, decision.frames_sent) == ("acquire", 0)
    assert made.sent(0, 10 * MS, WALL_NS) == [], "a tick is told once"
    assert made.tick(STANDING, [], 20 * MS, WALL_NS, 0, CHALLENGE).samples == [], "no state where none is due"


def test_send_failures_are_counted_in_a_row() -> None:
    """One whole burst in between begins anew; lamps that were not taken count too, but are no step."""
    rig, operator = driving(0.5)
    assert rig.core.command is not None
    arbiter = rig.core.command.arbiter
    for takes, failures, is_step in ((4, 1, False), (0, 2, False), (None, 0, True), (3, 1, False)):
        rig.takes, motion = takes, arbiter.output.motion
        rig.put("first", "drive", operator.drive_payload(0.5))
        rig.tick()
        assert (arbiter.monitor.send_failures, arbiter.output.motion is not motion) == (failures, is_step)
    rig.takes = None
    operator.reason("horn", on=True)
    rig.takes, motion = 5, arbiter.output.motion
    rig.put("first", "drive", operator.drive_payload(0.5))
    rig.tick()
    assert (arbiter.monitor.send_failures, arbiter.output.motion is not motion) == (1, True)

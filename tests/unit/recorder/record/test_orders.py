"""Remote requests to a recorder, and the replies."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.record.actions import Deleted, Opened
from recorder.record.orders import MARK_EVERY_NS, MARKS_AT_ONCE, REPLY_NS, Orders
from schemas.codec import PayloadFault
from schemas.recording import Mark, Status
from schemas.requests import Request
from tests.support.fakes.recording import RECORDER_PLAN, FakeAsked
from tests.support.messages import SECOND, WALL_NS, gear, recorder_health, sample_of
from tests.support.rigs.recorder import RecorderRig


class Desk(RecorderRig):
    """Orders for a recorder, whose disk opens files on request."""

    def __init__(self) -> None:
        super().__init__(RECORDER_PLAN)
        self.has_mark_room = True
        self.orders = Orders(
            self.recorder, lambda: recorder_health(self.recorder.state), lambda: self.has_mark_room
        )

    def hear(self, *robots: str) -> None:
        self.receive(*(sample_of(gear(0), robot) for robot in robots))

    def ask(self, request: Request | PayloadFault) -> FakeAsked:
        asked = FakeAsked(request)
        self.writer.apply(self.orders.handle(asked.asked, self.now_ns, WALL_NS))
        return asked

    def notice(self, only: str = "") -> None:
        notices = self.writer.notices
        self.writer.notices = [one for one in notices if isinstance(one, Opened) and only in {"", one.log}]
        for notice in self.writer.notices:
            self.orders.receive_notice(notice)
        super().notice()
        self.orders.tick(self.now_ns)


def test_status_names_the_files_that_are_written() -> None:
    desk = Desk()
    desk.hear("b", "a")
    desk.ask(Mark())
    desk.notice()
    assert desk.ask(Status()).answer.files == ["a-0.mcap", "b-0.mcap"]


def test_a_mark_names_its_incidents() -> None:
    desk = Desk()
    desk.hear("a", "b")
    first = desk.ask(Mark("it shook", "a"))
    desk.notice()
    assert first.answer.files == ["a-0.incident.mcap"]
    assert desk.recorder._logs["a"].incidents.about["because"] == "mark by operator-1: it shook"
    assert desk.ask(Mark("", "a")).answer.files == ["a-0.incident.mcap"]
    both = desk.ask(Mark())
    assert not both.replies
    desk.notice()
    assert both.answer.files == ["a-0.incident.mcap", "b-0.incident.mcap"]
    assert desk.recorder._logs["b"].incidents.about["because"] == "mark by operator-1"


@pytest.mark.parametrize(
    ("mark", "detail"),
    [
        (Mark("", "c"), "no data received from c"),
        (Mark("", "a"), "the disk space for marks is used up"),
    ],
)
def test_a_mark_that_cannot_be_is_refused(mark: Mark, detail: str) -> None:
    desk = Desk()
    assert desk.ask(Mark()).answer.detail == "no data received"
    unread = desk.ask(PayloadFault("no such field")).answer
    assert (unread.ok, unread.detail) == (False, "no such field")
    desk.hear("a")
    desk.room(has_incident_room=mark.robot == "c")
    answer = desk.ask(mark).answer
    assert (answer.ok, answer.detail, answer.files) == (False, detail, [])


def test_a_flood_of_marks_is_refused() -> None:
    desk = Desk()
    desk.hear("a")
    desk.now_ns = 5 * SECOND
    assert [desk.ask(Mark("", "nobody")).answer.ok for _ in range(3)] == [False] * 3, "what keeps nothing is free"
    asked = [desk.ask(Mark(f"mark {number}")) for number in range(MARKS_AT_ONCE + 2)]
    desk.notice()
    assert [one.answer.ok for one in asked] == [True] * MARKS_AT_ONCE + [False] * 2
    assert asked[-1].answer.detail == "too many marks; try again in 300 s"
    for more in (1, 1, MARKS_AT_ONCE):
        desk.now_ns += more * MARK_EVERY_NS
        asked = [desk.ask(Mark()) for _ in range(more + 1)]
        desk.notice()
        assert [one.answer.ok for one in asked] == [True] * more + [False]


def test_marks_leave_room_for_incidents_of_faults() -> None:
    desk = Desk()
    desk.hear("a")
    for has_room, has_mark_room in ((True, False), (False, True)):
        desk.room(has_room=has_room)
        desk.has_mark_room = has_mark_room
        answer = desk.ask(Mark()).answer
        assert (answer.ok, answer.detail) == (False, "the disk space for marks is used up")
        assert desk.recorder.has_incident_room
    assert desk.recorder.incidents == 0


def test_a_disk_that_does_not_answer_keeps_nobody_waiting() -> None:
    desk = Desk()
    desk.hear("a", "b")
    desk.notice()
    asked = desk.ask(Mark())
    desk.notice("a!")
    desk.orders.tick(REPLY_NS - 1)
    assert not asked.replies
    desk.orders.tick(REPLY_NS)
    assert asked.answer.ok
    assert asked.answer.files == ["a-0.incident.mcap"]
    assert asked.answer.detail.endswith("; not yet on disk")
    desk.orders.tick(2 * REPLY_NS)


REQUESTS = st.sampled_from([Status(), Mark(), Mark("x", "a"), PayloadFault("x")])


@given(st.lists(st.one_of(REQUESTS, st.sampled_from(["receive", "notice", "wait", "close", "full", "room"]))))
def test_whoever_asks_is_answered_once_and_in_time(steps: list[Request | PayloadFault | str]) -> None:
    desk = Desk()
    asked: list[tuple[int, FakeAsked]] = []
    for step in steps:
        match step:
            case "receive":
                desk.hear("a", "b")
            case "notice":
                desk.notice()
            case "wait":
                desk.now_ns += SECOND
                desk.writer.apply(desk.recorder.tick(desk.now_ns, WALL_NS, {}))
                desk.orders.tick(desk.now_ns)
            case "full" | "room":
                desk.room(has_room=step == "room")
            case "close":
                desk.orders.receive_notice(Deleted("x", 1))
            case str():
                pytest.fail(step)
            case _:
                asked.append((desk.now_ns, desk.ask(step)))
        for at_ns, one in asked:
            assert one.is_done or desk.now_ns < at_ns + REPLY_NS
    files = {file.name for files in desk.writer.files.values() for file in files}
    desk.orders.tick(desk.now_ns + REPLY_NS)
    for _, one in asked:
        assert set(one.answer.files) <= files

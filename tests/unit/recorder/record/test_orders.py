"""What operators ask of a recorder, and what they are told."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recorder.record.actions import CloseLog
from recorder.record.notices import Deleted, DiskRoom, Ended, Opened
from recorder.record.orders import REPLY_NS, Orders
from recorder.record.recorder import Recorder
from schemas.codec import PayloadFault
from schemas.recording import Mark, RecorderState, Split, Start, Status, StopRecording
from schemas.requests import Request
from tests.support.fakes.recording import RECORDER_PLAN, FakeAsked, MemoryWriter
from tests.support.messages import SECOND, WALL_NS, gear, recorder_health, sample_of


class Desk:
    """Orders for a recording that a writer in memory carries out."""

    def __init__(self) -> None:
        self.recorder = Recorder(RECORDER_PLAN)
        self.writer = MemoryWriter()
        self.orders = Orders(self.recorder, lambda: recorder_health(self.recorder.state))
        self.now_ns = 0

    def receive(self, *robots: str) -> None:
        for robot in robots:
            actions = self.recorder.receive([sample_of(gear(0), robot)], self.now_ns)
            self.writer.apply(actions)

    def ask(self, request: Request | PayloadFault) -> FakeAsked:
        asked = FakeAsked(request)
        self.writer.apply(self.orders.obey(asked.asked, self.now_ns, WALL_NS))
        return asked

    def notice(self, only: Callable[[str], bool] = lambda _: True) -> None:
        """What became of the files, of these logs only."""
        notices, self.writer.notices = self.writer.notices, []
        for notice in notices:
            assert isinstance(notice, Opened | Ended)
            if only(notice.log):
                self.orders.receive_notice(notice)
                self.writer.apply(self.recorder.receive_notice(notice, self.now_ns, WALL_NS))
        self.orders.tick(self.now_ns)

    def room(self, *, has_room: bool = True, has_incident_room: bool = True) -> None:
        self.writer.apply(
            self.recorder.receive_notice(DiskRoom(has_room, has_incident_room), self.now_ns, WALL_NS)
        )


def test_a_split_names_the_files_that_it_ended() -> None:
    """Once the disk has them, all of them."""
    desk = Desk()
    desk.receive("b", "a")
    desk.notice()
    asked = desk.ask(Split())
    assert not asked.replies
    desk.notice(lambda log: log == "a")
    assert not asked.replies
    desk.orders.receive_notice(Ended("b", "b-0.mcap", 1))
    desk.orders.tick(desk.now_ns)
    assert (asked.answer.ok, asked.answer.files) == (True, ["a-0.mcap", "b-0.mcap"])
    assert asked.answer.detail == "the next samples begin new files"


def test_a_file_that_the_disk_has_not_begun_yet_is_waited_for() -> None:
    """It is being written all the same."""
    desk = Desk()
    desk.receive("a")
    asked = desk.ask(Split())
    desk.notice()
    assert not asked.replies
    desk.writer.apply(desk.recorder.tick(desk.now_ns, WALL_NS, {}))
    desk.notice()
    assert (asked.answer.files, asked.answer.detail) == (["a-0.mcap"], "the next samples begin new files")


def test_a_split_of_nothing_is_answered_at_once() -> None:
    """There is nothing to wait for, and it says so."""
    assert Desk().ask(Split()).answer.detail == "no file is being written"


def test_a_stop_ends_the_logs_and_a_start_goes_on() -> None:
    """Each reply says what the recorder does now; who asks twice is told the same."""
    desk = Desk()
    desk.receive("a")
    stop = desk.ask(StopRecording())
    again = desk.ask(StopRecording())
    assert again.answer.health.state is RecorderState.STOPPED
    desk.notice()
    assert (stop.answer.files, stop.answer.health.state) == (["a-0.mcap"], RecorderState.STOPPED)
    assert "stopped" in stop.answer.detail
    start = desk.ask(Start())
    assert (start.answer.detail, start.answer.health.state) == ("recording", RecorderState.RECORDING)
    desk.room(has_room=False)
    assert "disk" in desk.ask(Start()).answer.detail


def test_status_names_the_files_that_are_written() -> None:
    """In order, without the incidents."""
    desk = Desk()
    desk.receive("b", "a")
    desk.ask(Mark())
    desk.notice()
    assert desk.ask(Status()).answer.files == ["a-0.mcap", "b-0.mcap"]


def test_a_mark_names_its_incidents() -> None:
    """One that is under way at once, the others when they are begun; its reason goes into them."""
    desk = Desk()
    desk.receive("a", "b")
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
    [(Mark("", "c"), "nothing of c has been heard"), (Mark("", "a"), "the disk may hold no more incidents")],
)
def test_a_mark_that_cannot_be_is_refused(mark: Mark, detail: str) -> None:
    """With the reason."""
    desk = Desk()
    assert desk.ask(Mark()).answer.detail == "nothing has been heard"
    desk.receive("a")
    desk.room(has_incident_room=mark.robot == "c")
    answer = desk.ask(mark).answer
    assert (answer.ok, answer.detail, answer.files) == (False, detail, [])


def test_a_disk_that_does_not_answer_keeps_nobody_waiting() -> None:
    """After a while the reply says how far it has come."""
    desk = Desk()
    desk.receive("a", "b")
    desk.notice()
    asked = desk.ask(Split())
    desk.notice(lambda log: log == "a")
    desk.orders.tick(REPLY_NS - 1)
    assert not asked.replies
    desk.orders.tick(REPLY_NS)
    assert asked.answer.ok
    assert asked.answer.files == ["a-0.mcap"]
    assert asked.answer.detail.endswith("; the disk has not done it yet")
    desk.orders.tick(2 * REPLY_NS)


def test_what_cannot_be_read_is_refused() -> None:
    """With what is wrong."""
    answer = Desk().ask(PayloadFault("no such field")).answer
    assert (answer.ok, answer.detail) == (False, "no such field")


REQUESTS = st.sampled_from(
    [Status(), Start(), StopRecording(), Split(), Mark(), Mark("x", "a"), PayloadFault("x")]
)


@given(st.lists(st.one_of(REQUESTS, st.sampled_from(["receive", "notice", "wait", "close", "full", "room"]))))
def test_whoever_asks_is_answered_once_and_in_time(steps: list[Request | PayloadFault | str]) -> None:
    """Whatever else is asked meanwhile, whatever the disk does, with files that exist."""
    desk = Desk()
    asked: list[tuple[int, FakeAsked]] = []
    for step in steps:
        match step:
            case "receive":
                desk.receive("a", "b")
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


def test_the_files_are_ended_by_what_is_returned() -> None:
    """The caller carries it out; nothing is done behind its back."""
    desk = Desk()
    desk.receive("a")
    desk.notice()
    actions = desk.orders.obey(FakeAsked(Split()).asked, 0, WALL_NS)
    assert actions[-1] == CloseLog("a")
    desk.writer.apply(actions)

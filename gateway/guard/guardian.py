"""The guard's decisions: when to act, and for how long. Pure: time, beats and frames in, frames to send out."""

from __future__ import annotations

from typing import Final

from gateway.chassis.frame import Frame
from gateway.chassis.port import Chassis
from gateway.guard.stopper import (
    MOTOR,
    NOT_OBEYED,
    REMOTE,
    STANDS,
    UNSEEN,
    Beat,
    Cause,
    GuardStatus,
    StopOutcome,
    Stopper,
)
from schemas.messages import Mode
from schemas.settings import (
    COMMANDER_NS,
    GUARD_GIVES_UP_NS,
    GUARD_LATE_NS,
    GUARD_POLL_NS,
    GUARD_SILENT_NS,
    CommandSettings,
)

_LATE_LOOKS: Final = 2
"""Late looks in a row before a stop: after a pause of the whole computer the loop may beat before the second."""

_OUTCOMES: Final = {outcome.value: outcome for outcome in StopOutcome}


class Guardian:
    """Watches the heartbeat, and stops the robot when it fails.

    Attributes:
        is_sending: a stop is under way, and the loop must not send. The stop is completed even if the loop
            recovers: a loop that has seen this flag does not take the robot back.
    """

    def __init__(self, chassis: Chassis, settings: CommandSettings) -> None:
        self.view = chassis.view()
        self.is_ended = False  # nothing is left to guard; the process may exit
        self.is_sending = False
        self.stops = 0
        self.cause = Cause.NONE  # of the current or last stop
        self.outcome = StopOutcome.NONE  # of the last stop; NONE while one is under way
        self._stopper = Stopper(chassis, self.view, settings)
        # One stop per failure: only a loop that has recovered can fail again.
        self._is_armed = True
        self._late_looks = 0
        self._began_ns = self._feedback_ns = 0
        self._ticked_ns: int | None = None
        self._gone_since_ns: int | None = None
        # Completion time of our last stop: earlier commands no longer count.
        self._ended_ns = 0
        self._was_paused = False
        self._late_at_ns = 0
        self._was_asked_to_end = False
        self._lines: list[str] = []

    def ask_to_end(self) -> None:
        """Note a signal to end. It is ignored while the chassis is under command."""
        self._was_asked_to_end = True

    def receive(self, frame: Frame, now_ns: int) -> None:
        self.view.receive(frame, now_ns)

    def tick(self, beat: Beat | None, now_ns: int, *, parent_lives: bool, bus_up: bool) -> list[Frame]:
        """Check the heartbeat, and continue or begin a stop.

        Returns the frames to send now. ``is_sending`` must be reported to the loop before they are sent.
        """
        cause: Cause | None = None
        paused_ns = 0 if self._ticked_ns is None else now_ns - self._ticked_ns
        self._ticked_ns = now_ns
        is_fresh = beat is not None and now_ns - beat.now_ns <= GUARD_LATE_NS
        self._late_at_ns = beat.now_ns + GUARD_LATE_NS + 1 if beat is not None else 0
        is_alone = not parent_lives or (beat is not None and beat.is_closing)
        if is_fresh and beat is not None and not beat.is_mute and not self.is_sending and not is_alone:
            self._is_armed = True
        if self.view.has_feedback(now_ns):
            self._feedback_ns = now_ns
        if self.is_sending:
            self._give_up_if_in_vain(
                now_ns, is_superfluous=is_fresh and not is_alone and paused_ns > GUARD_SILENT_NS
            )
        else:
            cause = self._cause(beat, now_ns, is_fresh=is_fresh, is_alone=is_alone)
            if cause is not None and beat is not None and bus_up and not self._is_taken(beat, now_ns):
                self._begin(beat, cause, now_ns)
        is_needed = self.is_sending or cause is not None
        if not bus_up or not self.is_sending:
            self.is_ended |= self._may_leave(beat, now_ns, is_needed=is_needed, is_alone=is_alone)
            self._was_asked_to_end = False
            return []
        self._gone_since_ns = None
        frames = self._stopper.tick(now_ns)
        self._tell_pause()
        if self._stopper.is_over:
            self._finish()
        return frames

    def next_look_ns(self, now_ns: int) -> int:
        """Return the time of the next check: soon, and right when the newest heartbeat becomes late."""
        due_ns = now_ns + GUARD_POLL_NS
        return min(due_ns, self._late_at_ns) if self._late_at_ns > now_ns else due_ns

    def sent(self, count: int, now_ns: int) -> None:
        """Note that the bus accepted the first ``count`` frames of this tick."""
        self._stopper.sent(count, now_ns)

    def status(self, now_ns: int, *, bus_up: bool) -> GuardStatus:
        is_ready = bus_up and self.view.has_feedback(now_ns)
        return GuardStatus(now_ns, is_ready, self.is_sending, self.stops, self.cause, self.outcome)

    def take_lines(self) -> list[str]:
        lines, self._lines = self._lines, []
        return lines

    def _is_left(self, beat: Beat) -> bool:
        """Return True if the chassis still holds our last command, as after a takeover by the remote control (RC).

        It executes that command indefinitely, unless another computer has commanded it since.
        """
        commander_ns = self.view.commander_ns
        is_old = commander_ns is not None and commander_ns - beat.now_ns > GUARD_SILENT_NS
        return beat.is_left and beat.told_ns > self._ended_ns and not is_old

    def _is_taken(self, last: Beat, now_ns: int) -> bool:
        """Return True if another computer has begun to command the chassis, and a late stop must not interfere."""
        commander_ns = self.view.commander_ns
        return (
            commander_ns is not None
            and now_ns - last.now_ns > GUARD_SILENT_NS
            and now_ns - commander_ns < COMMANDER_NS
        )

    def _cause(self, beat: Beat | None, now_ns: int, *, is_fresh: bool, is_alone: bool) -> Cause | None:
        self._late_looks = 0 if is_fresh else self._late_looks + 1
        if beat is None or not self._is_armed:
            return None
        if not beat.is_active:
            # A loop that stands by may be late or end, unless the chassis still holds its command.
            if not self._is_left(beat):
                return None
            if is_alone:
                return Cause.GONE
            is_obeyed = self.view.mode(now_ns) is Mode.AUTO
            return Cause.LATE if is_obeyed and self._late_looks >= _LATE_LOOKS else None
        if is_alone:
            return Cause.GONE
        if beat.is_mute:
            return Cause.MUTE
        return Cause.LATE if self._late_looks >= _LATE_LOOKS else None

    def _begin(self, last: Beat, cause: Cause, now_ns: int) -> None:
        self.is_sending = True
        self.cause = cause
        self.outcome = StopOutcome.NONE
        self.stops += 1
        self._began_ns = self._feedback_ns = now_ns
        self._stopper.begin(
            last.last,
            last.variant,
            last.counters,
            now_ns,
            last.told_ns,
            is_released=last.is_released,
            returns=last.returns,
        )
        age_ms = (now_ns - last.now_ns) / 1e6
        self._lines.append(f"{cause.value}, last heartbeat {age_ms:.0f} ms ago: stopping the robot")

    def _give_up_if_in_vain(self, now_ns: int, *, is_superfluous: bool) -> None:
        if self._stopper.is_paused:
            # Wait as long as the chassis sends: once given back, it executes its last command again.
            self._began_ns = now_ns
        if is_superfluous:
            # This process was the one that stood still; the loop no longer relies on it.
            self._stopper.give_up("given back to the gateway after a pause of the guard itself")
        elif now_ns - self._began_ns > GUARD_GIVES_UP_NS and self._stopper.stays:
            # The chassis holds its last command: zero speed, in gear.
            self._stopper.give_up(MOTOR)
        elif now_ns - self._began_ns > GUARD_GIVES_UP_NS:
            why = NOT_OBEYED if self._stopper.is_transmitting(now_ns) else "the bus accepts no frames"
            self._stopper.give_up(f"given up: {why}")
        elif self._stopper.is_paused and now_ns - self._feedback_ns > GUARD_GIVES_UP_NS:
            self._stopper.give_up("given up: the remote control had the robot, and its feedback has ended")
        if self._stopper.is_over:
            self._finish()

    def _tell_pause(self) -> None:
        is_paused = self._stopper.is_paused and not self._stopper.is_over
        if is_paused and not self._was_paused:
            self._lines.append(f"{REMOTE}: waiting until it gives it back")
        self._was_paused = is_paused

    def _finish(self) -> None:
        self.is_sending = False
        self._is_armed = False
        self._late_looks = 0
        self.outcome = _OUTCOMES.get(self._stopper.outcome, StopOutcome.GIVEN_UP)
        if self._stopper.outcome in {STANDS, UNSEEN}:
            self._ended_ns = self._ticked_ns or 0
        self._lines.append(f"done: {self._stopper.outcome}; {self._stopper.frames} frames sent")

    def _may_leave(self, beat: Beat | None, now_ns: int, *, is_needed: bool, is_alone: bool) -> bool:
        if not is_alone:
            is_bound = beat is not None and (beat.is_active or self._is_left(beat))
            return self._was_asked_to_end and not is_needed and not is_bound
        if not is_needed:
            return True
        # The robot should be stopped, and there is no bus to do it on.
        if self._gone_since_ns is None:
            self._gone_since_ns = now_ns
        given_up = now_ns - self._gone_since_ns > GUARD_GIVES_UP_NS
        if given_up:
            self._lines.append("given up: there is no bus to stop the robot on, or another computer commands it")
        return given_up

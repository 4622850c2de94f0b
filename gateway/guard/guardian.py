"""When the guard acts, and for how long. Pure: time, heartbeat and frames come in, frames to send come out."""

from __future__ import annotations

from gateway.chassis.frame import Frame
from gateway.guard.beat import Beat, Cause, GuardStatus
from gateway.guard.sight import Sight
from gateway.guard.stopper import Stopper
from schemas.settings import GUARD_GIVES_UP_NS, GUARD_LATE_NS, GUARD_SILENT_NS, CommandSettings

_LATE_LOOKS = 2
"""Late in so many looks: where the whole machine stood still, the loop may beat before the second."""


class Guardian:
    """Watches the heartbeat, and stops the robot when it fails.

    Attributes:
        is_ended: nothing is left to guard; the process may leave.
        is_sending: a stop is under way, and the loop has to keep silent. It is carried through also when the loop
            comes back: a loop that has seen this will not take the robot again.
        stops: how many stops it has ended.
        cause: of the last one, or of the one under way.
    """

    def __init__(self, settings: CommandSettings) -> None:
        self.sight = Sight()
        self.is_ended = False
        self.is_sending = False
        self.stops = 0
        self.cause = Cause.NONE
        self._stopper = Stopper(self.sight, settings)
        # One stop for each failure: after it, only a loop that is well again can fail again.
        self._is_armed = True
        self._late_looks = 0
        self._began_ns = 0
        self._ticked_ns: int | None = None
        self._gone_since_ns: int | None = None
        self._was_asked_to_end = False
        self._lines: list[str] = []

    def ask_to_end(self) -> None:
        """A signal asks the process to end. While the chassis is being told something that is ignored."""
        self._was_asked_to_end = True

    def receive(self, frame: Frame, now_ns: int) -> None:
        """A frame came from the bus."""
        self.sight.receive(frame, now_ns)

    def tick(self, beat: Beat | None, now_ns: int, *, parent_lives: bool, bus_up: bool) -> list[Frame]:
        """Time to look.

        Args:
            beat: the newest one; None before the first.
            now_ns: monotonic.
            parent_lives: the gateway's process has not ended.
            bus_up: frames can be sent.

        Returns:
            The frames to send now. ``is_sending`` has to be told to the loop before they are.
        """
        cause: Cause | None = None
        paused_ns = 0 if self._ticked_ns is None else now_ns - self._ticked_ns
        self._ticked_ns = now_ns
        is_fresh = beat is not None and now_ns - beat.now_ns <= GUARD_LATE_NS
        if is_fresh and beat is not None and not beat.is_mute and not self.is_sending:
            self._is_armed = True
        if self.is_sending:
            if beat is not None and is_fresh and beat.is_active and paused_ns > GUARD_SILENT_NS and parent_lives:
                # This process was the one that stood still, and the loop no longer counts on it.
                self._stopper.give_up("given back to the gateway, after a pause of the guard itself")
                self._finish()
            elif now_ns - self._began_ns > GUARD_GIVES_UP_NS:
                self._stopper.give_up("given up: the bus takes no frames")
                self._finish()
        else:
            cause = self._cause(beat, is_fresh=is_fresh, parent_lives=parent_lives)
            if cause is not None and beat is not None and bus_up:
                self._begin(beat, cause, now_ns)
        is_needed = self.is_sending or cause is not None
        if not bus_up or not self.is_sending:
            self.is_ended |= self._may_leave(beat, now_ns, is_needed=is_needed, parent_lives=parent_lives)
            self._was_asked_to_end = False
            return []
        frames = self._stopper.tick(now_ns)
        if self._stopper.is_over:
            self._finish()
        return frames

    def sent(self, count: int, now_ns: int) -> None:
        """So many of the frames of this tick were taken by the bus."""
        self._stopper.sent(count, now_ns)

    def status(self, now_ns: int, *, bus_up: bool) -> GuardStatus:
        """What the loop is told."""
        is_ready = bus_up and self.sight.hears(now_ns)
        return GuardStatus(now_ns, is_ready, self.is_sending, self.stops, self.cause)

    def take_lines(self) -> list[str]:
        """What there is to tell people since the last call."""
        lines, self._lines = self._lines, []
        return lines

    def _cause(self, beat: Beat | None, *, is_fresh: bool, parent_lives: bool) -> Cause | None:
        """Why to act now, if there is a reason."""
        self._late_looks = 0 if is_fresh else self._late_looks + 1
        if beat is None or not beat.is_active or not self._is_armed:
            return None
        if not parent_lives or beat.is_closing:
            return Cause.GONE
        if beat.is_mute:
            return Cause.MUTE
        return Cause.LATE if self._late_looks >= _LATE_LOOKS else None

    def _begin(self, beat: Beat, cause: Cause, now_ns: int) -> None:
        self.is_sending = True
        self.cause = cause
        self._began_ns = now_ns
        self._stopper.begin(beat.last, beat.variant, beat.counters, now_ns)
        age_ms = (now_ns - beat.now_ns) / 1e6
        self._lines.append(f"{cause.value}, last heartbeat {age_ms:.0f} ms ago: stopping the robot")

    def _finish(self) -> None:
        self.is_sending = False
        self._is_armed = False
        self._late_looks = 0
        self.stops += 1
        self._lines.append(f"done: {self._stopper.outcome}; {self._stopper.frames} frames sent")

    def _may_leave(self, beat: Beat | None, now_ns: int, *, is_needed: bool, parent_lives: bool) -> bool:
        if parent_lives and not (beat is not None and beat.is_closing):
            return self._was_asked_to_end and not is_needed and not (beat is not None and beat.is_active)
        if not is_needed:
            return True
        # The robot should be stopped, and there is no bus to do it on.
        if self._gone_since_ns is None:
            self._gone_since_ns = now_ns
        given_up = now_ns - self._gone_since_ns > GUARD_GIVES_UP_NS
        if given_up:
            self._lines.append("given up: there is no bus to stop the robot on")
        return given_up

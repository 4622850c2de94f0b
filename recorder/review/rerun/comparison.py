"""The comparison of what was recorded with what the same inputs give again, byte for byte.

Either side may be ahead of the other. What both have is compared and forgotten, so memory holds no more than their
distance.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Final

import msgspec

DIFFERENCES_TOLD: Final = 1000
"""Differences that are listed one by one; the rest are only counted."""

WAITING_MAX: Final = 200_000
"""Records and samples that wait for their counterpart; beyond it the oldest are given up, and counted."""

COPIES_MAX: Final = 100_000
"""Compared messages of a subject that are remembered: two recorders write each of them."""

SAME_RUN_NS: Final = 10_000_000_000
"""The two sides of a message have the same time. Where they do not by far, a sequence has begun anew."""

BATCH_NS: Final = 100_000_000
"""Longest delay of what a gateway says in batches: the end of a run may be missing from them."""

Key = tuple[str, Hashable]
"""The subject, and a value that distinguishes its messages."""


class RecordedOutput(msgspec.Struct, frozen=True, gc=False):
    """A record: its publish time in nanoseconds since 1970, and its bytes."""

    time_ns: int
    data: bytes


class Difference(msgspec.Struct, frozen=True):
    """A message that is not the same.

    Attributes:
        subject: in the table of subjects.
        time_ns: nanoseconds since 1970.
        what: ``changed`` or ``only recorded``.
        fields: of a changed one each field that differs: what was recorded, and what comes out again.
        message: of one that was only recorded the whole of it.
    """

    subject: str
    time_ns: int
    what: str
    fields: dict[str, tuple[Any, Any]] = {}
    message: Any = None


class Comparison:
    """Compares the two sides.

    Args:
        decode: the bytes of a subject's record to its message, to say what differs.

    Attributes:
        same: number of equal messages, by subject.
        differences: the first ones.
        difference_count: all of them.
        unrecorded: messages that come out again and are not in the log, by subject: it lost them, or was not to
            hold them.
        given_up: messages that waited too long for their counterpart, or came too long after it.
        begins_ns, ends_ns: the times of the first message with a sequence and of the newest of all that came out
            again, since 1970; ``begins_ns`` is None before.
    """

    def __init__(self, decode: Callable[[str, bytes], Any]) -> None:
        self._decode = decode
        self.same: Counter[str] = Counter()
        self.differences: list[Difference] = []
        self.difference_count = 0
        self.unrecorded: Counter[str] = Counter()
        self.given_up = 0
        self.begins_ns: int | None = None
        self.ends_ns = 0
        self._recorded: OrderedDict[Key, RecordedOutput] = OrderedDict()
        self._others: OrderedDict[tuple[Key, RecordedOutput], None] = OrderedDict()
        self._again: OrderedDict[Key, RecordedOutput] = OrderedDict()
        self._compared: dict[str, OrderedDict[Hashable, int]] = {}
        self._forgotten: dict[str, Any] = {}

    def record(self, key: Key, said: RecordedOutput) -> None:
        """A message of the log."""
        again = _counterpart(self._again, key, said)
        if again is not None:
            self._compare(key, said, again)
        elif said.time_ns > self.ends_ns or not self._is_copy(key, said):
            self._wait_recorded(key, said)

    def say_again(self, key: Key, said: RecordedOutput) -> None:
        """A message that comes out of the inputs."""
        if self.begins_ns is None and isinstance(key[1], int):
            # Not with a frame that was received: behind a place of rest the next state comes at another time.
            self.begins_ns = said.time_ns
        self.ends_ns = max(self.ends_ns, said.time_ns)
        if self._others and (key, said) in self._others:
            # What was recorded before it under the same key does not come again.
            del self._others[key, said]
            recorded: RecordedOutput | None = said
        else:
            recorded = _counterpart(self._recorded, key, said)
        if recorded is not None:
            self._compare(key, recorded, said)
        else:
            self._wait(self._again, key, said)

    def end(self) -> list[tuple[Key, RecordedOutput]]:
        """Nothing more comes out. Returns what was recorded later than that: it belongs to what follows.

        What was recorded before the first message that came out again belongs to nothing.
        """
        # What was said last is in a batch that may not have been published any more.
        last_ns = self.ends_ns - BATCH_NS
        self.unrecorded.update(key[0] for key, said in self._again.items() if said.time_ns <= last_ns)
        self._again.clear()
        later: list[tuple[Key, RecordedOutput]] = []
        begins_ns = self.begins_ns or 0
        for key, said in (*self._recorded.items(), *self._others):
            if said.time_ns > self.ends_ns - BATCH_NS:
                later.append((key, said))
            elif said.time_ns >= begins_ns and not self._is_copy(key, said):
                self._differ(
                    Difference(key[0], said.time_ns, "only recorded", message=self._decode(key[0], said.data))
                )
        self._recorded.clear()
        self._others.clear()
        return later

    def _is_copy(self, key: Key, said: RecordedOutput) -> bool:
        """Report whether it is a second copy of what was compared already, or comes too late to tell."""
        subject, value = key
        compared = self._compared.setdefault(subject, OrderedDict()).get(value)
        if compared is not None:
            return compared == hash(said)
        is_forgotten = subject in self._forgotten and value <= self._forgotten[subject]
        self.given_up += is_forgotten
        return is_forgotten

    def _compare(self, key: Key, recorded: RecordedOutput, again: RecordedOutput) -> None:
        subject = key[0]
        compared = self._compared.setdefault(subject, OrderedDict())
        compared[key[1]] = hash(recorded)
        if len(compared) > COPIES_MAX:
            self._forgotten[subject], _ = compared.popitem(last=False)
        if recorded.data == again.data:
            self.same[subject] += 1
            return
        if self.difference_count >= DIFFERENCES_TOLD:
            self.difference_count += 1
            return
        then, now = self._decode(subject, recorded.data), self._decode(subject, again.data)
        fields = {
            name: (before, after)
            for name in then.__struct_fields__
            if (before := getattr(then, name)) != (after := getattr(now, name))
        }
        self._differ(Difference(subject, recorded.time_ns, "changed", fields))

    def _differ(self, difference: Difference) -> None:
        self.difference_count += 1
        if len(self.differences) < DIFFERENCES_TOLD:
            self.differences.append(difference)

    def _wait_recorded(self, key: Key, said: RecordedOutput) -> None:
        """Keep it, beside what waits under its key: of another run, or put in by somebody."""
        first = self._recorded.get(key)
        if first is None:
            self._wait(self._recorded, key, said)
        elif first != said:
            if abs(first.time_ns - said.time_ns) > SAME_RUN_NS:
                self._recorded[key], said = said, first
            self._wait(self._others, (key, said), None)

    def _wait(self, waiting: OrderedDict[Any, Any], key: Hashable, said: RecordedOutput | None) -> None:
        waiting[key] = said
        if len(waiting) > WAITING_MAX:
            waiting.popitem(last=False)
            # Before anything came out again nothing was to be compared.
            self.given_up += self.begins_ns is not None


def _counterpart(
    waiting: OrderedDict[Key, RecordedOutput], key: Key, said: RecordedOutput
) -> RecordedOutput | None:
    """The other side of a message, if it waits. One of another run, with the same sequence, is none."""
    other = waiting.get(key)
    if other is None or abs(other.time_ns - said.time_ns) > SAME_RUN_NS:
        return None
    del waiting[key]
    return other

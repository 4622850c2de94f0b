"""The journal of a core's inputs, and its checkpoints. Pure.

With the configuration and the run number the journal is enough to run the core again: see ``gateway.rerun``. An
input is an array: its kind, the monotonic time, and the arguments of the core's method of that kind. Once a
minute, while the gateway is at rest, the journal has a snapshot, from which a rerun can begin.

A checkpoint is the whole state of the core as plain values, by class and attribute names. Logs contain these
names, so a class keeps its first name as an alias when it is moved or renamed. Parts that never change, such as
decoders, layouts and functions, are left out. A checkpoint contains no code, and only classes of the table can be
made from it.
"""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Iterable, Iterator
from enum import Enum
from random import Random
from typing import Any, Final

import msgspec

from gateway.chassis.cruiser.bursts import FrameMaker
from gateway.chassis.cruiser.frames import StandstillEvidence
from gateway.chassis.cruiser.gate import Gate, MotionBurst
from gateway.chassis.cruiser.tracker import ChassisTracker, Encoders
from gateway.chassis.frame import FaultKind, Frame
from gateway.chassis.odometry import DeadReckoning
from gateway.chassis.port import Actuation, AuxiliaryFrame, Chassis, ChassisState
from gateway.chassis.supervision import AliveCounter, FaultWindow, FrameSupervisor, Period, VariantDetector
from gateway.command.arbiter import Arbiter, Reporter
from gateway.command.auxiliary import Auxiliary
from gateway.command.engagement import Engagement, Standing
from gateway.command.flow import CommandFlow
from gateway.command.lease import ChallengeLog, HeldLease, Leases, LinkAge, OperatorLink
from gateway.command.monitor import ChassisMonitor, Envelope, Plausibility, Stillness
from gateway.command.motion import MotionLimits, MotionProfile, Setpoint, Target
from gateway.command.output import Handover, Output
from gateway.command.rulings import (
    Credentials,
    Event,
    Judged,
    Latches,
    Notices,
    Outbox,
    RawRequest,
    Ruling,
    TickOutcome,
    VerbAnswer,
)
from gateway.command.stop import StopSequence
from gateway.command.verbs import Verbs
from gateway.telemetry.feedback import FeedbackStream, FrameBatch
from gateway.telemetry.health import HealthMeter, Links
from schemas.can_word import UnseenRounds
from schemas.decisions import ArbiterState, Bound, EventKind, Journal, Severity, StopPhase
from schemas.journal import COMMAND_RULES, Kind
from schemas.messages import (
    SEQUENCE_MAX,
    Body,
    Braking,
    BrakingStatus,
    ControllerState,
    Drive,
    Gear,
    GearPosition,
    Light,
    Mode,
    Parking,
    ParkingStatus,
    Speaker,
    Steering,
    Variant,
    WheelPulse,
    WheelSpeed,
)
from schemas.reasons import Reason
from schemas.requests import Role

Input = tuple[Any, ...]

LINKS: Final = (
    "bus_up",
    "bus_losses",
    "guarded",
    "guard_sends",
    "guard_stops",
    "is_behind",
    "realtime",
    "guard_says",
)
"""The links that the command flow depends on. Older journals hold only the first six."""

FRAME: Final = Kind.FRAME.value
"""A plain integer, because it is written up to 7,500 times a second and encoded in half the time."""


class JournalWriter:
    """Collects inputs until they are taken."""

    def __init__(self, run: int) -> None:
        self._run = run
        self._inputs: list[Input] = []
        self._first = 0
        self._sequence = 0
        self.add = self._inputs.append

    def take(self, wall_ns: int) -> Journal | None:
        """Return the inputs since the last call as one message; None if there are none."""
        inputs = self._inputs
        if not inputs:
            return None
        journal = Journal(
            time_ns=wall_ns,
            sequence=self._sequence,
            run=self._run,
            first=self._first,
            count=len(inputs),
            inputs=_ENCODER.encode(inputs),
            rules=COMMAND_RULES,
        )
        self._first += len(inputs)
        self._sequence = (self._sequence + 1) & SEQUENCE_MAX
        inputs.clear()
        return journal


_ENCODER: Final = msgspec.msgpack.Encoder()
_DECODER: Final = msgspec.msgpack.Decoder(list[tuple[Any, ...]])


class BrokenJournalError(ValueError):
    """An input that a core cannot take: the log is damaged, or from a newer version."""


class JournalGapError(BrokenJournalError):
    """Part of a run's journal is missing, so it cannot be run again."""


def follow(journals: Iterable[Journal], first: int | None = None) -> Iterator[Input]:
    """The inputs of a run's journals in order, from this place on; None begins with the first journal.

    Raises JournalGapError: some are missing, or another run begins. BrokenJournalError: one cannot be read.
    """
    run, expected = None, first
    for journal in journals:
        if run not in {None, journal.run}:
            raise JournalGapError(f"run {run} ends after {expected} inputs, and run {journal.run} begins")
        run, expected = journal.run, journal.first if expected is None else expected
        if journal.first != expected:
            cure = "" if expected else "; a rerun needs the first input, and the log begins later"
            raise JournalGapError(f"inputs {expected} to {journal.first - 1} are missing{cure}")
        expected += journal.count
        yield from inputs_of(journal)


def inputs_of(journal: Journal) -> list[Input]:
    """The inputs of a message. Raises BrokenJournalError: they cannot be read."""
    try:
        return _DECODER.decode(journal.inputs)
    except (ValueError, RecursionError) as error:  # Not UTF-8, or nested too deeply, as msgspec raises it too.
        raise BrokenJournalError(f"inputs {journal.first} on cannot be read: {error}") from error


CLASSES: Final[dict[str, type]] = {
    kind.__name__: kind
    for kind in (
        *(Frame, FaultKind, Actuation, AuxiliaryFrame, ChassisState, AliveCounter, FaultWindow, FrameSupervisor),
        *(Period, VariantDetector, DeadReckoning, UnseenRounds, FrameMaker, StandstillEvidence, Gate, MotionBurst),
        *(ChassisTracker, Encoders, Arbiter, Reporter, Auxiliary, Engagement, Standing, CommandFlow, ChallengeLog),
        *(HeldLease, Leases, LinkAge, OperatorLink, ChassisMonitor, Envelope, Plausibility, Stillness),
        *(MotionLimits, MotionProfile, Setpoint, Target),
        *(Handover, Output, Credentials, Event, Judged, Latches, Notices, Outbox, RawRequest, Ruling, TickOutcome),
        *(VerbAnswer, StopSequence, Verbs, FeedbackStream, FrameBatch, HealthMeter, Links),
        *(ArbiterState, Bound, EventKind, Severity, StopPhase, Reason, Role),
        *(Body, Braking, BrakingStatus, ControllerState, Drive, Gear, GearPosition, Light, Mode, Parking),
        *(ParkingStatus, Speaker, Steering, Variant, WheelPulse, WheelSpeed),
    )
}
"""By alias: the name, or for a renamed class its first name. No other class is made from a checkpoint; objects of
other classes are left out, because a new core has them."""

RENAMED: Final[dict[str, dict[str, str]]] = {}
"""By alias: renamed attributes, with their names in checkpoints."""

ADDED: Final[dict[str, tuple[str, ...]]] = {
    "ChassisMonitor": ("_driven_ns",),
    "ChassisState": ("creeps",),
    "Core": ("_odometry", "_odometry_due_ns"),
    "Encoders": ("_crept", "_pause"),
}
"""By alias: attributes that earlier checkpoints lack; a new core's values are used. No decision depends on them,
except for a robot that creeps behind its brake, in the seconds after the checkpoint."""


Tree = Any
"""A plain value, or a list: the kind and its contents."""

_PLAIN: Final = (bool, int, float, str, bytes, type(None))

_CONTAINERS: Final[dict[str, type]] = {
    one.__name__: one for one in (list, tuple, set, frozenset, dict, Counter, OrderedDict, deque)
}

_OBJECT, _STRUCT, _ENUM, _RANDOM, _SEEN, _CONSTANT, _VALUE = (
    "object",
    "struct",
    "enum",
    "random",
    "seen",
    "constant",
    "value",
)

_ROOT: Final = "Core"
"""The alias of the core, not in the table because its class imports this module."""


class CheckpointError(ValueError):
    """A checkpoint that is damaged, or from a version with another state."""


def checkpoint(root: object) -> Tree:
    """Return the whole state of an object as plain values that share nothing with it."""
    return _Taking(root).take_object(root, _OBJECT, _ROOT)


def resume(root: object, state: bytes) -> None:
    """Bring a new object, made with the same arguments, into the state of a checkpoint.

    Raises CheckpointError: it does not fit, and the object is unusable.
    """
    try:
        _Restoring().restore_root(msgspec.msgpack.decode(state), root)
    except CheckpointError:
        raise
    except (TypeError, ValueError, AttributeError, LookupError, OverflowError, RecursionError) as error:
        raise CheckpointError(f"a checkpoint that does not fit: {error!r}"[:300]) from error


class _Taking:
    """One pass over the state. Mutable objects are numbered; a repeated one is stored by its number."""

    def __init__(self, root: object) -> None:
        self._numbers = {id(root): 0}

    def take_object(self, value: Any, tag: str, alias: str) -> Tree:  # noqa: ANN401 - of any kind
        names = type(value).__struct_fields__ if tag == _STRUCT else _names(value)
        renamed = RENAMED.get(alias, {})
        return [tag, alias, {renamed.get(name, name): self.take(getattr(value, name)) for name in names}]

    def take(self, value: Any) -> Tree:  # noqa: ANN401 - of any kind
        kind = type(value)
        tag = _tag(kind)
        if tag == _VALUE:
            return value
        if tag == _ENUM:
            return [_ENUM, _ALIASES[kind], value.value]
        if tag == _CONSTANT:
            return [_CONSTANT]
        if not _is_immutable(kind):
            number = self._numbers.get(id(value))
            if number is not None:
                return [_SEEN, number]
            self._numbers[id(value)] = len(self._numbers)
        if tag in {_OBJECT, _STRUCT}:
            return self.take_object(value, tag, _ALIASES[kind])
        if tag == _RANDOM:
            version, words, gauss = value.getstate()
            return [_RANDOM, version, list(words), gauss]
        if issubclass(kind, dict):
            pairs = [
                [self.take(key), self.take(one)] for key, one in value.items() if _tag(type(key)) != _CONSTANT
            ]
            return [tag, pairs]
        items = list(map(self.take, value))
        if kind in {set, frozenset}:
            items.sort(key=repr)
        return [tag, items, getattr(value, "maxlen", None)]


class _Restoring:
    """The same pass, over a checkpoint and a new object together."""

    def __init__(self) -> None:
        self._seen: list[Any] = []
        self._used: set[int] = set()

    def restore_root(self, state: Tree, root: object) -> None:
        tag, name, stored = state
        if (tag, _alias(name)) != (_OBJECT, _ROOT):
            raise CheckpointError(f"a checkpoint of no {_ROOT}")
        self._object(type(root), _ROOT, stored, root)

    def restore(self, kept: Tree, new: Any) -> Any:  # noqa: ANN401 - of any kind
        """Return the stored value: the new object itself, changed, if it is of that kind."""
        if not isinstance(kept, list):
            return kept
        tag, *contents = kept
        if tag == _CONSTANT:
            return new
        if tag == _SEEN:
            return self._seen[contents[0]]
        if tag == _ENUM:
            return _class(contents[0], Enum)(contents[1])
        if id(new) in self._used:
            # One initial object had become two.
            new = None
        self._used.add(id(new))
        if tag == _OBJECT:
            return self._object(_class(contents[0], object), contents[0], contents[1], new)
        if tag == _STRUCT:
            return self._struct(_class(contents[0], msgspec.Struct), contents[0], contents[1], new)
        if tag == _RANDOM:
            made = Random()  # noqa: S311 - tells runs apart; it keeps no secret
            version, words, gauss = contents
            made.setstate((version, tuple(words), gauss))
            self._seen.append(made)
            return made
        kind = _CONTAINERS[tag]
        return self._dict(kind, contents[0], new) if issubclass(kind, dict) else self._items(kind, contents, new)

    def _object(self, kind: type, name: str, stored: dict[str, Tree], new: object) -> object:
        kept = _as_named_now(name, stored)
        for added in ADDED.get(_alias(name), ()):
            kept.setdefault(added, [_CONSTANT])
        if new is not None and (type(new) is not kind or kept.keys() != set(_names(new))):
            raise CheckpointError(f"{type(new).__name__} holds other things in this version")
        made = object.__new__(kind) if new is None else new
        self._seen.append(made)
        for own, tree in kept.items():
            if own.startswith("__") or callable(getattr(kind, own, None)):
                raise CheckpointError(f"{kind.__name__} keeps nothing in {own!r}")
            setattr(made, own, self.restore(tree, getattr(made, own, None)))
        return made

    def _struct(
        self, kind: type[msgspec.Struct], name: str, stored: dict[str, Tree], new: object
    ) -> msgspec.Struct:
        kept = _as_named_now(name, stored)
        place = len(self._seen)
        if not _is_immutable(kind):
            self._seen.append(None)
        added = set(ADDED.get(_alias(name), ()))
        if kept.keys() | added != set(kind.__struct_fields__):
            raise CheckpointError(f"{kind.__name__} holds other things in this version")
        made = kind(**{own: self.restore(tree, getattr(new, own, None)) for own, tree in kept.items()})
        if not _is_immutable(kind):
            self._seen[place] = made
        return made

    # Containers are always new: a default one may be shared.

    def _dict(self, kind: type[dict[Any, Any]], kept: list[Tree], new: object) -> dict[Any, Any]:
        before = dict(new) if isinstance(new, dict) else {}
        made = kind((key, one) for key, one in before.items() if _tag(type(key)) == _CONSTANT)
        self._seen.append(made)
        for key_tree, tree in kept:
            key = self.restore(key_tree, None)
            made[key] = self.restore(tree, before.get(key))
        return made

    def _items(self, kind: type, contents: list[Any], new: Any) -> Any:  # noqa: ANN401 - of any kind
        kept, maxlen = contents
        before = list(new) if isinstance(new, list | tuple) else []
        before += [None] * (len(kept) - len(before))
        if _is_immutable(kind):
            return kind(map(self.restore, kept, before))
        made: Any = deque(maxlen=maxlen) if kind is deque else kind()
        self._seen.append(made)
        add = made.add if kind is set else made.append
        for tree, former in zip(kept, before, strict=False):
            add(self.restore(tree, former))
        return made


_ALIASES: Final = {kind: alias for alias, kind in CLASSES.items()}

_TAGS: Final[dict[type, str]] = {}


def _tag(kind: type) -> str:
    """The kind of a value in a checkpoint; cached by class."""
    tag = _TAGS.get(kind)
    if tag is None:
        tag = _TAGS[kind] = _tag_of(kind)
    return tag


def _tag_of(kind: type) -> str:
    if kind in _PLAIN:
        return _VALUE
    if kind is Random:
        return _RANDOM
    if kind in _CONTAINERS.values():
        return kind.__name__
    if kind not in _ALIASES:
        return _CONSTANT
    if issubclass(kind, Enum):
        return _ENUM
    return _STRUCT if issubclass(kind, msgspec.Struct) else _OBJECT


def _is_immutable(kind: type) -> bool:
    return kind in {tuple, frozenset} or (issubclass(kind, msgspec.Struct) and kind.__struct_config__.frozen)


def _names(value: object) -> list[str]:
    """The attributes of an object that is no Struct, in order, without the chassis, which is no state."""
    slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
    names = [*getattr(value, "__dict__", ()), *(name for name in slots if hasattr(value, name))]
    return [name for name in names if type(getattr(value, name)) is not Chassis]


def _alias(name: str) -> str:
    """The alias in a checkpoint's name: all of it, or in earlier logs the part after ``module:``."""
    return name.rpartition(":")[2]


def _class(name: str, base: type) -> Any:  # noqa: ANN401 - a class
    """The class of this name in a checkpoint."""
    found = CLASSES.get(_alias(name))
    if found is None or not issubclass(found, base):
        raise CheckpointError(f"no class {name} is known")
    return found


def _as_named_now(name: str, stored: dict[str, Tree]) -> dict[str, Tree]:
    """Attributes of an object in a checkpoint, by their names in the code."""
    own = {old: new for new, old in RENAMED.get(_alias(name), {}).items()}
    return {own.get(one, one): tree for one, tree in stored.items()}

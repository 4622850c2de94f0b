"""The whole state of the core as plain values, and back into a new core. Pure.

A checkpoint names classes and attributes, by the names of ``gateway.checkpoint_classes``, and holds their values:
numbers, texts, bytes, enumerations, containers, and the product's own objects. What a core is made with and never
changes, such as decoders, layouts and functions, is left out: a new core of the same settings has it. Nothing in a
checkpoint is code, and no class outside of that table can be made from it.
"""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from enum import Enum
from random import Random
from typing import Any, Final

import msgspec

from gateway.checkpoint_classes import CLASSES, RENAMED

Tree = Any
"""A plain value, or a list: the kind, and what belongs to it."""

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
"""The alias of the whole, which stands in no table: its class imports this module."""


class CheckpointError(ValueError):
    """A checkpoint that is damaged, or of a version whose core holds other things."""


def checkpoint(root: object) -> Tree:
    """Return the whole state of an object and of all behind it: plain values that share nothing with it."""
    return _Taking(root).take_object(root, _OBJECT, _ROOT)


def resume(root: object, state: bytes) -> None:
    """Bring a new object into the state of a checkpoint.

    Args:
        root: made with the same arguments as the one of which the checkpoint was taken.
        state: the checkpoint, as MessagePack.

    Raises:
        CheckpointError: it does not fit. The object is of no use any more.
    """
    try:
        _Restoring().restore_root(msgspec.msgpack.decode(state), root)
    except CheckpointError:
        raise
    except (TypeError, ValueError, AttributeError, LookupError, OverflowError, RecursionError) as error:
        raise CheckpointError(f"a checkpoint that does not fit: {error!r}"[:300]) from error


class _Taking:
    """One pass over everything. What can change is numbered; where it is met again, its number stands."""

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
    """The same pass over a checkpoint and a new object at once."""

    def __init__(self) -> None:
        self._seen: list[Any] = []
        self._used: set[int] = set()

    def restore_root(self, state: Tree, root: object) -> None:
        tag, name, stored = state
        if (tag, _alias(name)) != (_OBJECT, _ROOT):
            raise CheckpointError(f"a checkpoint of no {_ROOT}")
        self._object(type(root), _ROOT, stored, root)

    def restore(self, kept: Tree, new: Any) -> Any:  # noqa: ANN401 - of any kind
        """Return what the checkpoint holds: the new object itself, changed, where it is of that kind."""
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
            # What was one object at first had become two.
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
        if kept.keys() != set(kind.__struct_fields__):
            raise CheckpointError(f"{kind.__name__} holds other things in this version")
        made = kind(**{own: self.restore(tree, getattr(new, own, None)) for own, tree in kept.items()})
        if not _is_immutable(kind):
            self._seen[place] = made
        return made

    # Containers are made anew: one that a new core begins with may be everybody's.

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
    """The kind of a value, as a checkpoint names it; found once for each class."""
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
    """The attributes of an object that is no Struct, in the order in which they were set."""
    slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
    return [*getattr(value, "__dict__", ()), *(name for name in slots if hasattr(value, name))]


def _alias(name: str) -> str:
    """The alias in a name of a checkpoint: the whole, or in logs of before what follows ``module:``."""
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

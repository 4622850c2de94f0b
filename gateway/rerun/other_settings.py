"""The state of a core as it is under other settings, where they have made no difference until then. Pure.

A core is made with limits and deadlines, and its state holds them. Where the state has what the run's own settings
gave it, it gets what the other settings give; all else stays.
"""

from __future__ import annotations

from typing import Final

import msgspec

from gateway.checkpoint import CheckpointError, Tree, checkpoint
from gateway.core import Core
from schemas.settings import Settings

_OBSERVED: Final = frozenset({"_received", "_streams", "_scaled", "_tracker", "_detector", "_health", "monitor"})
"""Attributes of the core that hold what the chassis said, not what the arbiter made of it."""


class OtherState(msgspec.Struct, frozen=True):
    """A state under other settings.

    Attributes:
        state: as a checkpoint holds it.
        is_certain: what depends on the settings was as they gave it. Else something had changed it, as an
            ``engage`` that asks for a longer deadman: what it would be then is not known.
    """

    state: Tree
    is_certain: bool


class OtherSettings:
    """States of a run, as they are under other settings.

    Args:
        settings: those of the run.
        other: those to try.
        run: the run's number.
    """

    def __init__(self, settings: Settings, other: Settings, run: int) -> None:
        self._own, self._other = (checkpoint(Core(one, "", 0, run)) for one in (settings, other))

    def translated(self, state: Tree) -> OtherState:
        """Return a state of the run as it is under the other settings.

        Raises:
            CheckpointError: the settings decide what a state consists of.
        """
        changed: list[Tree] = []
        made = _translated(state, self._own, self._other, changed)
        return OtherState(made, not changed)


def _translated(kept: Tree, own: Tree, other: Tree, changed: list[Tree]) -> Tree:
    if own == other:
        return kept
    trees = (kept, own, other)
    if all(isinstance(one, dict) for one in trees) and kept.keys() == own.keys() == other.keys():
        return {name: _translated(tree, own[name], other[name], changed) for name, tree in kept.items()}
    if all(isinstance(one, list) for one in trees) and len(kept) == len(own) == len(other):
        return [_translated(*parts, changed) for parts in zip(*trees, strict=True)]
    if any(isinstance(one, list | dict) for one in trees):
        raise CheckpointError("the settings tried give the arbiter other parts")
    if kept == own:
        return other
    changed.append(kept)
    return kept


def without_observed(state: Tree) -> Tree:
    """Return a state without what the chassis said: with what the arbiter knows and does."""
    if isinstance(state, list):
        return [without_observed(one) for one in state]
    if isinstance(state, dict):
        return {name: without_observed(tree) for name, tree in state.items() if name not in _OBSERVED}
    return state

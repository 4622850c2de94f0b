"""Keys that a Zenoh session is told of, because their samples come often."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

KEYS_MAX: Final = 20_000
"""Those of a thousand robots: 40 MB here and 32 MB in the router, and 10 s and 4 s of processor time if all come
at once; 4,000 keys take 1.0 s and 0.5 s (Zenoh 1.10)."""


class DeclaredKeys:
    """Declares a publisher of each key that comes, once, and never puts with it.

    Of a declared key a session remembers who is to get its samples; of others it looks for all that match, with
    each sample anew. That would be two thirds of the desk's processor time with 200 robots, and a quarter of a
    recorder's with ten. A publisher makes the key known to the router, too: where the robots are connected to
    another router, it knows their prefixes alone, and would look through all of them with each sample.

    Args:
        declare: the session's ``declare_publisher``. It forgets a key together with what it returned.
        limit: keys that are declared; those that come later only take longer.
    """

    def __init__(self, declare: Callable[[str], object], limit: int = KEYS_MAX) -> None:
        self._declare = declare
        self._limit = limit
        self._declared: dict[str, object] = {}

    def meet(self, key: str) -> None:
        """See a sample of this key."""
        if key not in self._declared and len(self._declared) < self._limit:
            self._declared[key] = self._declare(key)

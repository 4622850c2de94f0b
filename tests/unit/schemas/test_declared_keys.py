"""Keys that a session is told of."""

from schemas.keys import DeclaredKeys


def test_each_key_is_declared_once_and_only_so_many_are() -> None:
    """What the session returns is kept: it forgets a key together with that."""
    asked, alive = [], set()

    class Declared:
        def __init__(self, key: str) -> None:
            asked.append(key)
            alive.add(key)
            self.key = key

        def __del__(self) -> None:
            alive.discard(self.key)

    keys = DeclaredKeys(Declared, 3)
    for key in "abacadaeab":
        keys.meet(key)
    assert asked == ["a", "b", "c"]
    assert alive == {"a", "b", "c"}

"""Keys, and the names in them."""

import re
from fnmatch import fnmatchcase

import pytest
import zenoh
from hypothesis import example, given
from hypothesis import strategies as st

from schemas import keys
from schemas.keys import OPERATOR_PATTERN, DeclaredKeys, fitting, login_operator
from schemas.subjects import BY_NAME, BY_VERB, COMMAND_CHUNK, SUBJECTS, Subject

ROOTS = st.from_regex(keys.ROOT_PATTERN, fullmatch=True)
ROBOTS = st.from_regex(keys.ROBOT_PATTERN, fullmatch=True)
BUSES = st.from_regex(keys.BUS_PATTERN, fullmatch=True)
OPERATORS = st.from_regex(keys.OPERATOR_PATTERN, fullmatch=True)
VERBS = st.sampled_from(list(BY_VERB))


@given(root=ROOTS, robot=ROBOTS, subject=st.sampled_from(SUBJECTS), bus=BUSES)
@example(root="fleet/chassis", robot="gear", subject=BY_NAME["chassis/gear"], bus="can0")
@example(root="fleet", robot="cruiser-1", subject=BY_NAME["safety/state"], bus="can0")
@example(root="can/rx", robot="state", subject=BY_NAME["can/{bus}/rx"], bus="state")
def test_parsing_undoes_building(root: str, robot: str, subject: Subject, bus: str) -> None:
    own_bus = bus if "{bus}" in subject.name else ""
    key = keys.build(root, robot, subject, own_bus)
    assert keys.parse(key) == keys.KeyParts(root, robot, subject, own_bus)


def test_a_key_that_is_very_long_is_none_of_ours() -> None:
    """Parsing it would take a time that grows with the square of its length."""
    rest = "/cruiser-1/chassis/gear"
    root = "r" * (keys.KEY_MAX_LENGTH - len(rest))
    assert keys.parse(root + rest) is not None
    assert keys.parse("r" + root + rest) is None


@pytest.mark.parametrize(
    ("root", "robot", "name", "bus"),
    [
        ("", "cruiser-1", "state", ""),
        ("/fleet", "cruiser-1", "state", ""),
        ("fleet/*", "cruiser-1", "state", ""),
        ("fleet", "Cruiser", "state", ""),
        ("fleet", "a/b", "state", ""),
        ("fleet", "cruiser-1\n", "state", ""),
        ("fleet", "cruiser-1", "state", "can0"),
        ("fleet", "cruiser-1", "can/{bus}/rx", ""),
        ("fleet", "cruiser-1", "can/{bus}/rx", "can/0"),
    ],
)
def test_a_part_that_does_not_fit_is_not_built_into_a_key(root: str, robot: str, name: str, bus: str) -> None:
    with pytest.raises(ValueError, match=r"form|fit"):
        keys.build(root, robot, BY_NAME[name], bus)


@given(root=ROOTS, robot=ROBOTS, operator=OPERATORS, verb=VERBS)
def test_a_command_key_names_its_operator_and_verb(root: str, robot: str, operator: str, verb: str) -> None:
    for addressed in (robot, keys.ALL):
        key = keys.command(root, addressed, operator, verb)
        assert key == f"{root}/{addressed}/{COMMAND_CHUNK}/{operator}/{verb}"
        assert keys.parse_command(key) == (operator, verb)
        assert keys.parse(key) is None


@pytest.mark.parametrize(
    ("root", "robot", "operator"),
    [
        ("*", "cruiser-1", "first"),
        ("fleet/**", "cruiser-1", "first"),
        ("fleet", "**", "first"),
        ("fleet", "Cruiser", "first"),
        ("fleet", "cruiser-1", "first/second"),
        ("fleet", "cruiser-1", "first "),
        ("fleet", "cruiser-1", ""),
    ],
)
def test_a_part_that_does_not_fit_is_not_built_into_a_command_key(root: str, robot: str, operator: str) -> None:
    with pytest.raises(ValueError, match="form"):
        keys.command(root, robot, operator, "stop")


@given(pattern=st.from_regex(keys.ROBOTS_PATTERN, fullmatch=True), robot=ROBOTS)
@example(pattern="cruiser-*", robot="cruiser-10")
@example(pattern="**", robot="a")
@example(pattern="a**b*", robot="ab")
def test_zenoh_finds_the_robots_of_a_pattern(pattern: str, robot: str) -> None:
    expression = f"fleet/{keys.chunk_of(pattern)}/state"
    assert str(zenoh.KeyExpr.autocanonize(expression)) == expression
    found = zenoh.KeyExpr(expression).intersects(zenoh.KeyExpr(f"fleet/{robot}/state"))
    assert found == fnmatchcase(robot, pattern)


@given(st.sets(st.integers(0, 2000)))
def test_names_are_in_the_order_of_their_numbers(numbers: set[int]) -> None:
    names = [f"plant-3-cruiser-{number}" for number in sorted(numbers)]
    assert sorted(sorted(names), key=keys.in_order) == names


@given(login=st.text())
def test_any_login_name_becomes_a_chunk_of_a_key(login: str) -> None:
    assert re.fullmatch(OPERATOR_PATTERN, fitting(login))


def test_nobody_is_an_operator_too(monkeypatch: pytest.MonkeyPatch) -> None:

    def nobody() -> str:
        raise KeyError

    monkeypatch.setattr("getpass.getuser", nobody)
    assert login_operator() == "operator"


# Declared keys.


def test_each_key_is_declared_once_and_only_so_many_are() -> None:
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

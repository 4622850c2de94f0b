"""What people pass to each other through the desk, and when it is over."""

import pytest

from gateway.desk.people import REQUEST_NS, REQUESTS_MAX, People


def test_whoever_asks_is_named_until_somebody_answers() -> None:
    """In the order in which they asked; once more is no second request."""
    people = People()
    for asker in ("bob", "cat", "bob"):
        people.ask("cruiser-1", asker, 0)
    assert people.requests("cruiser-1", "ann", 1) == ["bob", "cat"]
    assert people.answer("cruiser-1", "bob")
    assert not people.answer("cruiser-1", "bob")
    assert people.requests("cruiser-1", "ann", 1) == ["cat"]
    assert people.requests("cruiser-2", "ann", 1) == []


def test_a_request_ends_by_itself() -> None:
    """After a minute; where nobody holds the lease any more; and for who holds it."""
    people = People()
    people.ask("cruiser-1", "bob", 0)
    people.ask("cruiser-1", "cat", 1)
    assert people.requests("cruiser-1", "bob", 1) == ["cat"]
    assert people.requests("cruiser-1", "ann", REQUEST_NS) == ["cat"]
    assert people.requests("cruiser-1", "", REQUEST_NS) == []
    assert people.requests("cruiser-1", "ann", REQUEST_NS) == []


def test_an_acknowledgement_holds_for_what_was_acknowledged() -> None:
    """Another alarm of the same robot is nobody's again, also the first one when it comes back."""
    people = People()
    people.acknowledge("cruiser-1", "latched", "ann")
    assert people.acknowledged("cruiser-1", "latched") == "ann"
    assert people.acknowledged("cruiser-1", "silent") == ""
    assert people.acknowledged("cruiser-1", "latched") == ""


def test_a_robot_that_has_gone_takes_all_of_it_along() -> None:
    """One that comes later under the same name is asked for anew."""
    people = People()
    people.ask("cruiser-1", "bob", 0)
    people.acknowledge("cruiser-1", "latched", "ann")
    people.forget("cruiser-1")
    assert people.requests("cruiser-1", "ann", 1) == []
    assert people.acknowledged("cruiser-1", "latched") == ""


def test_no_more_is_kept_than_people_need() -> None:
    """Whoever makes names up is refused, and takes away nothing that is there."""
    people = People()
    for number in range(REQUESTS_MAX):
        people.ask("cruiser-1", f"one-{number}", 0)
    people.ask("cruiser-1", "one-0", 1)
    with pytest.raises(ValueError, match="too many"):
        people.ask("cruiser-1", "one-more", 0)
    assert people.requests("cruiser-1", "ann", 1) == [f"one-{number}" for number in range(REQUESTS_MAX)]

"""``cruiser demo-fleet``: what it makes of facts."""

from gateway.cli.demo_fleet import code_of, describe
from gateway.cli.fleet_machines import Done
from gateway.cli.fleet_story import JudgedFact
from schemas.exit_codes import ExitCode

SEEN = JudgedFact("the viewer lists robots", "cruiser-1, cruiser-2 connected", holds=True)
WRONG = JudgedFact("an intruder without a certificate", "exit code 0: cruiser-1 connected", holds=False)


def test_one_fact_that_is_not_as_it_should_be_is_a_failure() -> None:
    """It stands out in the summary, and is counted."""
    assert code_of([SEEN, SEEN]) is ExitCode.OK
    assert code_of([SEEN, WRONG, SEEN]) is ExitCode.FAILURE
    told = describe([SEEN, WRONG])
    assert "NOT AS IT SHOULD BE  an intruder without a certificate: exit code 0" in told
    assert told.endswith("1 of 2 NOT AS THEY SHOULD BE")
    assert describe([SEEN]).endswith("all of it as it should be")


def test_a_demo_that_saw_nothing_is_a_failure() -> None:
    """An end before the first fact is no success."""
    assert code_of([]) is ExitCode.FAILURE


def test_a_command_is_told_by_its_last_words() -> None:
    """Its own name is not among them."""
    assert Done(4, "warning\ncruiser list: no Zenoh node answered\n").last == "no Zenoh node answered"
    assert Done(0, "cruiser-1: stops\n").last == "cruiser-1: stops"
    assert Done(0, "").last == ""

import argparse
import re
from importlib import import_module

import pytest

from gateway.cli.main import COMMANDS
from schemas.reasons import NO_STOP, OF_A_ROBOT, TEXTS, Reason, of_a_robot
from schemas.subjects import COMMANDS as COMMANDS_TABLE


@pytest.mark.parametrize("reason", Reason)
def test_a_reason_says_what_it_means_and_what_would_cure_it(reason: Reason) -> None:
    text = TEXTS[reason]
    assert text.means
    assert bool(text.cure) == (reason is not Reason.NONE)


@pytest.mark.parametrize("reason", Reason)
def test_a_text_goes_on_with_figures(reason: Reason) -> None:
    for text in (TEXTS[reason].means, TEXTS[reason].cure):
        assert text == text.strip()
        assert text.isprintable()
        assert not text.endswith(".")
        assert text[:1].islower() or not text


CURES = {text.cure for text in (*TEXTS.values(), *OF_A_ROBOT.values())}
VERBS = {command.verb for command in COMMANDS_TABLE} - {"stop", "drive", "light", "horn"}
"""What a person cannot do without a command or a program; those that are left out are words of their own."""


@pytest.mark.parametrize("cure", sorted(CURES))
def test_what_a_cure_quotes_is_a_command_line(cure: str) -> None:
    assert "cruiser " not in re.sub(r"'cruiser [^']*'", "", cure)
    for line in re.findall(r"'cruiser ([^']*)'", cure):
        name, *words = line.replace("ROBOT", "cruiser-1").replace(" N", " 7").split()
        parser = argparse.ArgumentParser(exit_on_error=False)
        module, _, command = COMMANDS[name][0].partition(":")
        found = import_module(module)
        (getattr(found, command) if command else found).add_arguments(parser)
        if words:
            parser.parse_args(words)


@pytest.mark.parametrize("cure", sorted(CURES))
def test_a_cure_names_no_verb_without_saying_how(cure: str) -> None:
    assert not VERBS & set(re.findall(r"\w+", cure)) or "'cruiser " in cure


@pytest.mark.parametrize("beside", sorted(NO_STOP, key=str))
def test_a_stop_that_would_be_refused_is_no_cure(beside: Reason) -> None:
    assert "cruiser stop" in of_a_robot(Reason.MOVING, [Reason.MOVING, Reason.NO_LEASE]).cure
    assert of_a_robot(Reason.MOVING, [beside, Reason.MOVING]).cure.startswith("wait until it stands")

"""``cruiser``: its commands."""

from gateway.cli.main import COMMANDS


def test_what_a_command_does_has_no_full_stop_of_its_own() -> None:
    """The help of a command makes a sentence of it."""
    assert [name for name, (_, about) in COMMANDS.items() if not about[-1].isalnum()] == []

"""HOST:PORT."""

import pytest

from gateway.sim.disturbances import parse_address, show_address
from schemas.command_line import CommandError, ExitCode


@pytest.mark.parametrize(
    ("text", "address"),
    [("127.0.0.1:29536", ("127.0.0.1", 29536)), ("localhost:0", ("localhost", 0)), ("[::1]:7", ("::1", 7))],
)
def test_an_address_reads_and_shows_the_same(text: str, address: tuple[str, int]) -> None:
    """Brackets belong to the text of an IPv6 address, not to the address."""
    assert parse_address(text) == address
    assert show_address(*address) == text


@pytest.mark.parametrize("text", ["", "localhost", ":1", "host:", "host:x", "host:65536", "::1:7", "a b:1"])
def test_what_is_no_address_is_a_usage_error(text: str) -> None:
    """One clear line, and the exit code for wrong words."""
    with pytest.raises(CommandError, match="HOST:PORT") as error:
        parse_address(text)
    assert error.value.code is ExitCode.USAGE

import os

from gateway.can.open_bus import BusClaim, count_claims
from schemas.settings import CanSettings


def test_gateways_of_one_bus_are_counted_while_they_run() -> None:
    """The first is told of nobody, those after it are; each goes with its process, and no other bus counts."""
    bus = CanSettings(channel=f"test{os.getpid()}")
    assert count_claims(bus) == 0
    with BusClaim(bus) as first:
        assert not first.is_shared
        with BusClaim(bus) as second, BusClaim(bus) as third:
            assert second.is_shared
            assert third.is_shared
            assert count_claims(bus) == 3
        assert count_claims(bus) == 1
        assert count_claims(CanSettings(channel="another")) == 0
    assert count_claims(bus) == 0

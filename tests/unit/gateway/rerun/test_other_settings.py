"""A state of a core under other settings."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.checkpoint import CheckpointError, checkpoint
from gateway.core import Core
from gateway.rerun.other_settings import OtherSettings
from schemas.settings import CommandSettings, GatewaySettings, Settings
from tests.support.rigs.recorded import RecordedRig


def with_command(**command: float) -> Settings:
    """Settings with other values of the command flow."""
    return Settings(command=msgspec.structs.replace(CommandSettings(), **command))


@given(st.floats(0.1, 2.2), st.floats(0.2, 0.4), st.floats(0.1, 1.0))
def test_a_new_cores_state_becomes_that_of_a_core_made_with_them(
    speed_mps: float, deadman_s: float, delay_m: float
) -> None:
    """Every value that the settings give is found."""
    own, other = (
        Settings(),
        with_command(
            speed_limit_mps=speed_mps, deadman_s=deadman_s, travel_delay_m=delay_m, steering_limit_deg=10.0
        ),
    )
    translated = OtherSettings(own, other, 7).translated(checkpoint(Core(own, "", 0, 7)))
    assert translated.state == checkpoint(Core(other, "", 0, 7))
    assert translated.is_certain


def test_a_driven_robots_state_keeps_all_else() -> None:
    """And comes back, whatever was set meanwhile."""
    rig, _ = RecordedRig.driving(0.6)
    own, other = rig.settings, with_command(speed_limit_mps=1.0)
    state = checkpoint(rig.core)
    translated = OtherSettings(own, other, 7).translated(state)
    assert translated.is_certain
    assert translated.state != state
    assert OtherSettings(other, own, 7).translated(translated.state).state == state


def test_what_somebody_had_asked_for_is_not_certain() -> None:
    """A longer deadman than the configured one stays, and is told."""
    rig = RecordedRig()
    rig.run(0.6)
    assert rig.core.command is not None
    rig.core.command.arbiter.link.age.begin(0.9)
    translated = OtherSettings(rig.settings, with_command(deadman_s=0.2), 7).translated(checkpoint(rig.core))
    assert not translated.is_certain


def test_settings_that_leave_the_arbiter_out_suit_no_state() -> None:
    """That is said, not guessed."""
    own = Settings()
    other = Settings(gateway=GatewaySettings(listen_only=True))
    with pytest.raises(CheckpointError, match="other parts"):
        OtherSettings(own, other, 7).translated(checkpoint(Core(own, "", 0, 7)))

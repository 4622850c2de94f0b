import pytest

from recorder.zenoh.remote_control import RecorderClient
from schemas.command_line import CommandError, ExitCode
from schemas.settings import ZenohSettings


def test_a_wrong_endpoint_is_a_usage_error() -> None:
    """In one line."""
    with pytest.raises(CommandError, match="Zenoh does not take connect/endpoints") as caught:
        RecorderClient(ZenohSettings(connect=["nonsense"]), "fleet", "operator-1")
    assert caught.value.code == ExitCode.USAGE

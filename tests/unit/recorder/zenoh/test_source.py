import pytest

from recorder.zenoh.source import ZenohSource
from schemas.command_line import CommandError, ExitCode
from schemas.settings import ZenohSettings


def source(endpoint: str, *expressions: str) -> ZenohSource:
    return ZenohSource(ZenohSettings(connect=[endpoint]), expressions or ["fleet/**"], 1000)


@pytest.mark.parametrize("expression", ["fleet//x", "", "/fleet", "fleet/$x*"])
def test_a_wrong_key_expression_is_a_usage_error(expression: str) -> None:
    """It is named, in one line, without Zenoh's insides."""
    with pytest.raises(CommandError, match="is no key expression") as caught:
        source("tcp/127.0.0.1:1", expression)
    assert caught.value.code == ExitCode.USAGE
    assert ".rs" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_wrong_endpoint_is_a_usage_error() -> None:
    """In one line."""
    with pytest.raises(CommandError, match="Zenoh does not take connect/endpoints") as caught:
        source("nonsense")
    assert caught.value.code == ExitCode.USAGE
    assert "\n" not in str(caught.value)

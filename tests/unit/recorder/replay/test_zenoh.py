import pytest

from recorder.replay.zenoh import key_checked
from schemas.exit_codes import CommandError, ExitCode


def test_a_key_expression_is_checked_before_anything_is_sent() -> None:
    """And brought into Zenoh's form."""
    assert key_checked("fleet/**/**") == "fleet/**"
    with pytest.raises(CommandError, match="no key expression") as caught:
        key_checked("fleet//x")
    assert caught.value.code is ExitCode.USAGE

"""``cruiser list``: whose settings it is given."""

from pathlib import Path

import pytest

from gateway.authority.enrolment import TransportRole
from gateway.cli.list_robots import check_role
from schemas.command_line import CommandError, ExitCode
from tests.support.secured import Network


@pytest.mark.parametrize("role", [TransportRole.ROBOT, TransportRole.ROUTER, TransportRole.VIEWER])
def test_settings_with_which_no_robot_is_seen_are_named_with_what_to_use(
    tmp_path: Path, role: TransportRole
) -> None:
    """That none is connected would be wrong. A file without certificates says nothing of its user."""
    config = Network(tmp_path, "tls/127.0.0.1:47447").node(role, "somebody") / f"{role.value}.json5"
    if role is TransportRole.VIEWER:
        check_role(str(config))
        return
    with pytest.raises(CommandError, match=rf"settings of a {role.value} .*operator\.toml") as caught:
        check_role(str(config))
    assert caught.value.code is ExitCode.USAGE
    config.write_text("{mode: 'client'}")
    check_role(str(config))

"""``cruiser list``: whose settings it is given."""

from pathlib import Path

import pytest

from gateway.authority.enrolment import TransportRole
from gateway.cli.list_robots import check_role
from schemas.command_line import CommandError, ExitCode
from tests.support.secured import Network


@pytest.mark.parametrize("role", [role for role in TransportRole if role is not TransportRole.NOTHING])
def test_settings_with_which_no_robot_is_seen_are_named_with_what_to_use(
    tmp_path: Path, role: TransportRole
) -> None:
    """A robot's certificate sees no other robot, nor itself: that none is connected would be wrong."""
    config = str(Network(tmp_path, "tls/127.0.0.1:47447").node(role, "somebody") / f"{role.value}.json5")
    if role not in {TransportRole.ROBOT, TransportRole.ROUTER}:
        check_role(config)
        return
    with pytest.raises(CommandError, match=rf"settings of a {role.value} .*operator\.toml") as caught:
        check_role(config)
    assert caught.value.code is ExitCode.USAGE


def test_a_file_without_certificates_says_nothing_of_its_user(tmp_path: Path) -> None:
    """Whatever its name is; nor does one that is not there."""
    file = tmp_path / "robot.json5"
    check_role(str(file))
    file.write_text("{mode: 'client'}")
    check_role(str(file))

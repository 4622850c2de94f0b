"""``cruiser halt``: its flags."""

import argparse
from pathlib import Path

from gateway.cli import gateway, halt
from gateway.cli.configuration_file import load_settings
from gateway.host.stop_note import StopNote


def test_a_halt_leaves_its_note_where_a_gateway_of_the_same_flags_reads_it(tmp_path: Path) -> None:
    """A gateway that is called by ``--robot`` starts latched after a halt that is called so too."""
    environment = {"CRUISER_GATEWAY_STATE_DIR": str(tmp_path)}
    paths = []
    for command in (gateway, halt):
        parser = argparse.ArgumentParser()
        command.add_arguments(parser)
        flags = vars(parser.parse_args(["--robot", "cruiser-7"]))
        given = {key: value for key, value in flags.items() if "." in key and value is not None}
        paths.append(StopNote.of(load_settings(None, environment, given), environment).path)
    assert paths[0] == paths[1] == tmp_path / "fleet.cruiser-7.guard-stop"

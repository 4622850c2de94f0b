"""Write rerun's blueprint, and look up each field that it draws in a log as rerun reads it.

Usage: PYTHON-WITH-RERUN tests/readers/with_blueprint.py PROJECT PACKAGES LOG BLUEPRINT
"""

import json
import sys
from pathlib import Path
from typing import Any


def main(log: str, blueprint: str) -> None:
    """Write the blueprint, and print for each line of each chart whether rerun finds it."""
    from rerun.chunk import McapReader  # noqa: PLC0415 - the paths are set below

    from recorder.layouts import rerun_blueprint  # noqa: PLC0415
    from recorder.layouts.attached import RobotKeys  # noqa: PLC0415

    robot = RobotKeys("fleet/cruiser-1", "can0")
    rerun_blueprint.save_blueprint(robot, "cruiser-1", Path(blueprint))
    structs: dict[tuple[str, str], Any] = {}
    for chunk in McapReader(log, decoders=["protobuf"]).stream():
        for field in chunk.to_record_batch().schema:
            if field.name.endswith(":message"):
                structs[chunk.entity_path, field.name] = field.type.value_type
    for line in (line for lines in rerun_blueprint.chart_lines(robot).values() for line in lines):
        mapping = rerun_blueprint.mapping_of(line, "")
        kind = structs.get((f"/{line.topic}", mapping.source_component))
        for name in str(mapping.selector).split(".")[1:]:
            index = kind.get_field_index(name) if kind is not None else -1
            kind = kind.field(index).type if kind is not None and index >= 0 else None
        print(json.dumps([line.topic, line.field, None if kind is None else str(kind)]))


if __name__ == "__main__":
    sys.path += sys.argv[1:3]
    main(*sys.argv[3:])

"""Made-up rows of a catalog."""

from typing import Any

import msgspec

from recorder.review.catalog.log_row import CatalogRow, LoggedDrive, LoggedMoment, LoggedRobot
from tests.support.messages import SECOND, WALL_NS

ROW = CatalogRow(
    file="a.mcap",
    bytes=1000,
    modified_ns=WALL_NS,
    messages=10,
    start_ns=WALL_NS,
    end_ns=WALL_NS + 60 * SECOND,
    is_whole=True,
    robots=[LoggedRobot("fleet", "cruiser-1")],
    names=["cruiser-1"],
)
"""A log of a minute in which nothing happened."""

STOP = LoggedMoment(
    time_ns=WALL_NS,
    last_ns=WALL_NS,
    robot="cruiser-1",
    kind="stop",
    severity="warning",
    reason="front_bumper",
    operator="",
    holder="alice",
    count=1,
    is_stop=True,
    text="stopping: the front bumper was hit",
)

DRIVE = LoggedDrive(
    start_ns=WALL_NS,
    end_ns=WALL_NS + 10 * SECOND,
    robot="cruiser-1",
    distance_m=12.5,
    missing_s=0.0,
    stops=1,
    ends=0,
    severity="warning",
    text="stopping: the front bumper was hit",
)


def row(**changes: Any) -> CatalogRow:  # noqa: ANN401 - any field of a row
    return msgspec.structs.replace(ROW, **changes)

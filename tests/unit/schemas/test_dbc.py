"""The DBC files: right for cantools, and plain enough for SavvyCAN, which reads them line by line."""

import re
from importlib import resources

import cantools
import pytest
from cantools.database.can import Database

FILES = ("cruiser-coarse.dbc", "cruiser-fine.dbc")
UNITS = {None, "", "m/s", "deg", "km", "%", "count"}
STATEMENTS = r"VERSION|NS_|BS_|BU_|BO_| SG_|CM_|BA_DEF_|BA_DEF_DEF_|BA_|VAL_"


def text_of(file: str) -> str:
    return resources.files("schemas").joinpath(file).read_text(encoding="ascii")


def load(file: str) -> Database:
    database = cantools.database.load_string(text_of(file), database_format="dbc", strict=True)
    assert isinstance(database, Database)
    return database


@pytest.mark.parametrize("file", FILES)
def test_every_signal_line_is_of_the_one_form_that_all_readers_know(file: str) -> None:
    text = text_of(file)
    nodes = re.findall(r"^BU_: (.*)$", text, re.MULTILINE)[0].split()
    number = r"-?\d+(\.\d+)?"
    form = re.compile(
        rf' SG_ [A-Za-z]\w{{0,31}} : \d+\|\d+@1[+-] \({number},{number}\) \[{number}\|{number}\] "[^"]*" (\w+)'
    )
    lines = [line for line in text.splitlines() if line.lstrip().startswith("SG_")]
    assert lines
    for line in lines:
        match = form.fullmatch(line)
        assert match, line
        assert match[match.lastindex or 0] in nodes, line


def test_the_variants_differ_in_scales_alone() -> None:
    coarse, fine = (
        {
            (frame.name, signal.name): (
                frame.frame_id,
                frame.cycle_time,
                signal.unit,
                signal.choices,
                signal.scale,
            )
            for frame in load(file).messages
            for signal in frame.signals
        }
        for file in FILES
    )
    assert coarse.keys() == fine.keys()
    assert {key for key in coarse if coarse[key] != fine[key]} == {
        ("Auto_DriveCmd", "TargetVelocity"),
        ("Auto_DriveFeedBack", "Speed"),
        ("Auto_WheelSpdFeedback", "RearLeftSpeed"),
        ("Auto_WheelSpdFeedback", "RearRightSpeed"),
    }

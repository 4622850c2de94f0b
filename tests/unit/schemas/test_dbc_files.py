"""The DBC files as text: cantools, which reads them whole, is the judge."""

import cantools
import pytest
from cantools.database.can import Database

from schemas.can_word import EXTENDED
from schemas.dbc_files import DBC_FILES, DbcFrame, dbc_text, frames, signal_comments
from schemas.messages import Variant

VARIANTS = pytest.mark.parametrize("variant", DBC_FILES)

OTHER = """\
BU_: Other Chassis
BO_ 512 Battery: 8 Chassis
 SG_ Voltage : 0|16@1+ (1,0) [0|65535] "" Other
BO_ 2147483649 Wake: 1 Other
CM_ SG_ 512 Voltage "Says "so".";
BA_ "GenMsgCycleTime" BO_ 512 1000;
"""


def read(variant: Variant) -> Database:
    """A variant's DBC as cantools reads it."""
    database = cantools.database.load_string(dbc_text(variant), database_format="dbc")
    assert isinstance(database, Database)
    return database


def test_every_known_variant_has_a_file() -> None:
    """A variant that is not known has none."""
    assert set(DBC_FILES) == set(Variant) - {Variant.UNKNOWN}


@VARIANTS
def test_the_frames_are_those_that_cantools_finds(variant: Variant) -> None:
    """Identifier, name, sender and cycle time of every one, in the order of the file."""
    assert frames(dbc_text(variant)) == [
        DbcFrame(one.frame_id | EXTENDED, one.name, one.senders[0], (one.cycle_time or 0) * 1_000_000)
        for one in read(variant).messages
    ]


@VARIANTS
def test_the_comments_are_those_that_cantools_finds(variant: Variant) -> None:
    """Of every signal, letter for letter."""
    assert signal_comments(dbc_text(variant)) == {
        (message.name, signal.name): signal.comment
        for message in read(variant).messages
        for signal in message.signals
    }


def test_feedback_is_what_the_chassis_sends() -> None:
    """Whatever its identifier is; a frame without a cycle time has the period 0."""
    battery, wake = frames(OTHER)
    assert (battery.can_id, battery.period_ns, battery.is_feedback) == (0x200, 1_000_000_000, True)
    assert (wake.can_id, wake.period_ns, wake.is_feedback) == (EXTENDED | 1, 0, False)
    assert signal_comments(OTHER) == {("Battery", "Voltage"): 'Says "so".'}

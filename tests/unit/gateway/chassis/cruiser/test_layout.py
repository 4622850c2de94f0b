"""The layouts as the product reads them, against the DBC files that they are made of."""

from collections.abc import Iterator

import cantools
import pytest
from cantools.database.can import Database

from gateway.chassis.cruiser import frames as layout_module
from gateway.chassis.cruiser.frames import load
from gateway.chassis.cruiser.layout_file import FILE, layouts_text, read_layout
from schemas.cruiser import DBC_FILES, dbc_text
from schemas.messages import Variant


@pytest.fixture
def _read_anew() -> Iterator[None]:
    load.cache_clear()
    yield
    load.cache_clear()


def test_the_file_is_current() -> None:
    """``make generate`` writes it."""
    assert FILE.read_text("utf-8") == layouts_text()


@pytest.mark.parametrize("variant", DBC_FILES)
def test_a_layout_is_what_cantools_reads_from_the_dbc(variant: Variant) -> None:
    """To the letter, though it went through a file."""
    assert load(variant) == read_layout(variant, dbc_text(variant))


@pytest.mark.usefixtures("_read_anew")
def test_a_layout_of_another_dbc_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody changed a scale in the DBC beside it: the gateway does not start with the former one."""
    changed = dbc_text(Variant.FINE).replace("(0.001,0)", "(0.002,0)")
    assert changed != dbc_text(Variant.FINE)
    monkeypatch.setattr(layout_module, "dbc_text", lambda _: changed)
    with pytest.raises(ValueError, match=r"was not made of this cruiser-fine\.dbc; 'make generate' makes it anew"):
        load(Variant.FINE)


def test_every_known_variant_has_a_file() -> None:
    """A variant that is not known has none."""
    assert set(DBC_FILES) == set(Variant) - {Variant.UNKNOWN}


@pytest.mark.parametrize("variant", DBC_FILES)
def test_a_signal_has_the_value_that_cantools_decodes(variant: Variant) -> None:
    """Of every signal of every frame, with all patterns of one byte around it."""
    database = cantools.database.load_string(dbc_text(variant), "dbc")
    assert isinstance(database, Database)
    for message in load(variant).messages.values():
        known = database.get_message_by_name(message.name)
        for byte in range(256):
            data = bytes([byte, 255 - byte] * 4)
            decoded = known.decode(data, decode_choices=False)
            assert {signal.name: signal.value(data) for signal in message.signals} == decoded

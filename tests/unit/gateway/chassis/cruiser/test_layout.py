"""The layouts as the product reads them, against the DBC files that they are made of."""

from collections.abc import Iterator

import pytest

from gateway.chassis.cruiser import layout as layout_module
from gateway.chassis.cruiser.layout import load
from gateway.chassis.cruiser.layout_file import FILE, layouts_text
from gateway.chassis.dbc import read_layout
from schemas.dbc_files import CHASSIS_NODE, DBC_FILES, dbc_text
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
    assert load(variant) == read_layout(variant, dbc_text(variant), CHASSIS_NODE)


@pytest.mark.usefixtures("_read_anew")
def test_a_layout_of_another_dbc_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    """Somebody changed a scale in the DBC beside it: the gateway does not start with the former one."""
    changed = dbc_text(Variant.FINE).replace("(0.001,0)", "(0.002,0)")
    assert changed != dbc_text(Variant.FINE)
    monkeypatch.setattr(layout_module, "dbc_text", lambda _: changed)
    with pytest.raises(ValueError, match=r"was not made of this cruiser-fine\.dbc; 'make generate' makes it anew"):
        load(Variant.FINE)

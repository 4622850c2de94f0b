import pytest

from schemas.configuration import CONFIG_VARIABLE, SETTINGS, Setting
from schemas.settings import DEFAULT_ENDPOINT


@pytest.mark.parametrize("setting", SETTINGS.values(), ids=SETTINGS)
def test_every_setting_is_described(setting: Setting) -> None:
    """Each setting says what it is, and its start value is one of its right values."""
    assert setting.about
    assert setting.wants
    if setting.choices:
        assert setting.start in setting.choices


def test_each_setting_has_a_variable_of_its_own() -> None:
    """No two settings share a variable, and none takes the one that names the file."""
    variables = [setting.variable for setting in SETTINGS.values()]
    assert len(set(variables)) == len(variables)
    assert CONFIG_VARIABLE not in variables


def test_the_default_endpoint_is_named_where_nothing_is_given() -> None:
    """A docstring cannot hold a constant: its text names the endpoint itself."""
    for name in ("connect", "listen"):
        assert DEFAULT_ENDPOINT in SETTINGS[f"zenoh.{name}"].about

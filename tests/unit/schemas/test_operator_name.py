import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.keys import OPERATOR_PATTERN, fitting, login_operator


@given(login=st.text())
def test_any_login_name_becomes_a_chunk_of_a_key(login: str) -> None:
    """Whatever a login name holds, the operator's name is of its form."""
    assert re.fullmatch(OPERATOR_PATTERN, fitting(login))


def test_a_login_name_that_fits_stays() -> None:
    """Nothing is changed without need."""
    assert fitting("first.b-2") == "first.b-2"


def test_nobody_is_an_operator_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process whose user has no name commands as operator."""

    def nobody() -> str:
        raise KeyError

    monkeypatch.setattr("getpass.getuser", nobody)
    assert login_operator() == "operator"

"""The targets of the fuzzer hold for their seeds, and for seeds that were changed a little; see ``make fuzz``."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzz.targets import BY_NAME, DRIVE, TARGETS, Target, requests

EACH = pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)


@EACH
def test_what_is_right_passes(target: Target) -> None:
    for seed in target.seeds:
        target.run(seed)


@EACH
@settings(max_examples=40)
@given(st.data())
def test_what_is_changed_is_refused_and_raises_nothing(target: Target, data: st.DataObject) -> None:
    seed = bytearray(data.draw(st.sampled_from(target.seeds)))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(seed)))
        until = data.draw(st.integers(place, min(len(seed), place + 8)))
        seed[place:until] = data.draw(st.binary(max_size=8))
    target.run(bytes(seed))


def test_a_target_fails_where_its_rule_is_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    right = next(seed for seed in BY_NAME["requests"].seeds if seed.endswith(DRIVE))
    forged = right[: -len(DRIVE) - 1] + bytes([right[-len(DRIVE) - 1] ^ 1]) + DRIVE
    requests(forged)
    monkeypatch.setattr("gateway.authority.session.DriveTags.fits", lambda *_: True)
    with pytest.raises(AssertionError):
        requests(forged)

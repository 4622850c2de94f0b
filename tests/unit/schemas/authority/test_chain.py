"""The heads of a run's chains, as those of the next run name them."""

import hashlib

from hypothesis import given
from hypothesis import strategies as st

from schemas.authority.chain import FORMER_BYTES, FormerHeads


@given(boot=st.binary(min_size=8, max_size=8), sequence=st.integers(0, 2**64 - 1), text=st.binary())
def test_heads_that_are_named_are_read_again(boot: bytes, sequence: int, text: bytes) -> None:
    """The run, the sequence, and SHA-256 of the text, in 48 bytes."""
    named = FormerHeads.of(boot, sequence, text)
    assert named.text() == boot + sequence.to_bytes(8, "big") + hashlib.sha256(text).digest()
    assert FormerHeads.read(named.text()) == named


@given(st.binary(max_size=2 * FORMER_BYTES).filter(lambda said: len(said) != FORMER_BYTES))
def test_no_other_length_names_heads(said: bytes) -> None:
    """Those of the first run name none."""
    assert FormerHeads.read(said) is None

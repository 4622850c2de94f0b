import pytest

from schemas.reasons import TEXTS, Reason
from schemas.subjects import BY_NAME


def test_every_reason_is_in_words() -> None:
    """None is missing, in the order of the enumeration."""
    assert list(TEXTS) == list(Reason)


@pytest.mark.parametrize("reason", Reason)
def test_a_reason_says_what_it_means_and_what_would_cure_it(reason: Reason) -> None:
    """A refusal always says what would make it succeed; where nothing is wrong there is nothing to cure."""
    text = TEXTS[reason]
    assert text.means
    assert bool(text.cure) == (reason is not Reason.NONE)


@pytest.mark.parametrize("reason", Reason)
def test_a_text_goes_on_with_figures(reason: Reason) -> None:
    """Figures follow behind a semicolon: a text is one line that neither begins nor ends a sentence."""
    for text in (TEXTS[reason].means, TEXTS[reason].cure):
        assert text == text.strip()
        assert text.isprintable()
        assert not text.endswith(".")
        assert text[:1].islower() or not text


def test_no_two_reasons_mean_the_same() -> None:
    """Who reads it knows which one it is."""
    assert len({text.means for text in TEXTS.values()}) == len(TEXTS)


def test_where_a_cure_sends_someone_there_is_something() -> None:
    """The keys that the cures name are in the subject table."""
    cures = " ".join(text.cure for text in TEXTS.values())
    named = {word.strip(",;") for word in cures.split() if word.startswith(("safety/", "gateway/"))}
    assert named
    assert named <= BY_NAME.keys()

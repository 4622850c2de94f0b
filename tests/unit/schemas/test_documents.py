from hypothesis import given
from hypothesis import strategies as st

from schemas import documents


@given(text=st.text())
def test_a_text_without_markers_is_left_alone(text: str) -> None:
    """What was written by hand is never touched."""
    assert documents.rewrite(text, documents.PARTS) == text


@given(
    before=st.text(st.characters(exclude_characters="<")),
    old=st.text(st.characters(exclude_characters="<")),
    after=st.text(st.characters(exclude_characters="<")),
    name=st.sampled_from(["keys", "some-part"]),
    made=st.text(st.characters(exclude_characters="<"), max_size=20),
)
def test_only_what_is_between_the_markers_is_rewritten(
    before: str, old: str, after: str, name: str, made: str
) -> None:
    """The text around a part stays as it is, and rewriting twice is rewriting once."""
    text = f"{before}<!-- generated: {name} -->\n{old}<!-- end -->{after}"
    parts = {name: lambda: made}
    once = documents.rewrite(text, parts)
    assert once == f"{before}<!-- generated: {name} -->\n\n{made}\n\n<!-- end -->{after}"
    assert documents.rewrite(once, parts) == once

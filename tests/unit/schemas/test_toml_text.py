import tomllib

from hypothesis import given
from hypothesis import strategies as st

from schemas.configuration import lines_of_keys, write_key, write_value

TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
SCALARS = TEXTS | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.booleans()
VALUES = SCALARS | st.lists(SCALARS) | st.dictionaries(TEXTS, SCALARS)

DOCUMENT = '''\
# a comment with [brackets] and = signs
top = 1
dotted.key = 2

[table]   # and a comment
"quoted name" = 'x'
many = [
    1,  # key = 3
    2,
]
inline = { a = 1, "b c" = 2 }
text = """
[not.a.table]
not_a_key = 1
"""

[ table . inner ]
deep = true
[[array]]
first = 1
[[array]]
second = 2
'''


@given(value=VALUES)
def test_a_written_value_reads_back_equal(value: object) -> None:
    """Whatever is written as TOML, tomllib reads back as it was, control characters and quotes included."""
    assert tomllib.loads(f"key = {write_value(value)}") == {"key": value}


@given(key=TEXTS)
def test_a_written_key_reads_back_equal(key: str) -> None:
    """A key that is not bare is quoted, so that every text can be a key."""
    assert tomllib.loads(f"{write_key(key)} = 1") == {key: 1}


def test_every_way_to_write_a_key_has_its_line() -> None:
    """Tables, dotted and quoted keys, inline tables and keys after a value of several lines are all found."""
    lines = lines_of_keys(DOCUMENT)
    assert lines == {
        ("top",): 2,
        ("dotted",): 3,
        ("dotted", "key"): 3,
        ("table",): 5,
        ("table", "quoted name"): 6,
        ("table", "many"): 7,
        ("table", "inline"): 11,
        ("table", "inline", "a"): 11,
        ("table", "inline", "b c"): 11,
        ("table", "text"): 12,
        ("table", "inner"): 17,
        ("table", "inner", "deep"): 18,
        ("array",): 19,
        ("array", "first"): 20,
        ("array", "second"): 22,
    }


def test_line_ends_of_windows_change_no_line() -> None:
    """A file with CR LF line ends has its keys on the same lines."""
    assert lines_of_keys(DOCUMENT.replace("\n", "\r\n")) == lines_of_keys(DOCUMENT)


@given(text=st.text() | st.text("ab.=[]{}'\"\\\n #1,"))
def test_no_text_breaks_the_search_for_lines(text: str) -> None:
    """Whatever the text, the search answers; a line that it names exists."""
    count = text.count("\n") + 1
    assert all(1 <= line <= count for line in lines_of_keys(text).values())

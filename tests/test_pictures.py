"""The text in the pages' pictures is text of today: who changes a message makes the pictures again."""

import ast
import html
import re
from collections.abc import Iterator
from itertools import chain, pairwise
from pathlib import Path
from typing import Final

import pytest
from PIL import Image

ROOT: Final = Path(__file__).parents[1]
PICTURES: Final = ROOT / "docs" / "pictures"
PYTHON: Final = [path for name in ("gateway", "recorder", "schemas") for path in (ROOT / name).rglob("*.py")]
BROWSERS: Final = [
    path
    for name in ("schemas/page", "gateway/desk/page", "recorder/review/report")
    for path in (ROOT / name).rglob("*")
    if path.suffix in {".js", ".html"}
]
VALUE: Final = "#"
# Figures, bytes, what is quoted, and the names that the pictures' robots, operators and recorder have.
VALUES: Final = re.compile(
    r"\S*\d\S*|\b[0-9A-F]{2}\b|'[^']*'|\b(?:first|second)-operator\b|\bann\b|\b[AP]M\b|(?<=Recorders: )\S+"
)


def words(text: str) -> list[str]:
    """Words in lower case and singular, values as one sign, punctuation marks."""
    text = VALUES.sub(f" {VALUE} ", text.replace("_", " ")).lower()
    found = re.findall(rf"[a-z{VALUE}]+(?:[-'][a-z]+)*|[^\sa-z{VALUE}]", text)
    return [re.sub(r"(?<=[a-z]{2})s$", "", word) for word in found]


def literals() -> Iterator[str]:
    """Every text of the program, without docstrings; what is put into one is a value."""
    for path in PYTHON:
        tree = ast.parse(path.read_text("utf-8"))
        docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
                yield node.value
            elif isinstance(node, ast.JoinedStr):
                parts = (part.value if isinstance(part, ast.Constant) else f" {VALUE} " for part in node.values)
                yield "".join(map(str, parts))
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                yield node.target.id  # a column of the report
    for path in BROWSERS:
        text = re.sub(r"\$\d|\$\{[^}]*\}", f" {VALUE} ", path.read_text("utf-8"))
        yield from chain(*re.findall(r'"([^"\n]*)"|`([^`]*)`|>([^<>]+)<', text))


def lines(picture: Path) -> list[str]:
    """The text of a picture: of a PNG its description."""
    if picture.suffix == ".png":
        with Image.open(picture) as image:
            return re.split(r"[\n\t]", str(image.info["Description"]))
    found: dict[float, str] = {}
    for place, text in re.findall(
        r'<text [^>]*y="([\d.]+)"[^>]*>(.*?)</text>', picture.read_text("utf-8"), re.DOTALL
    ):
        found[float(place)] = found.get(float(place), "") + html.unescape(text).replace("\xa0", " ")
    return [text for _, text in sorted(found.items())]


@pytest.fixture(scope="module")
def neighbours() -> set[tuple[str, str]]:
    """What follows what in the program's texts."""
    return {pair for text in literals() for pair in pairwise([VALUE, *words(text), VALUE])}


def strangers(text: str, neighbours: set[tuple[str, str]]) -> list[str]:
    """Neighbouring words that no text of the program has, nor two texts that may stand beside each other."""
    ends = {first for first, second in neighbours if second == VALUE}
    begins = {second for first, second in neighbours if first == VALUE}
    return [
        f"{first} {second}"
        for first, second in pairwise(words(text))
        if first[0].isalpha() and second[0].isalpha() and (first, second) not in neighbours
        if first not in ends or second not in begins
    ]


@pytest.mark.parametrize("name", ["demo.svg", "desk.png", "report.png"])
def test_a_picture_shows_texts_of_today(name: str, neighbours: set[tuple[str, str]]) -> None:
    """Else: `make pictures`."""
    text = lines(PICTURES / name)
    assert len(words(" ".join(text))) > 100
    assert [(found, line) for line in text for found in strangers(line, neighbours)] == []


def test_a_text_of_before_would_be_found(neighbours: set[tuple[str, str]]) -> None:
    assert strangers("the front bumper is hit, and stays pressed", neighbours) == ["and stay", "stay pressed"]

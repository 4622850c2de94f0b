"""Rules of the source tree that no linter holds; the import contracts are in .importlinter."""

import ast
import configparser
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

from tests.support.reach import modules

ROOT = Path(__file__).parent.parent

# Folders with I/O: clocks, threads, the bus, Zenoh.
WORLD = {
    "gateway.can",
    "gateway.host",
    "gateway.zenoh",
    "recorder.replay",
    "recorder.view",
    "recorder.zenoh",
}
PACKAGES = ("gateway", "recorder", "schemas")

FRAMING = {"recorder.mcap.framing", "recorder.mcap.pieces"}  # opcodes, record headers and checksums of MCAP files


@cache
def sources(folders: tuple[str, ...] = PACKAGES) -> dict[str, ast.Module]:
    """The syntax trees of these folders by path."""
    paths = sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    return {str(path.relative_to(ROOT)): ast.parse(path.read_text("utf-8")) for path in paths}


def texts() -> dict[str, str]:
    return {path: (ROOT / path).read_text("utf-8") for path in sources()}


def contracts() -> dict[str, set[str]]:
    """The modules that each contract of .importlinter binds, by its name."""
    parser = configparser.ConfigParser()
    parser.read(ROOT / ".importlinter")
    return {
        section.rpartition(":")[2]: set(parser[section].get("source_modules", "").split())
        for section in parser.sections()
    }


def lint_imports(tree: Path) -> subprocess.CompletedProcess[str]:
    """Check a tree against its contracts."""
    linter = Path(sys.executable).with_name("lint-imports")
    return subprocess.run([linter, "--no-cache"], cwd=tree, capture_output=True, text=True, check=False)


def rooms() -> set[str]:
    """The folders and modules directly below gateway and recorder."""
    return {
        f"{package}.{path.stem}"
        for package in ("gateway", "recorder")
        for path in (ROOT / package).iterdir()
        if path.suffix == ".py" or (path / "__init__.py").exists()
        if not path.stem.startswith("__")
    }


def test_the_import_contracts_hold() -> None:
    """The layers are exhaustive: a folder without one breaks them."""
    outcome = lint_imports(ROOT)
    assert outcome.returncode == 0, outcome.stdout


def test_a_socket_or_a_process_breaks_the_contracts_of_who_may_have_none(tmp_path: Path) -> None:
    """In a core, a schema, and the files of keys; each import is named."""
    shutil.copy(ROOT / ".importlinter", tmp_path)
    for package in PACKAGES:
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__", "page"))
    wrong = {"gateway.core", "schemas.keys", "schemas.authority.proof", "gateway.provisioning.issuer"}
    for module in wrong:
        with (tmp_path / module.replace(".", "/")).with_suffix(".py").open("a", encoding="utf-8") as file:
            file.write("import socket\nimport subprocess\n")
    outcome = lint_imports(tmp_path)
    assert outcome.returncode == 1
    assert set(re.findall(r"^-   (\S+) -> (\S+) ", outcome.stdout, flags=re.MULTILINE)) == {
        (module, imported) for module in wrong for imported in ("socket", "subprocess")
    }


def test_every_room_has_a_contract_of_what_it_may_touch() -> None:
    """Exactly one: pure, reads logs, no CAN and Zenoh, or I/O."""
    bound = contracts()
    kinds = [bound["pure"], bound["questions"], bound["world"], WORLD]
    assert {room: sum(room in kind for kind in kinds) for room in rooms()} == dict.fromkeys(rooms(), 1)


def test_only_one_module_opens_zenoh_sessions() -> None:
    """With one configuration for all."""
    opening = re.compile(r"\bzenoh\.(open|Config\(|Config\.)")
    assert [path for path, text in texts().items() if opening.search(text)] == ["schemas/zenoh_session.py"]


def named_modules(path: str) -> set[str]:
    """The modules of gateway and recorder that a file names in strings."""
    texts = {
        node.value.partition(":")[0]
        for node in ast.walk(sources()[path])
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    dotted = {text for text in texts if re.fullmatch(r"(gateway|recorder)(\.\w+)+", text)}
    places = {text: ROOT.joinpath(*text.split(".")) for text in dotted}
    return {text for text, place in places.items() if place.is_dir() or place.with_suffix(".py").exists()}


def test_no_string_names_a_module_of_the_other_package() -> None:
    """But for the one table of commands; import contracts do not see strings and entry points."""
    named = {path: {one.partition(".")[0] for one in named_modules(path)} for path in sources()}
    crossing = [path for path, packages in named.items() if packages - {path.partition("/")[0]}]
    assert crossing == ["gateway/cli/main.py"]
    assert "entry-points" not in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def framing_in(tree: ast.Module) -> set[str]:
    """The modules of MCAP's framing that a file imports: ours, and all of the mcap package but its records."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    foreign = {name for name in found if name.startswith("mcap.") and not name.startswith("mcap.records")}
    return foreign | found & FRAMING


def test_only_one_room_knows_how_mcap_is_framed() -> None:
    """All others use ``recorder.mcap``'s reader and writer."""
    found = {path: framing_in(tree) for path, tree in sources().items()}
    assert {path: names for path, names in found.items() if names and "recorder/mcap/" not in path} == {}
    assert any(names >= {"recorder.mcap.framing", "mcap.opcode"} for names in found.values())


SAID_TWICE = {name: ["schemas/messages.py", "schemas/requests.py"] for name in ("Drive", "Light")} | {
    "Chassis": ["gateway/chassis/cruiser/early_stop.py", "gateway/chassis/port.py"]
}
"""A report of the chassis, and a request: both stand in the names of schemas that clients know. The early stop is
a program of its own, which shares nothing."""


def test_the_list_of_questions_names_every_module() -> None:
    """The docstring of ``recorder.review`` is its index."""
    room = ROOT / "recorder" / "review"
    listed = ast.get_docstring(ast.parse((room / "__init__.py").read_text("utf-8"))) or ""
    modules = {path.stem for path in room.iterdir() if not path.stem.startswith("__")}
    assert {name for name in modules if f"``{name}``" not in listed} == set()


def test_no_docstring_begins_as_a_question() -> None:
    """A docstring is an imperative or a noun phrase."""
    found = [
        f"{path}:{one.lineno}"
        for path, tree in sources().items()
        for one in ast.walk(tree)
        if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant) and isinstance(one.value.value, str)
        if one.value.value.startswith(("What ", "Whether ", "How "))
    ]
    assert found == []


def test_no_text_is_read_in_the_encoding_of_the_surroundings() -> None:
    """Our files are UTF-8 in any locale."""
    found = [
        f"{path}:{one.lineno}"
        for path, tree in sources().items()
        for one in ast.walk(tree)
        if isinstance(one, ast.Call) and isinstance(one.func, ast.Attribute)
        if (one.func.attr == "read_text" and not (one.args or one.keywords))
        or (one.func.attr == "write_text" and len(one.args) + len(one.keywords) < 2)
    ]
    assert found == []


def open_ends(tree: ast.Module) -> list[int]:
    """The lines of texts in which ``$`` ends a pattern or a branch of one, without MULTILINE."""
    nodes = list(ast.walk(tree))
    calls = (one for one in nodes if isinstance(one, ast.Call))
    of_lines = (one for one in calls if any(getattr(part, "attr", "") == "MULTILINE" for part in ast.walk(one)))
    before_a_gap = [part for one in nodes if isinstance(one, ast.JoinedStr) for part in one.values[:-1]]
    fine = {id(part) for one in of_lines for part in ast.walk(one)} | set(map(id, before_a_gap))
    texts = [one for one in nodes if isinstance(one, ast.Constant) and id(one) not in fine]
    return [one.lineno for one in texts if isinstance(one.value, str) and OPEN_END.search(one.value)]


OPEN_END = re.compile(r"(?<!\\)\$(\Z|[|)])")


def test_no_pattern_admits_a_line_end_behind_it() -> None:
    """``$`` does: a key with a line end was granted what the other key was not."""
    assert {
        path: lines for path, tree in sources((*PACKAGES, "deploy")).items() if (lines := open_ends(tree))
    } == {}
    seen = 'A = f"^{B}$"\nC = re.compile(r"a$|b")\nD = re.sub("a$", "", E, flags=re.MULTILINE)'
    assert open_ends(ast.parse(seen)) == [1, 2]


def test_no_public_class_has_the_name_of_another() -> None:
    """A name in a traceback or a search means one thing."""
    places: dict[str, list[str]] = {}
    for path, tree in sources().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(path)
    assert {name: found for name, found in places.items() if len(found) > 1} == SAID_TWICE


def test_one_function_starts_our_interpreter() -> None:
    """With ``-P``; otherwise it would execute foreign files in the working directory."""
    starts = re.compile(r"sys\.executable|import executable|multiprocessing|ProcessPool")
    found = {path: set(starts.findall(text)) for path, text in texts().items()}
    assert {path: words for path, words in found.items() if words} == {
        "schemas/command_line.py": {"sys.executable"},
        # A pool of processes: it sets what `-P` sets.
        "recorder/review/tasks.py": {"multiprocessing", "ProcessPool"},
    }


def test_a_name_of_a_module_means_one_in_its_package() -> None:
    """But for ``loop`` and files of commands."""
    places: dict[tuple[str, str], list[str]] = {}
    for name, path in modules().items():
        if path.stem not in {"__init__", "__main__", "loop"} and ".cli." not in name:
            places.setdefault((name.partition(".")[0], path.stem), []).append(name)
    assert [found for found in places.values() if len(found) > 1] == []


SHORT_LINES = 60


def test_a_short_module_says_why_it_is_one() -> None:
    """In its docstring, by a second sentence."""
    short = {
        name: ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
        for name, path in modules().items()
        if path.name != "__init__.py" and len(path.read_text("utf-8").splitlines()) < SHORT_LINES
    }
    assert [name for name, text in short.items() if not re.search(r"\.\s", text)] == []

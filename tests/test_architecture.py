"""Rules of the source tree that no linter holds; the import contracts are in .importlinter."""

import ast
import configparser
import re
import shutil
import subprocess
import sys
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
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    opening = re.compile(r"\bzenoh\.(open|Config\(|Config\.)")
    found = {path.relative_to(ROOT) for path in files if opening.search(path.read_text(encoding="utf-8"))}
    assert found == {Path("schemas/zenoh_session.py")}


def named_modules(path: Path) -> set[str]:
    """The modules of gateway and recorder that a file names in strings."""
    texts = {
        node.value.partition(":")[0]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    dotted = {text for text in texts if re.fullmatch(r"(gateway|recorder)(\.\w+)+", text)}
    places = {text: ROOT.joinpath(*text.split(".")) for text in dotted}
    return {text for text, place in places.items() if place.is_dir() or place.with_suffix(".py").exists()}


def test_no_string_names_a_module_of_the_other_package() -> None:
    """But for the one table of commands; import contracts do not see strings and entry points."""
    files = [path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    crossing = {path for path in files if {one.partition(".")[0] for one in named_modules(path)} - {path.parts[0]}}
    assert crossing == {Path("gateway/cli/main.py")}
    assert "entry-points" not in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def framing_in(path: Path) -> set[str]:
    """The modules of MCAP's framing that a file imports: ours, and all of the mcap package but its records."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    foreign = {name for name in found if name.startswith("mcap.") and not name.startswith("mcap.records")}
    return foreign | found & FRAMING


def test_only_one_room_knows_how_mcap_is_framed() -> None:
    """All others use ``recorder.mcap``'s reader and writer."""
    room = ROOT / "recorder" / "mcap"
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    assert {str(path): found for path in files if room not in path.parents and (found := framing_in(path))} == {}
    assert any(framing_in(path) >= {"recorder.mcap.framing", "mcap.opcode"} for path in room.glob("*.py"))


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
        f"{path.relative_to(ROOT)}:{one.lineno}"
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for one in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant) and isinstance(one.value.value, str)
        if one.value.value.startswith(("What ", "Whether ", "How "))
    ]
    assert found == []


def test_no_text_is_read_in_the_encoding_of_the_surroundings() -> None:
    """Our files are UTF-8 in any locale."""
    found = [
        f"{path.relative_to(ROOT)}:{one.lineno}"
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for one in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
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
    found = {
        str(path.relative_to(ROOT)): lines
        for package in (*PACKAGES, "deploy")
        for path in sorted((ROOT / package).rglob("*.py"))
        if (lines := open_ends(ast.parse(path.read_text(encoding="utf-8"))))
    }
    assert found == {}
    seen = 'A = f"^{B}$"\nC = re.compile(r"a$|b")\nD = re.sub("a$", "", E, flags=re.MULTILINE)'
    assert open_ends(ast.parse(seen)) == [1, 2]


def test_no_public_class_has_the_name_of_another() -> None:
    """A name in a traceback or a search means one thing."""
    places: dict[str, list[str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places.setdefault(node.name, []).append(str(path.relative_to(ROOT)))
    assert {name: found for name, found in places.items() if len(found) > 1} == SAID_TWICE


def test_one_function_starts_our_interpreter() -> None:
    """With ``-P``; otherwise it would execute foreign files in the working directory."""
    starts = re.compile(r"sys\.executable|import executable|multiprocessing|ProcessPool")
    found = {
        str(path.relative_to(ROOT)): set(starts.findall(path.read_text("utf-8")))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
    }
    assert {path: words for path, words in found.items() if words} == {
        "schemas/command_line.py": {"sys.executable"},
        # A pool of processes: it sets what `-P` sets.
        "recorder/review/tasks.py": {"multiprocessing", "ProcessPool"},
    }


EXTRAS = (
    "duckdb",
    "foxglove",
    "numpy",
    "obstore",
    "prometheus_client",
    "ptars",
    "pyarrow",
    "ray",
    "rerun",
    "starlette",
)

WITHOUT_EXTRAS = f"""
import importlib, sys
sys.modules.update(dict.fromkeys({EXTRAS!r}))
from gateway.cli.main import COMMANDS
from recorder.cli.review import QUESTIONS
for module, _ in [*COMMANDS.values(), *QUESTIONS.values()]:
    importlib.import_module(module.partition(":")[0])
"""


def test_every_command_explains_itself_without_the_extras() -> None:
    """An extra is imported when it is needed: 'make demo' and a robot have none."""
    subprocess.run([sys.executable, "-c", WITHOUT_EXTRAS], cwd=ROOT, check=True)


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

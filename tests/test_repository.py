"""The pages and the Makefile: links lead somewhere, named tests and places exist, the README is short."""

import argparse
import io
import json
import re
import shlex
import subprocess
import sys
import tomllib
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from pkgutil import resolve_name
from typing import Final

import pytest

from gateway.cli.main import COMMANDS
from recorder.cli.review import QUESTIONS
from schemas.subjects import BY_VERB

ROOT: Final = Path(__file__).parents[1]
PAGES: Final = [
    ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG", "SECURITY", "CODE_OF_CONDUCT")
] + sorted(path for path in (ROOT / "docs").rglob("*.md") if "node_modules" not in path.parts)
README_LINES_MAX: Final = 150
PICTURE_BYTES_MAX: Final = 300_000

pages = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def prose(page: Path) -> str:
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.sub(r"^    .*\n", "", text, flags=re.MULTILINE)


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(page: Path) -> list[str]:
    """The links of a page to missing places of the tree."""
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        place = (page.parent / name).resolve() if name else page
        if not place.exists() or (anchor and anchor not in anchors(place)):
            broken.append(target)
    return broken


@pages
def test_every_link_leads_somewhere(page: Path) -> None:
    """To a file, a folder, or a heading."""
    assert broken_links(page) == []


def test_a_broken_link_would_be_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A: b_c\n[1](no.md) [2](#no) [3](page.md#a-b_c) [4](https://x.example/)\n    [5](code)\n", "utf-8"
    )
    assert broken_links(page) == ["no.md", "#no"]


@pages
def test_every_test_that_a_page_names_exists(page: Path) -> None:
    for path, test in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", prose(page)):
        assert re.search(rf"^(async )?def {test}\(", (ROOT / path).read_text("utf-8"), re.MULTILINE), (
            f"{path}::{test}"
        )


@pages
def test_no_page_names_the_project_as_if_an_index_had_it(page: Path) -> None:
    """How to get an extra depends on the installation: docs/install.md."""
    assert not re.search(r"pip install[^\n]*cruiser-gateway\b", page.read_text("utf-8"))


@pages
def test_every_place_in_the_tree_that_a_page_names_is_there(page: Path) -> None:
    """Files, and folders with their slash, in backticks."""
    if page.name == "CHANGELOG.md":
        return  # it names what was
    places = re.findall(
        r"`((?:deploy|docs|gateway|recorder|schemas|tests)/(?:[\w./-]*(?:/|\.\w+))?)`", prose(page)
    )
    assert [place for place in places if not (ROOT / place).exists()] == []


@pytest.mark.parametrize("verb", BY_VERB)
def test_the_page_of_commands_names_every_verb(verb: str) -> None:
    """In a text beside the generated table."""
    page = (ROOT / "docs" / "commands.md").read_text("utf-8")
    assert f"\n### {verb}\n" in page


def test_the_index_of_the_documents_lists_every_page() -> None:
    """By a link to the page or a part of it."""
    docs = ROOT / "docs"
    linked = {target.partition("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", prose(docs / "README.md"))}
    assert {page.name for page in docs.glob("*.md")} - {"README.md"} - linked == set()


def typed(text: str) -> list[str]:
    """What stands after ``cruiser`` in a page's blocks and in its sentences."""
    blocks = re.findall(r"^    (?:.* -- |sudo )?cruiser (.*(?:\n {8,}.*)*)$", text, flags=re.MULTILINE)
    named = re.findall(r"`(?:sudo )?cruiser ([a-z][^`]*)`", text)
    lines = [re.sub(r"\s+# .*", "", line) for line in (*blocks, *named)]
    return [part for line in lines for part in line.split(" && cruiser ")]


def refused(name: str, words: list[str]) -> str:
    """What a command says of words that it does not take, its usage included."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--config")
    parser.add_argument("--log-level")
    resolve_name(COMMANDS[name][0]).add_arguments(parser)
    says = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(says), suppress(SystemExit):
        parser.parse_args(words)
    return says.getvalue()


@pages
def test_every_command_of_a_page_exists_with_its_flags(page: Path) -> None:
    """A name alone stands for the command, so words that it needs may be missing."""
    if page.name == "CHANGELOG.md":
        return  # it names what was
    for line in typed(page.read_text("utf-8")):
        name, *words = shlex.split(re.sub(r" [|]+ .*", "", re.sub(r"\bROBOT\b|\bN\b", "1", line)))
        assert name in COMMANDS, line
        if error := refused(name, words):
            assert re.search("are required|expected one argument|'QUESTION'", error), (line, error)
            assert [word for word in words if word.startswith("-") and word not in error] == [], (line, error)


def test_commands_of_each_kind_are_found() -> None:
    """As root, as a service's user, over several lines, in a sentence."""
    text = (
        "    sudo cruiser a\n    runuser -u x -- cruiser b  # c\n    cruiser d 'e\n            f'\n`cruiser g`\n"
    )
    assert typed(text) == ["a", "b", "d 'e\n            f'", "g"]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_tour_or_the_readme_names_every_command(command: str) -> None:
    """As typed, or in a list of those that begin with ``cruiser``."""
    text = "".join((ROOT / page).read_text("utf-8") for page in ("README.md", "docs/tour.md"))
    assert re.search(rf"cruiser {command}\b|`{command}`", text)


@pytest.mark.parametrize("question", QUESTIONS)
def test_the_page_of_the_review_has_a_section_on_every_question(question: str) -> None:
    """With a command line, and a row in the table at the top."""
    page = (ROOT / "docs" / "review.md").read_text("utf-8")
    assert re.search(rf"^## {question}\b", page, flags=re.MULTILINE)
    assert f"    cruiser review {question} " in page
    assert re.search(rf"^\|.*\[`{question}`\]\(#.*\|$", page, flags=re.MULTILINE)


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= README_LINES_MAX


def test_pictures_are_small_and_load_nothing() -> None:
    """A picture that fetched a font would report who reads the page."""
    files = [path for path in (ROOT / "docs").rglob("*") if "node_modules" not in path.parts]
    pictures = [path for path in files if path.suffix in {".png", ".svg"}]
    assert pictures
    for picture in pictures:
        assert picture.stat().st_size <= PICTURE_BYTES_MAX, picture
        if picture.suffix == ".svg":
            text = picture.read_text("utf-8").replace("http://www.w3.org/", "")
            assert "http" not in text
            assert "@import" not in text


def test_the_licence_is_one() -> None:
    """As SPDX in the metadata, and in the notice's first line for scanners."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert project["license"] == "Apache-2.0"
    assert (ROOT / "LICENSE").read_text("utf-8").startswith("SPDX-License-Identifier: Apache-2.0\n")


def test_make_help_lists_every_target() -> None:
    """With a line of help each."""
    makefile = (ROOT / "Makefile").read_text("utf-8")
    phony = re.search(r"^\.PHONY: (.*)$", makefile, flags=re.MULTILINE)
    assert phony
    done = subprocess.run(
        ["make", "--no-print-directory", "-f", ROOT / "Makefile"], capture_output=True, text=True, check=True
    )
    assert sorted(line.split()[0] for line in done.stdout.splitlines()) == sorted(phony[1].split())


def test_the_demo_installs_no_more_than_the_product_needs() -> None:
    """The product without extras."""
    done = subprocess.run(
        ["make", "-f", ROOT / "Makefile", "-n", "-W", ROOT / "pyproject.toml", "VENV=/nowhere", "demo"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    installs = [line for line in done.stdout.splitlines() if "pip install" in line]
    assert [line.split()[-1] for line in installs] == ["constraints-run.txt", "."]


def test_what_the_tests_lack_is_one_line(tmp_path: Path) -> None:
    """Before anything starts. Root gets it, and a missing package delays nothing."""
    for program in ("bash", "grep", "make"):
        (tmp_path / program).symlink_to(f"/usr/bin/{program}")
    stand_in(tmp_path / "id", "echo $WHO")
    stand_in(
        tmp_path / "apt-get",
        f'[ "$5" = can-utils ] || exit 1; : >{tmp_path}/log2asc; /bin/chmod +x {tmp_path}/log2asc',
    )
    said = []
    for who in ("1000", "0"):
        done = subprocess.run(
            ["bash", "-c", ". .ci/packages; echo goes on"],
            cwd=ROOT,
            env={"PATH": str(tmp_path), "WHO": who},
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout == "goes on\n"
        (line,) = done.stderr.splitlines()
        said.append(line)
    assert re.search(r": sudo apt-get install .*\bcan-utils\b", said[0])
    assert "can-utils" not in said[1]


def stand_in(path: Path, script: str) -> None:
    path.write_text(f"#!/bin/sh\n{script}\n", "utf-8")
    path.chmod(0o755)


def test_the_last_line_of_all_tests_sums_them_up() -> None:
    """Whatever libraries print after the runs; with the runs' exit code."""
    runs = (
        "echo '===== 1 failed, 20 passed, 2 skipped in 3.21s ====='; echo leaks >&2; "
        "echo '= 5 passed, 1 error in 65.00s (0:01:05) ='; echo leaks >&2; exit 2"
    )
    words = [sys.executable, "-m", "tests.support.summary", "sh", "-c", runs]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout.splitlines()[-1] == "FAILED: 1 failed, 1 errors, 25 passed, 2 skipped"


def test_what_npm_brings_has_a_hash_and_no_registry() -> None:
    """Any registry gives the same, or nothing."""
    found = subprocess.run(
        ["git", "ls-files", "*package.json"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    manifests = [ROOT / line for line in found.stdout.splitlines()]
    assert manifests
    for manifest in manifests:
        packages = json.loads(manifest.with_name("package-lock.json").read_text("utf-8"))["packages"]
        brought = {place: one for place, one in packages.items() if place}
        assert [place for place, one in brought.items() if "resolved" in one or "integrity" not in one] == []

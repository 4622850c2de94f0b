"""What is pinned, and what ``make`` installs."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[3]
RUN, ALL, TOOLS, READERS = (f"constraints{end}.txt" for end in ("-run", "", "-tools", "-readers"))
BLOCK = re.compile(r"^(\S.*?) \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)(?:    #.*\n)*", re.MULTILINE)


def pins(file: str) -> dict[str, tuple[Requirement, frozenset[str]]]:
    """The pins of a file by name: requirement and hashes. The file may contain nothing else."""
    text = (ROOT / file).read_text("utf-8")
    rest = BLOCK.sub("", text)
    assert all(line.startswith("#") for line in rest.splitlines()), f"{file} has more than pins with hashes"
    blocks = [
        (Requirement(pin), frozenset(re.findall("[0-9a-f]{64}", hashes))) for pin, hashes in BLOCK.findall(text)
    ]
    return {requirement.name: (requirement, hashes) for requirement, hashes in blocks}


def wanted(*names: str) -> list[Requirement]:
    """The requirements of extras or groups of pyproject.toml; "product" is the product itself."""
    said = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    project = said["project"]
    lists = {"product": project["dependencies"], **project["optional-dependencies"], **said["dependency-groups"]}
    lists["backend"] = said["build-system"]["requires"]
    return [
        requirement
        for name in names
        for requirement in map(Requirement, lists[name])
        if requirement.name != project["name"]
        if requirement.marker is None or requirement.marker.evaluate()
    ]


@pytest.mark.parametrize("file", [RUN, ALL, TOOLS, READERS])
def test_every_package_is_of_one_version_and_has_hashes(file: str) -> None:
    """For pip's --require-hashes."""
    pinned = pins(file)
    assert pinned
    for requirement, hashes in pinned.values():
        assert [one.operator for one in requirement.specifier] == ["=="], requirement
        assert "*" not in str(requirement.specifier)
        assert hashes


@pytest.mark.parametrize(
    ("file", "names"),
    [
        (RUN, ("product", "desk", "metrics", "upload", "build", "backend")),
        (ALL, ("product", "build", "backend", "review", "desk", "live", "metrics", "upload", "dev")),
        (TOOLS, ("tools",)),
        (READERS, ("readers",)),
    ],
)
def test_what_is_pinned_is_what_pyproject_wants(file: str, names: tuple[str, ...]) -> None:
    """Each dependency and the build backend, within its bounds."""
    pinned = pins(file)
    for requirement in wanted(*names):
        pin = pinned[requirement.name.lower().replace("_", "-")][0]
        version = next(iter(pin.specifier)).version
        assert requirement.specifier.contains(version), f"{requirement} and {pin}: make constraints"


def test_a_package_has_one_version_and_the_same_hashes_in_all_files() -> None:
    """What is tested is what runs; tools go into the development environment."""
    everything, run, tools = pins(ALL), pins(RUN), pins(TOOLS)
    assert set(run) < set(everything)
    for part in (run, tools):
        for name, (pin, hashes) in part.items():
            if name in everything:
                assert (str(pin.specifier), hashes) == (str(everything[name][0].specifier), everything[name][1])


def test_make_installs_nothing_that_has_no_hash() -> None:
    """But the project itself, and the clients' own packages, whose install scripts do not run."""
    makefile = (ROOT / "Makefile").read_text("utf-8")
    variables = dict(re.findall(r"^(\w+) = (.*)$", makefile, flags=re.MULTILINE))
    assert variables["PINNED"].startswith("$(PIP) --require-hashes --only-binary :all: ")
    assert "--no-deps --no-build-isolation" in variables["PROJECT"]
    recipes = [line for line in makefile.splitlines() if "install" in line and line.startswith("\t")]
    assert re.search("^NPM_INSTALL := npm ci --ignore-scripts ", makefile, flags=re.MULTILINE)
    # Of a version of a Go module everybody gets the same: Go asks its public log of checksums.
    is_known = re.compile(r"apt-get|\$\(CARGO\) install --locked|go install [^ ]+@v[0-9.]+$")
    others = [line for line in recipes if not is_known.search(line)]
    assert others == [], "use PINNED or PROJECT"

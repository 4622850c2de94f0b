"""``make sbom``: write the bill of materials of an installation as CycloneDX 1.6 into build/sbom.json.

An empty environment gets what constraints-run.txt pins, as a robot does. Versions and licences are read there;
hashes are those of the files that pip verified. The vendored scripts of the desk's page are added from their
notices.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tomllib
from hashlib import sha256
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build"

VENDORED = ROOT / "schemas" / "page" / "vendor"
NOTICES = "LICENSES.txt"

# Of the packages in VENDORED; their texts are in NOTICES.
SCRIPT_LICENCES = {"uPlot": "MIT", "@msgpack/msgpack": "ISC"}
LICENCES = {"protobuf": "BSD-3-Clause"}  # of packages whose metadata names none, from their LICENSE file


def main() -> None:
    """Write the bill, or fail with what is missing in it."""
    # Of the tools' environment alone; the tests of the rest do without.
    from cyclonedx.schema import SchemaVersion  # noqa: PLC0415
    from cyclonedx.validation.json import JsonStrictValidator  # noqa: PLC0415

    environment = BUILD / "sbom-environment"
    shutil.rmtree(environment, ignore_errors=True)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", environment], check=True)
    python = environment / "bin" / "python"
    report = BUILD / "installed.json"
    constraints = ["--require-hashes", "--only-binary", ":all:", "--requirement", ROOT / "constraints-run.txt"]
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "--python", python]
    subprocess.run([*pip, "install", "--report", report, *constraints], check=True)
    bill = BUILD / "sbom.json"
    reader = [Path(sys.executable).with_name("cyclonedx-py"), "environment", python, "--spec-version", "1.6"]
    project = ["--pyproject", ROOT / "pyproject.toml", "--mc-type", "application"]
    subprocess.run([*reader, *project, "--output-file", bill], check=True)

    said = json.loads(bill.read_text("utf-8"))
    complete(said, json.loads(report.read_text("utf-8")))
    said["components"] += vendored(VENDORED)
    text = json.dumps(said, indent=2)
    faults = missing(said) or JsonStrictValidator(SchemaVersion.V1_6).validate_str(text)
    if faults:
        bill.unlink()
        sys.exit(f"build/sbom.json: {faults}")
    bill.write_text(text + "\n", "utf-8")
    print(f"{bill.relative_to(ROOT)}: {len(said['components'])} packages")


def complete(bill: dict[str, Any], report: dict[str, Any]) -> None:
    """Add to each component the hash of its file, and the licence that it does not name."""
    files = {one["metadata"]["name"].lower(): one["download_info"] for one in report["install"]}
    for component in bill["components"]:
        info = files.get(component["name"].lower())
        if info is not None:
            component["hashes"] = [{"alg": "SHA-256", "content": info["archive_info"]["hashes"]["sha256"]}]
        if not component.get("licenses") and component["name"] in LICENCES:
            component["licenses"] = [{"license": {"id": LICENCES[component["name"]]}}]


def vendored(directory: Path) -> list[dict[str, Any]]:
    """The components in a directory of vendored scripts; ValueError for a script without notice."""
    notices = (directory / NOTICES).read_text("utf-8")
    components = []
    named: list[str] = []
    for name, version, files in re.findall(r"^(\S+) (\d[\w.]*) \(([^)]+)\)$", notices, re.MULTILINE):
        names = files.split(", ")
        named += names
        purl = f"pkg:npm/{name.replace('@', '%40')}@{version}"
        components.append(
            {
                "type": "library",
                "bom-ref": purl,
                "name": name,
                "version": version,
                "purl": purl,
                "licenses": [{"license": {"id": SCRIPT_LICENCES[name]}}],
                # One hash for each algorithm and component: that of the script, which is the first file.
                "hashes": [{"alg": "SHA-256", "content": sha256((directory / names[0]).read_bytes()).hexdigest()}],
                "properties": [{"name": "file", "value": f"schemas/page/vendor/{one}"} for one in names],
            }
        )
    there = {one.name for one in directory.iterdir()} - {NOTICES}
    if there != set(named):
        raise ValueError(f"{directory}: files and {NOTICES} differ: {', '.join(sorted(there ^ set(named)))}")
    return components


def missing(bill: dict[str, Any]) -> str:
    """What the bill must have and lacks; empty if nothing."""
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["dependencies"]
    names = {component["name"].lower() for component in bill["components"]}
    wanted += [f"{component['name']}>" for component in vendored(VENDORED)]
    lacks = [f"no {name}" for name in (one.partition(">")[0] for one in wanted) if name.lower() not in names]
    lacks += [
        f"{component['name']} has no {what}"
        for component in bill["components"]
        for what in ("version", "hashes", "licenses")
        if not component.get(what)
    ]
    return ", ".join(lacks)


if __name__ == "__main__":
    main()

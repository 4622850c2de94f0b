# SPDX-License-Identifier: Apache-2.0
"""Make the pictures of the README anew: `make pictures`. Runs the demo, and wants Chromium.

- ``demo.svg``    the terminal while the demo runs, and why the robot stopped, as the commands print it
- ``report.png``  the top of the drive report of the same demo, without its summary in words
"""

import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

PICTURES: Final = Path(__file__).parent
BROWSERS: Final = ("chromium", "chromium-browser", "google-chrome")
COLUMNS: Final = 138
WIDTH, HEIGHT = 1200, 1330
CSS: Final = "<style>ul + .card { display: none }</style></head>"


def cruiser(*words: str, where: Path) -> str:
    """What a command prints."""
    command = [sys.executable, "-m", "gateway", *words]
    environment = os.environ | {"COLUMNS": str(COLUMNS), "PYTHONPATH": str(PICTURES.parents[1])}
    return subprocess.run(
        command, cwd=where, env=environment, stdout=subprocess.PIPE, text=True, check=True
    ).stdout


def terminal(screens: list[tuple[str, str]], title: str) -> str:
    """Commands and what they printed, as a picture that loads nothing: the viewer's own font serves."""
    console = Console(record=True, width=COLUMNS, file=io.StringIO(), force_terminal=True)
    for command, printed in screens:
        console.print(Text.assemble(("$ ", "bold green"), (command, "bold")))
        console.print(Text(printed))
    svg = console.export_svg(title=title, theme=MONOKAI)
    svg = re.sub(r"@font-face \{.*?\}\n?|<!--.*?-->\n?", "", svg, flags=re.DOTALL)
    return re.sub(r"[ \t]+$", "", svg.replace("Fira Code, monospace", "monospace"), flags=re.MULTILINE)


def report(page: Path, picture: Path) -> None:
    """The page as a browser shows it in the light."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise SystemExit("no Chromium: apt-get install chromium")
    page.write_text(page.read_text("utf-8").replace("</head>", CSS, 1), "utf-8")
    flags = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=10000")
    size = (f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={picture}")
    subprocess.run([browser, *flags, *size, page.as_uri()], check=True, stderr=subprocess.DEVNULL)


def main() -> None:
    """Run the demo once, for both pictures."""
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
        demo = cruiser("demo", "--seconds", "30", "--out", "demo-log", where=where)
        [stop] = re.findall(r"^ *([\d.]+) s +robot +stopping: the front bumper", demo, flags=re.MULTILINE)
        why = ("review", "why", "demo-log", "--at", stop)
        screens = [("make demo", demo.partition("open it with")[0]), (f"cruiser {' '.join(why)}", "")]
        screens[1] = (screens[1][0], cruiser(*why, where=where))
        (PICTURES / "demo.svg").write_text(terminal(screens, "Cruiser Gateway"), "utf-8")
        cruiser("review", "report", "demo-log", "-o", "report.html", where=where)
        report(where / "report.html", PICTURES / "report.png")


if __name__ == "__main__":
    main()

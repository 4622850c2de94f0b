"""The manual page cruiser(1), from the commands' own help."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache

from gateway.cli.main import GROUPS
from recorder.cli.review import QUESTIONS

HEAD = r""".TH CRUISER 1 "" "Cruiser Gateway {version}" "User Commands"
.SH NAME
cruiser \- drive-by-wire robots on Zenoh: drive, watch and stop them, record and review
.SH SYNOPSIS
.B cruiser
.I COMMAND
[...]
.br
.B cruiser help
.I COMMAND
"""
TAIL = r""".SH EXIT STATUS
0 ok, 1 findings or failure, 2 usage, 3 partial, 4 unreachable, 5 refused
.SH FILES
.I /etc/cruiser/cruiser.toml
settings of the services; others by
.B \-\-config
or
.B CRUISER_CONFIG
.SH SEE ALSO
.BR candump (1),
.BR systemctl (1)
"""


@cache
def manual(version: str) -> str:
    parts = [HEAD.format(version=version)]
    for group, commands in GROUPS.items():
        parts.append(f".SH {group.upper()}\n")
        for name in commands:
            parts += [_section(name), *(_section(name, one) for one in QUESTIONS if name == "review")]
    return "".join([*parts, TAIL])


def _section(*words: str) -> str:
    command = [sys.executable, "-m", "gateway", "help", *words]
    environment = os.environ | {"COLUMNS": "80"}
    said = subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout
    lines = said.replace("\\", r"\e").replace("-", r"\-").splitlines()
    quoted = "\n".join(rf"\&{line}" if line[:1] in {".", "'"} else line for line in lines)
    return f".SS cruiser {' '.join(words)}\n.nf\n{quoted}\n.fi\n"

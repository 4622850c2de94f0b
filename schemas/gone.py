"""Names the commands, flags and settings of earlier versions that are gone, and what to use instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Final

GONE_WORDS: Final[Mapping[str, str]] = {
    "review evidence": "cut the time out with 'cruiser review cut', and keep the whole log with its .sig",
    "setup --dry-run": "docs/operate.md says what is written; what was there is kept beside it",
    "setup --output": "the services read /etc/cruiser/cruiser.toml",
    "setup --without-bus": "setup needs no bus",
    "serve": "'cruiser desk --logs DIRECTORY --logs-only' shows logs in a browser",
    "shadow": "record the drive, and ask 'cruiser review rerun LOG --set SETTING=VALUE'",
    "review regress": "'cruiser review rerun LOG...' says of how many logs the decisions differ",
    "review rerun --jobs": "give --processes N",
    "review export --runner": "give --processes N, or --ray ADDRESS",
    "record start": "a recorder records while it runs: 'systemctl start cruiser-recorder'",
    "record stop": "a recorder records while it runs: 'systemctl stop cruiser-recorder'",
    "record split": "'systemctl reload cruiser-recorder', or SIGHUP, begins new files",
    "review export --add": "export to a dataset of its own, and read both",
    "review merge": "'mcap merge' (the mcap CLI); questions take several files and directories",
    "record backfill": "ask the log of the robot's own recorder too, which lacks nothing that a link lost",
    "provision site": "the authority signs each person's request itself ('cruiser provision sign')",
    "provision sign --delegate": "no grant stands below another",
    "provision time": "a robot goes by its clock, and by no earlier time than its authority signed last",
    "demo-fleet": "'make demo-fleet' in a checkout; docs/examples/fleet.sh has its commands",
    "demo --browser": "it is opened, unless --no-browser",
    "demo --json": "'cruiser review info --json' asks the log",
    "demo --link": "the demo's link is that of this machine",
    "demo --patrol": "'cruiser drive' drives one of its robots",
    "sim --fleet": "'cruiser demo --desk --robots N'",
    "sim --patrol": "'cruiser demo --desk', and 'cruiser drive' to drive one of its robots",
    "sim --endpoint": "'cruiser demo --desk --endpoint ENDPOINT'",
    **dict.fromkeys(
        (
            f"review replay --{flag}"
            for flag in ("interface", "channel", "bitrate", "fd", "tx", "force-real-bus", "force-command-frames")
        ),
        "put frames on a bus with 'cruiser review export --format candump' and canplayer",
    ),
}
"""Commands (``serve``) and flags (``review export --add``) as they were typed: what to use."""

GONE_SETTINGS: Final[Mapping[str, str]] = {
    "upload.hours": "a systemd timer has the hours, see docs/upload.md",
    "command.brake_pedal_percent": "the brake pedal is never pressed",
    "authority.max_offline_h": "a robot is engaged however long its authority was silent; give grants of hours",
    "authority.require_fresh": "a robot waits for no word of its authority; give grants of hours",
}
"""Settings by their dotted keys, or whole tables by their names: what to use instead.

A robot's settings file that holds one still starts its gateway, with a warning: an upgrade must ground no fleet.
Logs hold the settings that were in force, so those of earlier versions hold them too.
"""


def gone_word(words: Sequence[str]) -> str:
    """Return what to say about the first of a command line's words that is gone; empty if none is."""
    flags = [word.partition("=")[0] for word in words if word.startswith("--")]
    # A word behind a flag may be its value.
    names = [
        word
        for before, word in pairwise(["", *words])
        if not word.startswith("-") and (not before.startswith("-") or "=" in before)
    ]
    commands = [" ".join(names[:length]) for length in (1, 2) if len(names) >= length]
    typed = [*commands, *(f"{command} {flag}" for flag in flags for command in commands)]
    return next((f"'{word}' is gone: {GONE_WORDS[word]}" for word in typed if word in GONE_WORDS), "")


def gone_setting(key: str) -> str:
    """Return what to say about a setting, or a table of settings, that is gone; empty if it is not."""
    named = next((name for name in (key, key.partition(".")[0]) if name in GONE_SETTINGS), "")
    return f"{key} is gone and has no effect: {GONE_SETTINGS[named]}" if named else ""

"""Opens Zenoh sessions as the settings say."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Final

import zenoh

from schemas.exit_codes import CommandError, ExitCode
from schemas.settings import DEFAULT_ENDPOINT, ZenohSettings
from schemas.zenoh_link import CONNECT, reason, session_settings

BATCH_SIZE: Final = "transport/link/tx/batch_size"

BATCH_BYTES: Final = 16_384
"""The links' batches, both ways. A sample that waits keeps all of the batch in memory that it came in: with
Zenoh's own 64 KiB a recorder of 300 robots grew to 1.4 GB. Less would leave senders too little for a stall."""


def open_session(settings: ZenohSettings, listen: Sequence[str] | None = None) -> zenoh.Session:
    """A session; it connects in the background.

    Args:
        settings: of the session.
        listen: where it listens; where the settings say if it is None.

    Raises:
        CommandError: the settings are wrong, or it cannot be opened.
    """
    config = _configuration(settings, list(settings.listen if listen is None else listen))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise CommandError(f"cannot join Zenoh: {reason(str(error))}", ExitCode.UNREACHABLE) from error


def _configuration(settings: ZenohSettings, listen: list[str]) -> zenoh.Config:
    """The configuration file, if one is set, with our settings over it."""
    start = zenoh.Config()
    try:
        config = zenoh.Config.from_file(settings.config) if settings.config else zenoh.Config()

        def says(path: str) -> bool:
            return bool(config.get_json(path) != start.get_json(path))

        connect = settings.connect or ([] if says(CONNECT) else [DEFAULT_ENDPOINT])
        for path, value in session_settings(settings, connect, listen, says).items():
            config.insert_json5(path, json.dumps(value))
        if not says(BATCH_SIZE):
            config.insert_json5(BATCH_SIZE, json.dumps(BATCH_BYTES))
    except zenoh.ZError as error:
        raise CommandError(f"wrong Zenoh settings: {reason(str(error))}", ExitCode.USAGE) from error
    return config

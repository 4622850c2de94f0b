"""The name by which a recorder goes, in its keys."""

from __future__ import annotations

from recorder.disk.key_files import granted_name
from recorder.zenoh.remote_control import host_name
from schemas.settings import Settings


def own_name(settings: Settings) -> str:
    """Return the name that is set; else that of the recorder's grant, in signed mode; else the host's."""
    is_signed = settings.authority.mode == "signed"
    return settings.recorder.name or (is_signed and granted_name(settings.authority, "recorder")) or host_name()

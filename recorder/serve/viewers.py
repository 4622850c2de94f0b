"""Programs in the browser that open a log by its address: Foxglove, Lichtblick, and a remote data loader."""

from __future__ import annotations

import argparse
from typing import Any, Final
from urllib.parse import quote, urlsplit

import msgspec

EXPOSED: Final = ("Accept-Ranges", "Content-Length", "Content-Range", "ETag", "Last-Modified")
"""Headers that a viewer has to see to read a file by ranges."""


class Viewer(msgspec.Struct, frozen=True):
    """A viewer.

    Attributes:
        url: its address. With ``ds`` in its query it already says by which source it opens: a remote data loader.
        name: its host, for people.
        origin: the origin of its pages, as browsers say it.
    """

    url: str
    name: str
    origin: str


def viewer(text: str) -> Viewer:
    """A viewer on the command line.

    Raises:
        argparse.ArgumentTypeError: it is no address of a web page.
    """
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme not in {"http", "https"} or not parts.hostname or parts.username is not None:
        raise argparse.ArgumentTypeError(
            f"{text!a} is no address of a viewer, such as https://app.foxglove.dev/~/view"
        )
    host = f"[{parts.hostname}]" if ":" in parts.hostname else parts.hostname
    usual = {"http": 80, "https": 443}[parts.scheme]
    place = host if port in {None, usual} else f"{host}:{port}"
    return Viewer(text, place, f"{parts.scheme}://{place}")


def manifest(name: str) -> dict[str, Any]:
    """Return what a remote data loader of Foxglove asks for: where the data of a log is.

    The log is one file that is read by ranges; its address is relative to that of the manifest.
    """
    return {"name": name, "sources": [{"url": f"/logs/{quote(name)}", "supportsRangeRequests": True}]}
